"""Earlier records of a film: those that the model of a run was fitted to before, from its calibration and later runs.

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


def record_paths(records: Iterable[Record]) -> tuple[str, ...]:
    """Return the whole paths of records, as a model file names them; without those that are no files."""
    paths = [Path(record.source).absolute() for record in records]
    return tuple(str(path) for path in paths if path.is_file())


def seen_degC(records: Sequence[Record]) -> tuple[float, float]:
    """Return the least and the largest temperature in records, degC."""
    finite = [r["temperature_degC"][np.isfinite(r["temperature_degC"])] for r in records]
    return min(float(t.min()) for t in finite), max(float(t.max()) for t in finite)


def told_by(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with the names and temperatures of the records (at least one) that its film was fitted to."""
    return replace(model, film_records=record_paths(records), film_seen_degC=seen_degC(records))


def earlier_film_records(source: str, say: Callable[[str], None] = lambda text: None) -> list[Record]:
    """Return the records that the film of a run's model was fitted to, as far as they can be read.

    source: path of the run's record; of another record there are none. say: gets a line for each record that is used,
    and for what cannot be read.
    """
    record = Path(source).absolute()
    model = record.parent / "model.toml"
    if not (record.parent / "run.json").is_file() or not model.is_file():
        return []
    found = []
    try:
        names = [name for name in read_model(model).film_records if Path(name) != record]
    except Faults as faults:
        say(f"the film is fitted to this record alone: {faults.lines[0]}")
        return []
    for name in names:
        try:
            found.append(read_record(Path(name), options=False))
            say(f"reads {name}, to which its film was fitted before")
        except Faults as faults:
            say(f"a record to which its film was fitted before cannot be read: {faults.lines[0]}")
    return found
