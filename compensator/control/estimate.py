"""How noisy the two instruments are, and the heating that the plate model does not know of, as the law takes them.

noise    of both readings, from how far each is off the line through the two before it: white, on a smooth course

Plate and unknown heat are told by `compensator.control.unknown_heat`, what the film model lacks by
`compensator.control.disturbance`. Every function takes an estimate and returns the next one; none is changed.
"""

from __future__ import annotations

import math
from math import nan
from typing import Final, NamedTuple

from compensator.compiled import njit

NOISE_FIRST, NOISE_MANY = 20.0, 300.0  # readings that the first guess of the noise counts for, and that count at most
TINY: Final = 1e-12  # of a variance: an instrument without noise
STRANGE: Final = 16.0  # square of a reading's standard deviations off that counts at the most: beyond, it says no more


class Noise(NamedTuple):
    """Of one instrument: the variance of its readings, the last two of them, how many have counted; apart_s: the time
    between those two; ago_s: since the last."""

    variance: float
    last: float = nan
    before: float = nan
    readings: float = 0.0
    apart_s: float = nan
    ago_s: float = 0.0


class Estimate(NamedTuple):
    """What is known beside temperature and output themselves.

    drift_K_per_s: heating that the plate model does not know of. drive_error: by what share of it the drive heats and
    cools more than the model says. degC, output: the noise of the two readings.
    """

    drift_K_per_s: float = 0.0
    drive_error: float = 0.0
    degC: Noise = Noise(1e-4)
    output: Noise = Noise(4e-6)


@njit
def learned_noise(noise: Noise, value: float, since_s: float) -> Noise:
    """since_s later one more reading, or nan: none. Its noise's variance from how far it is off the straight line
    through the two before it (with even times that is their second difference), over some hundred readings."""
    variance, readings, ago_s = noise.variance, noise.readings, noise.ago_s + since_s
    if math.isnan(value):
        return Noise(variance, noise.last, noise.before, readings, noise.apart_s, ago_s)
    if not math.isnan(noise.before):
        ratio = ago_s / noise.apart_s
        bend = value - noise.last - ratio * (noise.last - noise.before)
        readings = min(readings + 1.0, NOISE_MANY)
        own = bend * bend / (1.0 + (1.0 + ratio) ** 2 + ratio * ratio)
        variance += (own - variance) / (readings + NOISE_FIRST)
    return Noise(variance, value, noise.last, readings, ago_s, 0.0)


@njit
def less_likely(log_weight: float, innovation: float, variance: float) -> float:
    """The logarithm of a filter's weight after a reading that is so far off what it foretold, with that variance."""
    return log_weight - 0.5 * (math.log(variance) + min(innovation * innovation / variance, STRANGE))
