"""Where a record's stretches begin: after gaps in which the plate may have gone where no command tells.

A missing row is no such gap where the commands beside it lie on a straight line: what was commanded in it is known
better than any reading tells the temperature, and the simulation goes on through it. Begun anew after each of a hundred
missing rows, the plate's temperature would be known by a few readings each time, and a film feels the difference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compensator.functions import Array
from compensator.identify_rows import gap_threshold
from sim.diagnosis.readings import quick_noise

SHORT = 6.0  # median steps: a plate does not turn round in a shorter gap
KNOWN = 0.7  # of the thermometer's noise: what a gap may change the plate's temperature by and still be passed
FITTED = 10  # rows over which the plate's rate is taken
Rows = NDArray[np.int64]


def gaps(time_s: Array, told: NDArray[np.bool_]) -> Rows:
    """The rows after each gap. told: rows in which a current stands, (rows,)."""
    steps = np.diff(time_s)
    return np.flatnonzero((steps > gap_threshold(steps)) | ~told[:-1]) + 1


def first_rows(
    time_s: Array, temperature_degC: Array, current_A: Array | None, told: NDArray[np.bool_], after: Rows
) -> Rows:
    """The first row, and those after gaps through which the plate's temperature is not known. current_A: in each row,
    (rows,), on a straight line where it is not told; after: the rows after each gap."""
    if current_A is None or after.size == 0:
        return np.concatenate(([0], after))
    rows = np.flatnonzero(told)
    place = np.searchsorted(rows, after)
    end = rows[np.minimum(place, rows.size - 1)]
    begin = np.minimum(rows[np.maximum(place - 1, 0)], end)
    missing = time_s[end] - time_s[begin]
    change = _rate_per_A(time_s, temperature_degC, current_A) * missing * _off_the_line(time_s, current_A, begin, end)
    short = (missing <= SHORT * float(np.median(np.diff(time_s)))) & (begin < after) & (after <= end)
    return np.concatenate(([0], after[~(short & (change < KNOWN * quick_noise(temperature_degC)))]))


def _off_the_line(time_s: Array, current_A: Array, begin: Rows, end: Rows) -> Array:
    """How far the commands beside each gap are off the straight line through it, A, (gaps,). begin, end: the rows of
    the last command before and of the first one after it."""
    before, beyond = np.maximum(begin - 1, 0), np.minimum(end + 1, time_s.size - 1)
    span = np.maximum(time_s[end] - time_s[begin], 1e-9)
    slope = (current_A[end] - current_A[begin]) / span
    off = [current_A[row] - current_A[end] - slope * (time_s[row] - time_s[end]) for row in (before, beyond)]
    return np.asarray(np.max(np.abs(off), axis=0), dtype=np.float64)


def _rate_per_A(time_s: Array, temperature_degC: Array, current_A: Array) -> float:
    """How fast the plate answers a current, K/s/A: of a line through the rates, by current and temperature."""
    step = slice(None, None, FITTED)
    time, temperature = time_s[step], temperature_degC[step]
    rate = np.diff(temperature) / np.diff(time)
    current = np.add.reduceat(current_A, np.arange(0, current_A.size, FITTED))[: rate.size] / FITTED
    columns = np.stack((current, 0.5 * (temperature[1:] + temperature[:-1]), np.ones(rate.size)), axis=1)
    return abs(float(np.linalg.lstsq(columns, rate)[0][0]))
