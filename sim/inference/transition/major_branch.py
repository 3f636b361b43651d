"""The major branches of a record: the rows on which the film is heated, or cooled, through its whole range at once.

A run is what lies between two turning points of the temperature; reversals of less than `RIPPLE` of the range are none.
A run is a major branch where it goes through `WHOLE` of the range that counts, so that the film comes from saturation
if that is wide enough. What counts is the range that heating and cooling both reach, where both show `WHOLE` of all
that the output does in the record: the way up from a room that the film is not cooled to again does not make the loop
wider. Else the record's own range counts. Rows in which a ripple goes back are left out: the film is then inside a
minor loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.outliers import lone_outliers
from sim.inference.readings.temperature_path import TemperaturePath, temperature_path, turning_points
from sim.inference.transition.rounding import last_digit, rounding_errors

Sense = Literal["heating", "cooling"]
WHOLE: Final = 0.85  # of the range that counts: a first sweep from a room somewhat warmer than the cold end is one
RIPPLE: Final = 0.02  # of the range: a controller's overshoot, no reversal that was meant
UNSEEN: Final = 0.05  # of the range without a reading, and ...
MANY: Final = 8.0  # ... median steps: what lies between was not measured
RIPPLE_NOISE: Final = 3.0  # standard deviations of the thermometer's noise
FEWEST_ROWS: Final = 20  # of a branch, below which it has no shape
DRAWS: Final = 50  # places of the thermometer's lattice that are tried
MOST_ROWS: Final = 600  # of a branch: of more the means of neighbours are taken, far finer than any transition


@dataclass(frozen=True, eq=False)
class Run:
    """Rows first..last (both included) between two turning points of the temperature."""

    first: int
    last: int
    heating: bool


@dataclass(frozen=True, eq=False)
class MajorBranch:
    """The readings of all runs in one sense, in the order of time: degC (what is behind the thermometer's noise) and
    output, shape (rows,) each, means of neighbouring rows where there are many; how many runs; the median rate, K/s.
    rounding_K: what the thermometer's last digit may have added to these means, shape (DRAWS, rows), or (0, rows)."""

    sense: Sense
    temperature_degC: Array
    output: Array
    runs: int
    rate_K_per_s: float
    rounding_K: Array


def runs_of(path: TemperaturePath) -> list[Run]:
    """The runs of a record in the order of time."""
    v = path.temperature_degC
    least = max(RIPPLE * float(np.ptp(v)), RIPPLE_NOISE * path.noise_K)
    return [Run(int(a), int(b), bool(v[b] > v[a])) for a, b in pairwise(turning_points(v, least))]


def onward_rows(v: Array, run: Run) -> NDArray[np.int64]:
    """The rows of a run in which the temperature is further than in any row of the run before."""
    part = v[run.first : run.last + 1]
    furthest = np.maximum.accumulate(part) if run.heating else np.minimum.accumulate(part)
    return np.asarray(run.first + np.flatnonzero(part == furthest), dtype=np.int64)


def major_branches(time_s: ArrayLike, temperature_degC: ArrayLike, output: ArrayLike) -> dict[Sense, MajorBranch]:
    """The branches that a record has, none to two. Arrays of shape (rows,): s, degC, the film's output (nan: none)."""
    time, y = np.asarray(time_s, dtype=np.float64), np.asarray(output, dtype=np.float64)
    path = temperature_path(time, temperature_degC)
    v = path.temperature_degC
    good = np.isfinite(y) & np.isfinite(np.asarray(temperature_degC, dtype=np.float64))
    good[lone_outliers(y, np.isfinite(y))] = False
    digit = last_digit(np.asarray(temperature_degC, dtype=np.float64))
    found: dict[Sense, MajorBranch] = {}
    runs = runs_of(path)
    low, high = _range_that_counts(runs, v, y, good)
    senses: tuple[Sense, Sense] = ("heating", "cooling")
    for sense in senses:
        passed = [
            (_overlap(_ends(run, v), (low, high)), onward_rows(v, run))
            for run in runs
            if run.heating == (sense == "heating")
        ]
        seen = [(width, row[good[row]]) for width, row in passed]
        span = float(np.ptp(y[good])) if np.any(good) else 0.0
        rows = [row for width, row in seen if width / (high - low) - _unseen(v[row], y[row], high - low, span) >= WHOLE]
        if sum(row.size for row in rows) < FEWEST_ROWS:
            continue
        rates = [_rate(time[row], v[row]) for row in rows]
        groups = [group for row in rows for group in _groups(row, max(MOST_ROWS // len(rows), FEWEST_ROWS))]
        means = [np.array([float(np.mean(values[group])) for group in groups]) for values in (v, y)]
        rounding = np.zeros((0, len(groups)))
        if digit > 0.0:
            errors = rounding_errors(v, digit, path.noise_K, DRAWS, seed=0)
            rounding = np.stack([np.mean(errors[:, group], axis=1) for group in groups], axis=1)
        found[sense] = MajorBranch(sense, means[0], means[1], len(rows), float(np.median(rates)), rounding)
    return found


def _ends(run: Run, v: Array) -> tuple[float, float]:
    """The least and the largest temperature of a run, degC."""
    return min(float(v[run.first]), float(v[run.last])), max(float(v[run.first]), float(v[run.last]))


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> float:
    """How wide the part is that both ranges have, K; below 0 where they have none."""
    return min(one[1], other[1]) - max(one[0], other[0])


def _range_that_counts(runs: list[Run], v: Array, y: Array, good: NDArray[np.bool_]) -> tuple[float, float]:
    """What a major branch has to go through, degC: what the widest run of either sense has in common with the widest of
    the other, where each shows nearly all that the output does there; else the range of the record."""
    whole = float(v.min()), float(v.max())
    senses = ([run for run in runs if run.heating], [run for run in runs if not run.heating])
    if not all(senses) or not np.any(good):
        return whole
    widest = [max(of, key=lambda run: abs(float(v[run.last] - v[run.first]))) for of in senses]
    (one, other) = (_ends(run, v) for run in widest)
    low, high = max(one[0], other[0]), min(one[1], other[1])
    for run in widest:
        rows = np.arange(run.first, run.last + 1)
        seen = y[rows[good[rows] & (v[rows] >= low) & (v[rows] <= high)]]
        if seen.size < FEWEST_ROWS or np.ptp(seen) < WHOLE * np.ptp(y[good]):
            return whole
    return low, high


def _unseen(v: Array, y: Array, range_K: float, span: float) -> float:
    """The share of a run that has no readings, in the range of temperatures or in the output's span, whichever is more:
    steps between readings that are far longer than the others."""
    steps, moved = np.abs(np.diff(v)), np.abs(np.diff(y))
    if not steps.size:
        return 0.0
    holes = steps > max(UNSEEN * range_K, MANY * float(np.median(steps)))
    return max(float(np.sum(steps[holes])) / range_K, float(np.sum(moved[holes])) / max(span, 1e-300))


def _rate(time_s: Array, v: Array) -> float:
    """The rate of a run in the middle half of its range, K/s, > 0: without what it waits at its ends."""
    share = np.abs(v - v[0]) / max(abs(float(v[-1] - v[0])), 1e-300)
    inside = np.flatnonzero((share >= 0.25) & (share <= 0.75))
    first, last = (int(inside[0]), int(inside[-1])) if inside.size > 1 else (0, v.size - 1)
    return abs(float(v[last] - v[first])) / max(float(time_s[last] - time_s[first]), 1e-300)


def _groups(rows: NDArray[np.int64], most: int) -> list[NDArray[np.int64]]:
    """At most so many groups of neighbouring rows."""
    return [group for group in np.array_split(rows, min(most, max(rows.size, 1))) if group.size]
