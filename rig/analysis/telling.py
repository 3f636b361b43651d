"""Which columns of a record hold information: a temperature that moves, a film that switches."""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults
from rig.files.film_output import FALLING_RESISTANCE, column_of, in_decades, unit_of
from rig.files.record_file import Record

FEWEST = 40  # rows
LEAST_K, LEAST_DEC = 0.5, 0.05
TIMES = 8.0  # of the noise


def telling_columns(record: Record, output: str = FALLING_RESISTANCE) -> tuple[dict[str, Array], list[str]]:
    """The columns that a diagnosis can use, and a note for each that was left out; output: of the film, as in a model
    file. Raises Faults where none is left."""
    columns, notes = dict(record.columns), []
    if record.rows < FEWEST:
        raise Faults([f"{record.source}: {record.rows} rows; expected at least {FEWEST}"])
    temperature = record["temperature_degC"]
    if not record.has("temperature_degC"):
        raise Faults([f"{record.source}: temperature_degC: no finite number in {record.rows} rows"])
    moved, needed = _moved(temperature, LEAST_K)
    if moved < needed:
        text = f"temperature_degC: moves by {moved:.2g} K only; expected at least {needed:.2g} K, beyond its noise"
        raise Faults([f"{record.source}: {text}, and steps or sweeps through the film's transition"])
    name = column_of(output, record.columns)
    if record.has_output(output):
        values = record.output(output)
        changed, needed = _moved(values, LEAST_DEC if in_decades(output) else 0.0)
        if changed < needed or changed == 0.0:
            unit = "decades" if in_decades(output) else unit_of(output)
            text = f"{name}: changes by {changed:.2g} {unit} only, expected at least {needed:.2g}"
            notes.append(f"{text} (a sweep through the transition): film and its meter were not judged")
            del columns[name]
    elif name in columns:
        notes.append(f"{name}: no finite number: film and its meter were not judged")
        del columns[name]
    if record.has("current_A") and np.nanmax(record["current_A"]) == np.nanmin(record["current_A"]) == 0.0:
        notes.append("current_A: 0 in all rows: plate, driver and thermometer were not judged")
        del columns["current_A"]
    if name not in columns and not ("current_A" in columns and record.has("current_A")):
        text = f"neither a current_A that drives the plate nor a {name} that switches"
        lines = [f"{record.source}: {note}" for note in notes]
        raise Faults([*lines, f"{record.source}: {text}; expected one at least"])
    return columns, notes


def _moved(values: Array, least: float) -> tuple[float, float]:
    """How far finite values move apart from outliers, and how far they have to for anything to be said."""
    good = values[np.isfinite(values)]
    if good.size < 3:
        return 0.0, least
    low, high = np.percentile(good, [2.0, 98.0])
    noise = 1.4826 * float(np.median(np.abs(np.diff(good)))) / np.sqrt(2.0)
    most = 20.0 * least if least > 0.0 else math.inf
    return float(high - low), min(max(least, TIMES * noise), most)
