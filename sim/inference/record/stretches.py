"""Where a record's stretches begin: after gaps in which the plate may have gone where no command tells.

A missing row is no such gap where the commands beside it lie on a straight line: what was commanded in it is known
better than any reading tells the temperature, and the simulation goes on through it. Begun anew after each of a hundred
missing rows, the plate's temperature would be known by a few readings each time, and a film feels the difference.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference.noise import rough_noise
from sim.model.gaps import SHORT, gap_threshold, long_gaps

KNOWN = 0.7  # of the thermometer's noise: what a gap may change the plate's temperature by and still be passed
HELD = 10.0  # median steps that a gap may last in which one command was held: it stands on both sides of it
FITTED = 10  # rows over which the plate's rate is taken
Rows = NDArray[np.int64]


def gaps(time_s: Array, told: NDArray[np.bool_], joined: Sequence[int] = (), acts_s: Array | None = None) -> Rows:
    """The rows after each gap. told: rows in which a current stands, (rows,); joined: where further records begin, each
    with rows as far apart as its own are; acts_s: when each row's current acted, (rows,), nan where that is not told:
    where the next one followed at the usual pace none is missing, however late the first of the two was."""
    after, steps = ~told[:-1], np.diff(time_s)
    if acts_s is not None:
        steps = np.fmin(steps, np.diff(acts_s))
    for first, last in itertools.pairwise([0, *joined, time_s.size]):
        own = steps[first : last - 1]
        if own.size:
            after[first : last - 1] |= own > gap_threshold(own)
    after[np.asarray(joined, dtype=np.int64) - 1] = True
    return np.flatnonzero(after) + 1


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
    off = _off_the_line(time_s, current_A, begin, end)
    change = _rate_per_A(time_s, temperature_degC, current_A) * missing * off
    longest = np.where((off == 0.0) & (current_A[begin] == current_A[end]), HELD, SHORT)
    short = (missing <= longest * float(np.median(np.diff(time_s)))) & (begin < after) & (after <= end)
    return np.concatenate(([0], after[~(short & (change < KNOWN * rough_noise(temperature_degC)))]))


def with_readings(begins: Rows, used: NDArray[np.bool_], time_s: Array, within_s: float) -> Rows:
    """Where stretches begin in which a reading counts, and the first one. A stretch that is over before any counts goes
    on through the gap behind it, if that is short and comes within so many seconds; else the long gap before it would
    be taken for the short one. begins: where all do; used: rows with a reading that counts, (rows,)."""
    long, kept, told = long_gaps(time_s, begins[1:]), [int(begins[0])], True
    for first, tells in zip(begins[1:].tolist(), np.logical_or.reduceat(used, begins)[1:].tolist(), strict=True):
        if told:
            kept.append(first)
        elif first in long or time_s[first] - time_s[kept[-1]] > within_s:
            kept[-1] = first
        told = tells
    return np.array(kept if told else kept[:-1], dtype=np.int64)


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


def undriven(used: NDArray[np.bool_], current: Array | None) -> NDArray[np.bool_]:
    """The rows in which nothing drives the film: without a current, before the first temperature and after the last."""
    known, found = np.flatnonzero(used), np.full(used.size, current is None)
    found[known[0] : known[-1] + 1] = False
    return found
