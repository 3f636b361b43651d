"""self_heating (film): the ohmmeter's test current heats the film above the plate.

    T_f = T_p + theta_K_per_W I_m^2 R

Met: 100 .. 1e4 K/W (a film on a substrate; a bridge on a membrane). Source: Joule's law and the film's thermal
resistance; Keithley, Low Level Measurements Handbook (7th ed.), sec. 3.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Warming


def add(par: Array, time_s: Array, power_W: Array) -> Array:
    """Return K above the plate."""
    return np.asarray(par[0] * power_W)


EFFECT = Effect(
    "self_heating",
    "film",
    (Parameter("theta_K_per_W", 100.0, 1e4),),
    Warming(add, heated=True),
    "the ohmmeter's test current heats the film",
    "a smaller test current, or a pulsed one; repeat at a third of the current",
    order=1,
)
