"""thermometer_quantization (thermometer): readings are rounded to a step.

    T_shown = step_K round(T / step_K)

Met: 0.05 .. 0.5 K (a thermocouple converter of 0.25 K, an 8-bit scale). A step below half the noise is no finding,
a file's own last digit neither. Source: B. Widrow, I. Kollar, Quantization Noise (Cambridge 2008), ch. 1.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Reading


def read(par: Array, values: Array) -> Array:
    """Return values on the lattice of the step."""
    step = par[0]
    return values if step <= 0.0 else step * np.round(values / step)


EFFECT = Effect(
    "thermometer_quantization",
    "thermometer",
    (Parameter("step_K", 0.05, 0.5),),
    Reading(read, rounding=True),
    "the thermometer's readings are rounded coarsely",
    "read more digits, or a converter with a finer step",
    order=1,
)
