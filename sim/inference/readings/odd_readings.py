"""Readings that are not what was measured: alone, repeated, or in a unit that changes midway; by rules without a model.

A lone outlier is compared with the hull of its two neighbours on each side and of the straight lines through them, so
that steep flanks and corners are no outliers; one further outside than the hull is wide, and than noise allows, is one.
The noise is the median deviation from the neighbours' mean (P. J. Rousseeuw, C. Croux, J. Am. Stat. Assoc. 88 (1993)
1273, on such scales). A bad row that is worth a line is off by more than an instrument's last digit, too.

An instrument that is slower than the rows averages over several of them, and repeats every value as often; then it
jumps by whatever has changed since. One that rounds repeats values honestly, where what it measures moves by less than
its last digit; then its values step by one digit or a few.

Where the unit changes the reading jumps, in one row, by just what the other unit makes of it, and stays: a plate does
not, and a film that switches abruptly jumps in the sense in which it goes, and back again on the way back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

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
FAR: Final = 8.0  # in robust standard deviations, besides the hull's width
FEWEST_ALONE: Final = 7
FEWEST_RUNS: Final = 12  # of one value each: fewer tell nothing of an instrument
ABOUT: Final = 10  # changes on either side by which the steps about a value are known
NEAR: Final = 0.05  # of a step: on it
MOST_ON_IT: Final = 0.9  # of the changes about a value, where these are steps
LARGEST_STEPS: Final = 6.0  # of a last digit from value to value; beyond them no rounded instrument repeats one
EXACT: Final = 1e-9  # relative: changes smaller than this are rounding of the computer's
OFTEN: Final = 0.5  # of the values off the steps: so many have to be repeated
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


def lone_outliers(values: Array, finite: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return rows of lone outliers among the finite values, shape (found,)."""
    rows = np.flatnonzero(finite)
    if rows.size < FEWEST_ALONE:
        return np.empty(0, dtype=np.int64)
    y = values[rows]
    padded = np.concatenate((y[2:0:-1], y, y[-2:-4:-1]))
    before2, before, after, after2 = (padded[k : k + y.size] for k in (0, 1, 3, 4))
    around = np.stack((before2, before, after, after2, 2.0 * before - before2, 2.0 * after - after2))
    low, high = around.min(axis=0), around.max(axis=0)
    outside = np.maximum(np.maximum(low - y, y - high), 0.0)
    noise = 1.2 * float(np.median(np.abs(y - 0.5 * (before + after)))) + 1e-9 * (1.0 + float(np.ptp(y)))
    return np.asarray(rows[outside > FAR * noise + (high - low)], dtype=np.int64)


def repeated_rows(values: Array, fewest: int = 0) -> NDArray[np.int64]:
    """Return the rows in which an instrument repeats the reading before, if it is slower than the rows; else none.
    values: (rows,), nan where there is no reading; fewest: readings that have to be left, or there are none to leave
    out."""
    rows = np.flatnonzero(np.isfinite(values))
    y = values[rows]
    fresh = np.concatenate(([True], np.diff(y) != 0.0)) if y.size else np.empty(0, dtype=np.bool_)
    begins = np.flatnonzero(fresh)
    none = np.empty(0, dtype=np.int64)
    if begins.size < FEWEST_RUNS:
        return none
    lengths = np.diff(np.append(begins, y.size))
    if np.sum(lengths > 1) < OFTEN * FEWEST_RUNS:
        return none
    free = ~_rounded(y[begins])
    free[0] = free[-1] = False  # which may have begun before, or go on after
    if np.sum(free) < FEWEST_RUNS or np.mean(lengths[free] > 1) < OFTEN:
        return none
    if begins.size < fewest:
        return none
    return np.asarray(rows[~fresh], dtype=np.int64)


def _rounded(values: Array) -> NDArray[np.bool_]:
    """Whether about each of the values, none like the one before, they step by a last digit: as they are, or as what
    they are the logarithm of."""
    with np.errstate(over="ignore"):
        scales = values, 10.0**values, 10.0**-values
    steps = [_in_steps(scale) for scale in scales if np.all(np.isfinite(scale))]
    return np.asarray(np.any(steps, axis=0), dtype=np.bool_)


def _in_steps(values: Array) -> NDArray[np.bool_]:
    found = np.zeros(values.size, dtype=np.bool_)
    changes = np.abs(np.diff(values))
    changes = np.where(changes > EXACT * np.maximum(np.abs(values[1:]), np.abs(values[:-1])), changes, np.inf)
    for k in range(values.size):
        near = changes[max(k - ABOUT, 0) : k + ABOUT]
        ratio = near / np.min(near)
        on_it = (np.abs(ratio - np.round(ratio)) < NEAR) & (ratio <= LARGEST_STEPS)
        found[k] = bool(np.mean(on_it) >= MOST_ON_IT)
    return found
