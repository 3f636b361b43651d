"""creep (film): a share of the hysteretic part follows with a slow first-order lag.

    H'(t) = (1 - share) H(t) + share x(t),   tau_s dx/dt = H - x,   H = sum_j p_j F_j[T_f]

Met: share 0.02 .. 0.3; tau_s 50 .. 2000 s (domains that switch late). Source: K. Kuhnen, P. Krejci, IEEE Trans.
Autom. Control 54 (2009) 537, log-type creep beside hysteresis, here with one time constant.
"""

from __future__ import annotations

import math

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Filter, Parameter
from sim.effects.lag import first_order_lag, first_order_lag_of_columns


@njit
def run(par: Array, time: Array, values: Array, state: Array, out: Array) -> None:
    """The hysteretic part with its slow share."""
    if math.isnan(state[0]):
        state[0] = values[0]
    first_order_lag(par[1], time, values, state, out)
    for k in range(out.size):
        out[k] = values[k] + par[0] * (out[k] - values[k])


@njit
def run_columns(par: Array, time: Array, values: Array, out: Array) -> None:
    """The same of many parts."""
    first_order_lag_of_columns(par[1], time, values, out)
    for k in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[k, j] = values[k, j] + par[0] * (out[k, j] - values[k, j])


EFFECT = Effect(
    "creep",
    "film",
    (Parameter("share", 0.02, 0.3), Parameter("tau_s", 50.0, 2000.0)),
    Filter(run, "hysteretic_part", run_columns),
    "a share of the film switches late",
    "longer dwells; a slow against a fast loop",
    order=3,
)
