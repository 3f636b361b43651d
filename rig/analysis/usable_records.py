"""Records and columns that a diagnosis can use: a temperature that moves, a film that switches, no record twice.

A record that is held out has to be able to judge what is diagnosed. The gain is measured by a simulation from its own
current, or temperature if it has no current, against readings that move: a record without them would leave nothing
judged, after minutes of search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults
from rig.records.film_output import FALLING_RESISTANCE, column_of, in_decades, unit_of
from rig.records.record import Record, content_digest
from sim.inference.record.quantity import Quantity
from sim.inference.record.record import read_columns

FEWEST = 40  # rows
LEAST_K, LEAST_DEC = 0.5, 0.05
TIMES = 8.0  # of the noise


def usable_columns(record: Record, output: str = FALLING_RESISTANCE) -> tuple[dict[str, Array], list[str]]:
    """Return the columns that a diagnosis can use, and a note for each that was left out; output: of the film, as in a
    model file. Raises Faults if none is left."""
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
    """Return the columns that hold information, each of shape (rows,); and of film and drive by name why a column that
    exists holds none. Raises Faults for too few rows, or a temperature that does not move."""
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
    """Raise Faults for a record whose temperature does not move beyond its noise: nothing follows it."""
    if not record.has("temperature_degC"):
        raise Faults([f"{record.source}: temperature_degC: no finite number in {record.rows} rows"])
    moved, needed = _moved(record["temperature_degC"], LEAST_K)
    if moved < needed:
        text = f"temperature_degC: moves by {moved:.2g} K only; expected at least {needed:.2g} K, beyond its noise"
        raise Faults([f"{record.source}: {text}, and steps or sweeps through the film's transition"])


def _moved(values: Array, least: float) -> tuple[float, float]:
    """Return how far finite values move apart from outliers, and how far they have to for anything to be concluded."""
    good = values[np.isfinite(values)]
    if good.size < 3:
        return 0.0, least
    low, high = np.percentile(good, [2.0, 98.0])
    noise = 1.4826 * float(np.median(np.abs(np.diff(good)))) / np.sqrt(2.0)
    most = 20.0 * least if least > 0.0 else math.inf
    return float(high - low), min(max(least, TIMES * noise), most)


def require_different(records: Sequence[Record]) -> None:
    """Raise Faults, a line for each record that holds the same as one before it, whatever their names: held out, it
    would judge the fit to itself."""
    digests, lines = [content_digest(record) for record in records], []
    for k, record in enumerate(records):
        first = records[digests.index(digests[k])].source
        if digests.index(digests[k]) < k:
            same = "is given twice" if first == record.source else f"holds the same as {first}"
            lines.append(f"{record.source}: {same}; expected each record once, fitted or held out")
    if lines:
        raise Faults(lines)


def require_judging(
    holdout: Sequence[Record],
    diagnosed: Sequence[Record],
    telling: Sequence[Mapping[str, Array]],
    output: str,
    say: Callable[[str], None],
) -> None:
    """Raise Faults, before anything is fitted, for held-out records that cannot judge what is diagnosed.

    telling: of each record that is diagnosed the columns that can be used; output: of the film, as in a model file;
    say: called for a record that judges the film alone.
    """
    film = any(column_of(output, columns) in columns for columns in telling)
    plate = any("current_A" in columns for columns in telling)
    lines = []
    for other in holdout:
        name = column_of(output, other.columns)
        try:
            lost = _lost(other, output)
        except Faults as faults:
            lines += faults.lines
            continue
        judged_by = f"by which a held-out record judges that of {diagnosed[0].source}"
        if film and name in lost:
            lines.append(f"{other.source}: {name}: {lost[name]}; expected a film that switches, {judged_by}")
        if plate and "current_A" in lost:
            if film and "current_A" not in other.columns:
                say(f"{other.source}: no current_A: it judges the film alone")
            else:
                expected = f"expected a current that drives the plate, {judged_by}"
                lines.append(f"{other.source}: current_A: {lost['current_A']}; {expected}")
    if lines:
        raise Faults(lines)


def _lost(other: Record, output: str) -> dict[str, str]:
    """Return by name why another record shows nothing of film and drive. Raises Faults if it shows nothing."""
    columns, lost = informative(other, output)
    try:
        rows = read_columns(columns, held_out=False, quantity=Quantity(output))
    except ValueError as error:
        raise Faults(f"{other.source}: {line}" for line in str(error).splitlines()) from None
    name = column_of(output, other.columns)
    if rows.output is None:
        few = f"fewer than {FEWEST} finite readings" if name in columns else "missing"
        lost.setdefault(name, few)
    if rows.current_A is None:
        lost.setdefault("current_A", "missing")
    return lost
