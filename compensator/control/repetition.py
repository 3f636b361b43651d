"""Repetition: the error of the film model along a course, from the readings of one run, without their noise.

A law that goes by a film model takes it off the readings and off the target when it follows the same course again.

    error' = error + w,   variance of w: q |step of the course| + CREEP r,   reading - model = error + noise

A film outside the model's class is off by a random walk along the output's course, and takes the same walk whenever it
takes the same course. During a run only the past is known; after it the readings of both sides are, and this is their
best estimate: a Kalman filter, and back (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445). q maximizes the
likelihood of the readings; their noise r comes from second differences.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

FEWEST: Final = 64  # readings; of fewer neither noise nor error can be told
CREEP: Final = 2e-5  # of the noise's variance, a reading: a film that stands still creeps by next to nothing
MEDIAN: Final = 0.6745  # of the absolute value of a normal variable, in standard deviations
WALKS: Final = (-6.0, 2.0)  # log10 of the walk's variance over the noise's, a mean step: from none to no smoothing


@njit
def _filtered(off: Array, variances: Array, noise: float) -> tuple[float, Array, Array]:
    """Return (log-likelihood, estimates, their variances); variances: of each step; off: nan if there is no reading."""
    found, doubts = np.empty(off.size), np.empty(off.size)
    here, doubt, likelihood, begun = 0.0, 0.0, 0.0, False
    for i in range(off.size):
        doubt += variances[i]
        if not math.isnan(off[i]):
            if begun:
                whole, innovation = doubt + noise, off[i] - here
                likelihood -= 0.5 * (math.log(whole) + innovation * innovation / whole)
                here += doubt / whole * innovation
                doubt *= noise / whole
            else:
                here, doubt, begun = off[i], noise, True
        found[i], doubts[i] = here, doubt
    return likelihood, found, doubts


@njit
def _back(found: Array, doubts: Array, variances: Array) -> Array:
    """Return the estimates with the readings after them."""
    smooth = found.copy()
    for i in range(found.size - 2, -1, -1):
        whole = doubts[i] + variances[i + 1]
        if whole > 0.0:
            smooth[i] += doubts[i] / whole * (smooth[i + 1] - found[i])
    return smooth


def model_error(off: Array, steps: Array) -> Array:
    """Return the error of the model at each row, shape (rows,): 0 if there are too few readings.

    off: readings less the model, nan if there is none. steps: of the course since the row before, >= 0.
    """
    good = np.isfinite(off)
    bends = np.diff(off, 2)
    bends = bends[np.isfinite(bends)]
    if int(np.sum(good)) < FEWEST or bends.size < FEWEST // 2:
        return np.zeros(off.size)
    noise = max(float(np.median(np.abs(bends))) / MEDIAN, 1e-12) ** 2 / 6.0
    course, mean = np.abs(steps), float(np.mean(np.abs(steps)))

    def variances(walk: float) -> Array:
        return np.asarray(noise * (CREEP + (10.0**walk * course / mean if mean > 0.0 else 0.0 * course)))

    walk = minimize_scalar(
        lambda walk: -_filtered(off, variances(walk), noise)[0], bounds=WALKS, method="bounded", options={"xatol": 0.05}
    ).x
    _, found, doubts = _filtered(off, variances(walk), noise)
    first = int(np.argmax(good))
    found[:first] = found[first]
    return _back(found, doubts, variances(walk))
