"""film_drift (film): the transition walks.

    T_f = T_p + drift_K_per_h t,   t from the first row on

Met: 0.1 .. 3 K/h, either sign (ageing, moisture, a slipping contact of the thermometer looks the same).
Source: the first term of any slow change; the sizes are a choice.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Warming


def add(par: Array, time_s: Array, power_W: Array) -> Array:
    """Return K added to the plate's temperature."""
    return np.asarray(par[0] * time_s / 3600.0)


EFFECT = Effect(
    "film_drift",
    "film",
    (Parameter("drift_K_per_h", 0.1, 3.0, signed=True),),
    Warming(add),
    "the film's transition drifts",
    "repeat the first cycle at the end (A-B-A); a second thermometer tells the film from the sensor",
    order=2,
)
