"""Where rows of a record are missing, and which of these gaps a film's memory is not known through.

A step far above the usual one is a gap. In a short one a plate does not turn round, and the temperature went straight
from one row to the next; in a long one it may have gone anywhere, and what the film remembers after it is unknown.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

GAP: Final = 1.5  # in median steps, or in those that are longer than nearly all
UNEVEN: Final = 95.0  # percentile of the steps: where sampling is uneven, 1.5 times that
SHORT: Final = 6.0  # median steps: a plate does not turn round in a shorter gap
LONGEST: Final = 12  # long gaps of a record that are looked at: each costs a search
Rows = NDArray[np.int64]


def gap_threshold(steps_s: Array) -> float:
    """Return the step above which steps are gaps: 1.5 medians, or, where sampling is uneven, 1.5 times the 95th
    percentile. Sampling is uneven where many steps are long, or are no multiples of the median."""
    median = float(np.median(steps_s))
    medians = steps_s / median
    if np.mean(medians > GAP) > 0.1 or np.mean(np.abs(medians - np.round(medians)) < 0.1) < 0.9:
        return GAP * float(np.percentile(steps_s, UNEVEN))
    return GAP * median


def rows_after_gaps(time_s: Array) -> Rows:
    """Return the row after each gap."""
    steps = np.diff(time_s)
    if not steps.size:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(steps > gap_threshold(steps)) + 1


def long_gaps(time_s: Array, after: Rows) -> Rows:
    """Of the rows after gaps those after one in which a plate may have turned round."""
    if not after.size:
        return after
    interval_s = float(np.median(np.diff(time_s)))
    return after[time_s[after] - time_s[after - 1] > SHORT * interval_s]


def longest_of(after: Rows, lasted_s: Array) -> Rows:
    """Of the rows after gaps those after the longest ones, as many as are looked at. lasted_s: how long each was."""
    return np.sort(after[np.argsort(-lasted_s, kind="stable")[:LONGEST]])
