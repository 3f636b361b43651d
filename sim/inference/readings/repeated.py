"""Readings that an instrument repeats: it is slower than the rows, and a row holds the value of rows before.

An instrument that rounds repeats values too, honestly, where what it measures moves by less than its last digit from
row to row; then its values step by one digit or a few. One that averages over several rows, and is asked in each,
repeats every value as often, and then jumps by whatever has changed since, to values that lie on no such steps.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

FEWEST_RUNS: Final = 12  # of one value each: fewer tell nothing of an instrument
ABOUT: Final = 10  # changes on either side by which the steps about a value are known
NEAR: Final = 0.05  # of a step: on it
MOST_ON_IT: Final = 0.9  # of the changes about a value, where these are steps
LARGEST_STEPS: Final = 6.0  # of a last digit from value to value; beyond them no rounded instrument repeats one
EXACT: Final = 1e-9  # relative: changes smaller than this are rounding of the computer's
OFTEN: Final = 0.5  # of the values off the steps: so many have to be repeated


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
