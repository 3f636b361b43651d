"""Which columns of a record hold information: a temperature that moves, a film that switches."""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults
from rig.records.film_output import FALLING_RESISTANCE, column_of, in_decades, unit_of
from rig.records.record_file import Record

FEWEST = 40  # rows
LEAST_K, LEAST_DEC = 0.5, 0.05
TIMES = 8.0  # of the noise


def telling_columns(record: Record, output: str = FALLING_RESISTANCE) -> tuple[dict[str, Array], list[str]]:
    """The columns that a diagnosis can use, and a note for each that was left out; output: of the film, as in a model
    file. Raises Faults where none is left."""
    columns, lost = informative(record, output)
    name = column_of(output, record.columns)
    unjudged = {name: "film and its meter", "current_A": "plate, driver and thermometer"}
    notes = [f"{column}: {why}: {unjudged[column]} were not judged" for column, why in lost.items()]
    if name not in columns and "current_A" not in columns:
        text = f"neither a current_A that drives the plate nor a {name} that switches"
        lines = [f"{record.source}: {note}" for note in notes]
        raise Faults([*lines, f"{record.source}: {text}; expected one at least"])
    return columns, notes


def informative(record: Record, output: str) -> tuple[dict[str, Array], dict[str, str]]:
    """The columns that hold information, each of shape (rows,); and of film and drive by name why a column that is
    there holds none. output: as `telling_columns`. Raises Faults for too few rows, or a temperature that does not
    move."""
    if record.rows < FEWEST:
        raise Faults([f"{record.source}: {record.rows} rows; expected at least {FEWEST}"])
    require_moving(record)
    columns, lost = dict(record.columns), {}
    name = column_of(output, record.columns)
    if record.has_output(output):
        changed, needed = _moved(record.output(output), LEAST_DEC if in_decades(output) else 0.0)
        if changed < needed or changed == 0.0:
            unit = "decades" if in_decades(output) else unit_of(output)
            text = f"changes by {changed:.2g} {unit} only, expected at least {needed:.2g}"
            lost[name] = f"{text} (a sweep through the transition)"
    elif name in columns:
        lost[name] = "no finite number"
    if record.has("current_A") and np.nanmax(record["current_A"]) == np.nanmin(record["current_A"]) == 0.0:
        lost["current_A"] = "0 in all rows"
    elif "current_A" in columns and not record.has("current_A"):
        lost["current_A"] = "no finite number"
    return {column: values for column, values in columns.items() if column not in lost}, lost


def require_moving(record: Record) -> None:
    """Raises Faults for a record whose temperature does not move beyond its noise: nothing follows it."""
    if not record.has("temperature_degC"):
        raise Faults([f"{record.source}: temperature_degC: no finite number in {record.rows} rows"])
    moved, needed = _moved(record["temperature_degC"], LEAST_K)
    if moved < needed:
        text = f"temperature_degC: moves by {moved:.2g} K only; expected at least {needed:.2g} K, beyond its noise"
        raise Faults([f"{record.source}: {text}, and steps or sweeps through the film's transition"])


def _moved(values: Array, least: float) -> tuple[float, float]:
    """How far finite values move apart from outliers, and how far they have to for anything to be said."""
    good = values[np.isfinite(values)]
    if good.size < 3:
        return 0.0, least
    low, high = np.percentile(good, [2.0, 98.0])
    noise = 1.4826 * float(np.median(np.abs(np.diff(good)))) / np.sqrt(2.0)
    most = 20.0 * least if least > 0.0 else math.inf
    return float(high - low), min(max(least, TIMES * noise), most)
