"""The records that told the film of a run's model before it ran: those of its calibration, and of runs since.

A run's folder keeps the model that its law used (model.toml), and a model names the records of its film.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.config.model_file import Model, read_model
from rig.core.faults import Faults
from rig.records.record import Record
from rig.records.record_file import read_record


def as_film_records(records: Iterable[Record]) -> tuple[str, ...]:
    """Records as a model file names them, by their whole paths; those that are no files are left out."""
    paths = [Path(record.source).absolute() for record in records]
    return tuple(str(path) for path in paths if path.is_file())


def seen_degC(records: Sequence[Record]) -> tuple[float, float]:
    """The least and the largest temperature in records, degC."""
    finite = [r["temperature_degC"][np.isfinite(r["temperature_degC"])] for r in records]
    return min(float(t.min()) for t in finite), max(float(t.max()) for t in finite)


def told_by(model: Model, records: Sequence[Record]) -> Model:
    """The model with what to know of the records, at least one, that told its film."""
    return replace(model, film_records=as_film_records(records), film_seen_degC=seen_degC(records))


def film_records_before(source: str, say: Callable[[str], None] = lambda text: None) -> list[Record]:
    """Those of the run that a record is of, by the record's path, as far as they can still be read; none where the
    record is of no run. say: which are used, and what cannot be read."""
    record = Path(source).absolute()
    model = record.parent / "model.toml"
    if not (record.parent / "run.json").is_file() or not model.is_file():
        return []
    found = []
    try:
        names = [name for name in read_model(model).film_records if Path(name) != record]
    except Faults as faults:
        say(f"its film is told by this record alone: {faults.lines[0]}")
        return []
    for name in names:
        try:
            found.append(read_record(Path(name), options=False))
            say(f"reads {name}, which told its film before")
        except Faults as faults:
            say(f"a record that told its film before cannot be read: {faults.lines[0]}")
    return found
