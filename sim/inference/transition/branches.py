"""The runs of a record between two turning points of its temperature, and which of them are major branches.

A run is a major branch where it goes through `WHOLE` of the range that counts, so that the film comes from saturation
if that is wide enough. The range that counts is the one that heating and cooling both reach, where both show `WHOLE` of
all that the output does in the record: the way up from a room that the film is not cooled to again does not make the
loop wider. Else it is the record's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.temperature_path import turning_points

Sense = Literal["heating", "cooling"]
SENSES: Final[tuple[Sense, Sense]] = ("heating", "cooling")
WHOLE: Final = 0.85  # of the range that counts: a first sweep from a room somewhat warmer than the cold end is one
RIPPLE: Final = 0.02  # of the range: a controller's overshoot, no reversal that was meant
RIPPLE_NOISE: Final = 3.0  # standard deviations of the thermometer's noise
UNSEEN: Final = 0.05  # of the range without a reading, and ...
MANY: Final = 8.0  # ... median steps: what lies between was not measured
FEWEST_ROWS: Final = 20  # of a branch, below which it has no shape


@dataclass(frozen=True, eq=False)
class Run:
    """Rows first..last (both included) between two turning points of the temperature."""

    first: int
    last: int
    heating: bool


@dataclass(frozen=True, eq=False)
class MajorBranch:
    """How a record shows a major branch: the rows of its readings; how many runs; the median rate, K/s, > 0."""

    rows: NDArray[np.int64]
    runs: int
    rate_K_per_s: float


def runs_of(degC: Array, noise_K: float) -> list[Run]:
    """Return the runs of a record in the order of time. noise_K: of its thermometer."""
    least = max(RIPPLE * float(np.ptp(degC)), RIPPLE_NOISE * noise_K)
    return [Run(int(a), int(b), bool(degC[b] > degC[a])) for a, b in pairwise(turning_points(degC, least))]


def onward_rows(degC: Array, run: Run) -> NDArray[np.int64]:
    """Return the rows of a run in which the temperature is further than in any row of the run before: in the others, of
    a ripple, the film is inside a minor loop."""
    part = degC[run.first : run.last + 1]
    furthest = np.maximum.accumulate(part) if run.heating else np.minimum.accumulate(part)
    return np.asarray(run.first + np.flatnonzero(part == furthest), dtype=np.int64)


def major_branches(
    time_s: Array, degC: Array, output: Array, noise_K: float
) -> tuple[dict[Sense, MajorBranch], tuple[float, float]]:
    """Return the branches that a record has, none to two, and the range that counts, degC. Arrays of shape (rows,): s,
    the temperature's path in degC, the film's output (nan: no reading)."""
    good, runs, found = np.isfinite(output), runs_of(degC, noise_K), {}
    low, high = _range_that_counts(runs, degC, output, good)
    span = float(np.ptp(output[good])) if np.any(good) else 0.0
    for sense in SENSES:
        rows = []
        for run in runs:
            if run.heating != (sense == "heating"):
                continue
            ends, row = np.sort(degC[[run.first, run.last]]), onward_rows(degC, run)
            row = row[good[row]]
            seen = (min(ends[1], high) - max(ends[0], low)) / (high - low)
            if seen - _unseen(degC[row], output[row], high - low, span) >= WHOLE:
                rows.append(row)
        if sum(row.size for row in rows) >= FEWEST_ROWS:
            rate = float(np.median([_rate(time_s[row], degC[row]) for row in rows]))
            found[sense] = MajorBranch(np.concatenate(rows), len(rows), rate)
    return found, (low, high)


def _range_that_counts(runs: list[Run], degC: Array, output: Array, good: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the range that the widest runs of both senses share, degC, where each shows nearly all that the output
    does there; else the range of the record."""
    whole = float(degC.min()), float(degC.max())
    senses = ([run for run in runs if run.heating], [run for run in runs if not run.heating])
    if not all(senses) or not np.any(good):
        return whole
    widest = [max(of, key=lambda run: abs(float(degC[run.last] - degC[run.first]))) for of in senses]
    ends = np.sort([degC[[run.first, run.last]] for run in widest], axis=1)
    low, high = float(np.max(ends[:, 0])), float(np.min(ends[:, 1]))
    for run in widest:
        rows = np.arange(run.first, run.last + 1)
        seen = output[rows[good[rows] & (degC[rows] >= low) & (degC[rows] <= high)]]
        if seen.size < FEWEST_ROWS or np.ptp(seen) < WHOLE * np.ptp(output[good]):
            return whole
    return low, high


def _unseen(degC: Array, output: Array, range_K: float, span: float) -> float:
    """Return the share of a run that has no readings, in the range of temperatures or in the output's span, whichever
    is more: steps between readings that are far longer than the others."""
    steps, moved = np.abs(np.diff(degC)), np.abs(np.diff(output))
    if not steps.size:
        return 0.0
    holes = steps > max(UNSEEN * range_K, MANY * float(np.median(steps)))
    return max(float(np.sum(steps[holes])) / range_K, float(np.sum(moved[holes])) / max(span, 1e-300))


def _rate(time_s: Array, degC: Array) -> float:
    """Return the rate of a run in the middle half of its range, K/s: without what it waits at its ends."""
    share = np.abs(degC - degC[0]) / max(abs(float(degC[-1] - degC[0])), 1e-300)
    inside = np.flatnonzero((share >= 0.25) & (share <= 0.75))
    first, last = (int(inside[0]), int(inside[-1])) if inside.size > 1 else (0, degC.size - 1)
    return abs(float(degC[last] - degC[first])) / max(float(time_s[last] - time_s[first]), 1e-300)
