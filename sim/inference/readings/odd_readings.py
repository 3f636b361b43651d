"""Readings of a column that cannot be what was measured, in a line each: one bad row, or a unit that changes midway.

By rules that know no model. A bad row stands off its neighbours and off the straight lines through them
(`lone_outliers`), by more than an instrument's last digit. Where the unit changes the reading jumps, in one row, by
just what the other unit makes of it, and stays: a plate does not, and a film that switches abruptly jumps in the sense
in which it goes, and back again on the way back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.outliers import lone_outliers

STEPS: Final = 4.0  # usual changes from row to row by which a bad reading is off at the least: a last digit flickers
ROWS_TOLD: Final = 5  # numbers of rows in a line
KELVINS: Final = 273.15  # what a reading in K is above the same in degC
NEAR_K: Final = 3.0  # to it: what a plate may have moved in that row
FAHRENHEIT: Final = (1.8, 32.0)  # a reading in degF from the same in degC
LEAST_JUMP_K: Final = 40.0  # no plate moves by as much in a row
PREFIXES: Final = (3.0, 6.0)  # decades between ohm, kohm and Mohm
NEAR_DEC: Final = 0.06  # to them: what a film may have moved in that row, and noise
BESIDE: Final = 3  # rows on either side within which it neither moves nor jumps as far
MOST_BESIDE: Final = 0.1  # of the jump: what these rows may differ by
Quantity = Literal["degC", "decades", "other"]


@dataclass(frozen=True, eq=False)
class Column:
    """Readings of one column, shape (rows,), nan where there is none: name as the record has it; quantity: "decades"
    of +-log10 of a resistance in ohm, as `rises` says, or the unit."""

    name: str
    time_s: Array
    values: Array
    quantity: Quantity = "other"
    rises: bool = False

    def at(self, row: int) -> str:
        """Return a reading in words."""
        if self.quantity == "degC":
            return f"{self.values[row]:.4g} degC"
        if self.quantity == "decades":
            return f"{10.0 ** (self.values[row] if self.rises else -self.values[row]):.4g} ohm"
        return f"{self.values[row]:.4g}"


def of_output(time_s: Array, output: Array, output_name: str) -> Column:
    """Return the column of a film's output, by the name that its model has."""
    if output_name in ("minus_log10_ohm", "log10_ohm"):
        return Column("resistance_ohm", time_s, output, "decades", output_name == "log10_ohm")
    return Column(output_name, time_s, output)


def odd_readings(
    column: Column, temperature_degC: Array | None = None, left_out: Sequence[int] | None = None
) -> list[str]:
    """Return a line for bad readings, and one for a unit that changes. temperature_degC: in the same rows, where the
    column is a film's; left_out: the rows that count for nothing, None: all that are bad."""
    changes = _unit_changes(column, temperature_degC)
    lines = [
        f"{column.name}: {_place(column, row)}: the reading goes from {column.at(before)} to {column.at(row)} at once "
        f"and stays: the unit changes there, from {one} to {other}? Convert one part, or give the parts as records of "
        "their own."
        for before, row, one, other in changes
    ]
    bad = bad_rows(column)
    if bad.size:
        lines.append(_bad(column, bad, bad if left_out is None else np.intersect1d(bad, left_out)))
    return lines


def bad_rows(column: Column) -> NDArray[np.int64]:
    """Return the rows of lone readings that are far off, beyond a last digit's flicker."""
    finite = np.isfinite(column.values)
    rows = np.flatnonzero(finite)
    found = lone_outliers(column.values, finite)
    if not found.size:
        return found
    y = column.values[rows]
    moves = np.abs(np.diff(y))
    usual = float(np.median(moves[moves > 0.0])) if np.any(moves > 0.0) else 0.0
    place = np.searchsorted(rows, found)
    before, after = y[np.maximum(place - 1, 0)], y[np.minimum(place + 1, rows.size - 1)]
    off = np.maximum(np.minimum(before, after) - y[place], y[place] - np.maximum(before, after))
    inside = (place > 0) & (place < rows.size - 1)  # at either end nothing tells a bad reading from a fast one
    return np.asarray(found[inside & (off > STEPS * usual)], dtype=np.int64)


def rows_told(rows: Sequence[int] | NDArray[np.int64]) -> str:
    """Return numbers of rows in words, from 1 on; of many the first ones."""
    told = ", ".join(str(int(row) + 1) for row in rows[:ROWS_TOLD])
    more = f" and {len(rows) - ROWS_TOLD} more" if len(rows) > ROWS_TOLD else ""
    return f"row{'s' * (len(rows) > 1)} {told}{more}"


def _bad(column: Column, bad: NDArray[np.int64], left_out: NDArray[np.int64]) -> str:
    rows = np.flatnonzero(np.isfinite(column.values))
    first = int(bad[0])
    place = int(np.searchsorted(rows, first))
    beside = f"{column.at(int(rows[place - 1]))} and {column.at(int(rows[place + 1]))}"
    if bad.size == 1:
        text = f"{_place(column, first)} reads {column.at(first)} between {beside}: a bad reading"
    else:
        text = f"{rows_told(bad)} stand off the rows beside them, {_place(column, first)} reads {column.at(first)} "
        text += f"between {beside}: bad readings"
    counts = "left out"
    if left_out.size < bad.size:  # a fit may be as far off there, or know better
        gone = f"{rows_told(left_out)} {'were' if left_out.size > 1 else 'was'} left out" if left_out.size else ""
        counts = f"of which only {gone}" if gone else f"not left out: {'it counts' if bad.size == 1 else 'they count'}"
    return (
        f"{column.name}: {text}, {counts}. If it was none, the record is too sparse there; else look at the contacts."
    )


def _place(column: Column, row: int) -> str:
    return f"row {row + 1} ({column.time_s[row]:.12g} s)"  # a time since 1970 has that many digits


def _unit_changes(column: Column, temperature_degC: Array | None) -> list[tuple[int, int, str, str]]:
    """Return (the row before, the row, unit before, unit after) of each change of a unit."""
    rows = np.flatnonzero(np.isfinite(column.values))
    y = column.values[rows]
    jumps = np.diff(y)
    found = []
    for k in np.flatnonzero(np.abs(jumps) > (LEAST_JUMP_K if column.quantity == "degC" else PREFIXES[0] - NEAR_DEC)):
        near = jumps[max(k - BESIDE, 0) : k], jumps[k + 1 : k + 1 + BESIDE]
        if near[1].size == 0 or np.max(np.abs(np.concatenate(near)), initial=0.0) > MOST_BESIDE * abs(jumps[k]):
            continue  # it does not stay, or moves as fast beside it
        units = _units(column, float(y[k]), float(y[k + 1]))
        if units is None:
            continue
        if column.quantity == "decades" and _switches(jumps, rows, int(k), temperature_degC):
            continue
        found.append((int(rows[k]), int(rows[k + 1]), *units))
    return found


def _units(column: Column, before: float, after: float) -> tuple[str, str] | None:
    """Return the units between which a reading changes so, None if there are none."""
    if column.quantity == "degC":
        if abs(abs(after - before) - KELVINS) < NEAR_K:
            return ("degC", "K") if after > before else ("K", "degC")
        ratio, offset = FAHRENHEIT
        if abs(ratio * before + offset - after) < ratio * NEAR_K:
            return "degC", "degF"
        return ("degF", "degC") if abs(ratio * after + offset - before) < ratio * NEAR_K else None
    if column.quantity == "decades":
        more = (after - before) * (1.0 if column.rises else -1.0)  # in log10 of the number that stands there
        for decades, name in zip(PREFIXES, ("kohm", "Mohm"), strict=True):
            if abs(abs(more) - decades) < NEAR_DEC:
                return ("ohm", name) if more < 0.0 else (name, "ohm")
    return None


def _switches(jumps: Array, rows: NDArray[np.int64], k: int, temperature_degC: Array | None) -> bool:
    """Whether an abrupt film may have done it: in the sense in which the temperature goes (an output rises with it),
    and back with as large a jump on the way back."""
    if temperature_degC is None:
        return False
    back = np.flatnonzero(np.abs(jumps + jumps[k]) < MOST_BESIDE * abs(jumps[k]))
    return any(_along(jumps, rows, int(j), temperature_degC) for j in back) and _along(jumps, rows, k, temperature_degC)


def _along(jumps: Array, rows: NDArray[np.int64], k: int, temperature_degC: Array) -> bool:
    """Whether a jump goes as the temperature about it does."""
    around = temperature_degC[rows[max(k - BESIDE, 0) : k + 2 + BESIDE]]
    around = around[np.isfinite(around)]
    return bool(around.size > 1 and (around[-1] - around[0]) * jumps[k] > 0.0)


def of_records(records: Sequence[tuple[str, Sequence[Column]]]) -> tuple[str, ...]:
    """Return the lines of several records, each with its name and its columns, the temperature first; what is no number
    there is no reading."""
    lines = []
    for name, columns in records:
        for column in columns:
            beside = None if column is columns[0] else columns[0].values
            lines += [f"{name}: {line}" for line in odd_readings(column, beside)]
    return tuple(lines)
