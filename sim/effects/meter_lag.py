"""meter_lag (ohmmeter): a first-order filter on log R.

    tau_s d(log R_m)/dt = log R - log R_m

Met: 0.2 .. 10 s (a digital filter, a long integration, a cable's capacitance at high resistance). Source: Keithley,
Model 2000 Multimeter User's Manual, sec. 3, filter.
"""

from __future__ import annotations

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Filter, Parameter
from sim.effects.lag import first_order_lag, first_order_lag_of_columns


@njit
def run(par: Array, time: Array, values: Array, state: Array, out: Array) -> None:
    """The meter's log R for the film's."""
    first_order_lag(par[0], time, values, state, out)


@njit
def run_columns(par: Array, time: Array, values: Array, out: Array) -> None:
    """The same of many."""
    first_order_lag_of_columns(par[0], time, values, out)


EFFECT = Effect(
    "meter_lag",
    "ohmmeter",
    (Parameter("tau_s", 0.2, 10.0),),
    Filter(run, "log_resistance", run_columns),
    "the ohmmeter lags behind the resistance",
    "switch the meter's filter off, integrate for a shorter time, shorter cables",
    order=2,
)
