"""sensor_lag (thermometer): the thermometer follows the plate with a first-order lag.

    tau_s dT_th/dt = T_p - T_th

Met: 0.2 .. 30 s (a thermistor in grease; a thermocouple on the far side of a holder). Source: F. P. Incropera et al.,
Fundamentals of Heat and Mass Transfer (Wiley 2007), ch. 5, lumped capacitance.
"""

from __future__ import annotations

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Filter, Parameter
from sim.effects.lag import first_order_lag


@njit
def run(par: Array, time: Array, values: Array, state: Array, out: Array) -> None:
    """The thermometer's temperature for the plate's."""
    first_order_lag(par[0], time, values, state, out)


EFFECT = Effect(
    "sensor_lag",
    "thermometer",
    (Parameter("tau_s", 0.2, 30.0),),
    Filter(run, "thermometer"),
    "the thermometer lags behind the plate",
    "better thermal contact of the thermometer to the plate; a smaller one; slower ramps",
)
