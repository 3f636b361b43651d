"""timestamp_skew (ohmmeter): the reading stamped t was taken at t - skew_s.

    R_m(t) = R(t - skew_s)

Met: 0.1 .. 5 s, either sign (two clocks; a reading from the meter's buffer). Source: the definition.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, ReadingTime


def taken(par: Array, time_s: Array) -> Array:
    """Return when the value was taken."""
    return np.asarray(time_s - par[0])


EFFECT = Effect(
    "timestamp_skew",
    "ohmmeter",
    (Parameter("skew_s", 0.1, 5.0, signed=True),),
    ReadingTime(taken),
    "the ohmmeter's time stamps are off",
    "one clock for both instruments; an event that both of them log",
    order=3,
)
