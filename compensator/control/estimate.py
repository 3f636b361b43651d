"""How noisy the two instruments are, and the heating that the plate model does not know of, as the law takes them.

noise    of both readings, from their second differences: white noise on a smooth course

Plate and unknown heat are told by `compensator.control.unknown_heat`, what the film model lacks by
`compensator.control.disturbance`. Every function takes an estimate and returns the next one; none is changed.
"""

from __future__ import annotations

import math
from math import nan
from typing import Final, NamedTuple

from numba import njit

NOISE_FIRST, NOISE_MANY = 20.0, 300.0  # readings that the first guess of the noise counts for, and that count at most
TINY: Final = 1e-12  # of a variance: an instrument without noise
STRANGE: Final = 16.0  # square of a reading's standard deviations off that counts at the most: beyond, it says no more


class Noise(NamedTuple):
    """Of one instrument: the variance of its readings, the last two of them, how many have counted."""

    variance: float
    last: float = nan
    before: float = nan
    readings: float = 0.0


class Estimate(NamedTuple):
    """What is known beside temperature and output themselves.

    drift_K_per_s: heating that the plate model does not know of. degC, output: the noise of the two readings.
    """

    drift_K_per_s: float = 0.0
    degC: Noise = Noise(1e-4)
    output: Noise = Noise(4e-6)


@njit(cache=True)
def learned_noise(noise: Noise, value: float) -> Noise:
    """One more reading: its noise's variance from its second difference, over some hundred readings."""
    variance, readings = noise.variance, noise.readings
    if not math.isnan(noise.before):
        bend = value - 2.0 * noise.last + noise.before
        readings = min(readings + 1.0, NOISE_MANY)
        variance += (bend * bend / 6.0 - variance) / (readings + NOISE_FIRST)
    return Noise(variance, value, noise.last, readings)


@njit(cache=True)
def less_likely(log_weight: float, innovation: float, variance: float) -> float:
    """The logarithm of a filter's weight after a reading that is so far off what it foretold, with that variance."""
    return log_weight - 0.5 * (math.log(variance) + min(innovation * innovation / variance, STRANGE))
