"""The records that a film is fitted to: their temperatures, the sense of their output, and those of earlier runs.

A run's folder keeps the model that its law used (model.toml), and a model names the records of its film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from compensator.hysteresis.functions import Array
from rig.config.model_file import Model, read_model
from rig.core.faults import Faults
from rig.records.film_output import FALLING_RESISTANCE, column_of, other_sign
from rig.records.record_file import Record, read_record
from sim.inference.readings.output_sense import output_falls

FURTHER_K = 1.0  # than the records went: a plate that is sent to the same end twice passes it by as much


def seen_degC(records: Sequence[Record]) -> tuple[float, float]:
    """Return the least and the largest temperature in records (degC)."""
    finite = [r["temperature_degC"][np.isfinite(r["temperature_degC"])] for r in records]
    return min(float(t.min()) for t in finite), max(float(t.max()) for t in finite)


def fitted_to(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with the names and temperatures of the records (at least one) that its film was fitted to."""
    paths = [Path(record.source).absolute() for record in records]
    files = tuple(str(path) for path in paths if path.is_file())
    return replace(model, film_records=files, film_seen_degC=seen_degC(records))


def beyond_seen(model: Model, temperature_degC: Array, where: object) -> str | None:
    """Return a warning if temperatures lie outside those at which the film was measured, else None.

    temperature_degC: shape (rows,), nan allowed; where: the model's file.
    """
    if model.film is None or model.film_seen_degC is None:
        return None
    low, high = model.film_seen_degC
    beyond = int(np.sum((temperature_degC < low - FURTHER_K) | (temperature_degC > high + FURTHER_K)))
    if not beyond:
        return None
    furthest = temperature_degC[np.nanargmax(np.maximum(low - temperature_degC, temperature_degC - high))]
    rows = "1 temperature lies" if beyond == 1 else f"{beyond} temperatures lie"
    return (
        f"{where}: film_seen_degC: {rows} beyond {low:.1f} to {high:.1f} degC, where the film was measured; the "
        f"furthest is {furthest:.1f} degC: the model extrapolates there"
    )


def rising(records: Sequence[Record], output: str, say: Callable[[str], None]) -> str:
    """Return the output, or its negative if it falls as temperature rises. Raises Faults if no record has it."""
    if output != FALLING_RESISTANCE and not any(record.has_output(output) for record in records):
        lines = []
        for one in records:
            name = column_of(output, one.columns)
            what = f"no finite number in {one.rows} rows" if name in one.columns else "no such column"
            lines.append(f"{one.source}: --output {output}: {name}: {what}; there are {', '.join(one.columns)}")
        raise Faults(lines)
    if not output_falls([(r["temperature_degC"], r.output(output)) for r in records if r.has_output(output)]):
        return output
    other = other_sign(output)
    say(f"film: {output} falls as temperature rises: the model's output is {other}")
    return other


def earlier_film_records(source: str, say: Callable[[str], None] = lambda text: None) -> list[Record]:
    """Return the records that the film of a run's model was fitted to, as far as they can be read.

    source: path of the run's record; a record that is not in a run folder has none. say: called with a line for each
    record that is used, and for what cannot be read.
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
