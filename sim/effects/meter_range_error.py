"""meter_range_error (ohmmeter): a gain error on the ranges above a threshold, a step in log R.

    R_m = R (1 + error) where R > threshold_ohm, else R

Met: threshold 1e3, 1e4, ... ohm; error 0.002 .. 0.05. Source: Keithley, Model 2000 Multimeter Service Manual, sec. 1,
resistance calibration range by range.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Reading

THRESHOLDS_OHM = tuple(float(10.0**k) for k in range(1, 9))


def read(par: Array, values: Array) -> Array:
    """Return the range's error on the values above the threshold."""
    return np.where(values > par[0], values * (1.0 + par[1]), values)


EFFECT = Effect(
    "meter_range_error",
    "ohmmeter",
    (
        Parameter("threshold_ohm", THRESHOLDS_OHM[0], THRESHOLDS_OHM[-1], choices=THRESHOLDS_OHM),
        Parameter("error", 0.002, 0.05, signed=True),
    ),
    Reading(read, linear=True),
    "the ohmmeter's ranges do not agree",
    "calibrate the meter, or hold it on one range",
    order=4,
)
