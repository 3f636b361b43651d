"""parallel_leakage (ohmmeter): a shunt across the film.

    1 / R_m = 1 / R + 1 / leakage_ohm

Met: 1e5 .. 1e9 ohm. Source: Keithley, Low Level Measurements Handbook (7th ed.), sec. 2, leakage and guarding.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Reading


def read(par: Array, values: Array) -> Array:
    """Return the resistance of film and shunt."""
    return np.asarray(values / (1.0 + values / par[0]))


EFFECT = Effect(
    "parallel_leakage",
    "ohmmeter",
    (Parameter("leakage_ohm", 1e5, 1e9),),
    Reading(read),
    "a leakage path is in parallel to the film",
    "clean and dry the sample holder; a guard; measure it with the film taken off",
    order=1,
    inverse=True,
)
