"""series_resistance (ohmmeter): leads and contacts in series with the film (two wires).

    R_m = R + series_ohm

Met: 0.5 .. 500 ohm. Source: Keithley, Low Level Measurements Handbook (7th ed.), sec. 3, lead resistance.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Parameter, Reading


def read(par: Array, values: Array) -> Array:
    """Return the resistance of film and leads."""
    return np.asarray(values + par[0])


EFFECT = Effect(
    "series_resistance",
    "ohmmeter",
    (Parameter("series_ohm", 0.5, 500.0),),
    Reading(read),
    "leads and contacts are measured with the film",
    "measure with four wires",
)
