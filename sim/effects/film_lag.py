"""film_lag (film): the film's temperature follows the plate's with a first-order lag.

    tau_s dT_f/dt = T_p - T_f

Met: 0.2 .. 10 s (substrate and bond between plate and film). Source: F. P. Incropera et al., Fundamentals of Heat and
Mass Transfer (Wiley 2007), ch. 5, lumped capacitance.
"""

from __future__ import annotations

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Filter, Parameter
from sim.effects.lag import first_order_lag


@njit
def run(par: Array, time: Array, values: Array, state: Array, out: Array) -> None:
    """The film's temperature for the plate's."""
    first_order_lag(par[0], time, values, state, out)


EFFECT = Effect(
    "film_lag",
    "film",
    (Parameter("tau_s", 0.2, 10.0),),
    Filter(run, "film_temperature"),
    "the film lags behind the plate",
    "better thermal contact of the substrate; slower ramps",
)
