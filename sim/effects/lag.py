"""The first-order lag that thermometer, film and ohmmeter share, exact for an input that is linear between nodes.

tau dx/dt = u - x;   u from u_0 to u_1 in dt, m = (u_1 - u_0) / dt:
x_1 = u_1 - tau m + (x_0 - u_0 + tau m) exp(-dt / tau)
"""

from __future__ import annotations

import math

from compensator.compiled import njit
from compensator.hysteresis.functions import Array


@njit
def first_order_lag(tau: float, time: Array, values: Array, state: Array, out: Array) -> None:
    """out follows values, both of shape (nodes,) at `time` (s); state (1,): x at the first node, at the last on return
    (nan: as if values had been constant before)."""
    x = state[0]
    if math.isnan(x):
        x = values[0]
    out[0] = x
    same, decay = 0.0, 1.0  # of nodes that are as far apart as the two before, the exponential is known
    for k in range(1, values.size):
        dt = time[k] - time[k - 1]
        if dt > 0.0:
            if tau <= 1e-9:
                x = values[k]
            else:
                if dt != same:
                    same, decay = dt, math.exp(-dt / tau)
                ramp = tau * (values[k] - values[k - 1]) / dt
                x = values[k] - ramp + (x - values[k - 1] + ramp) * decay
        out[k] = x
    state[0] = x


@njit
def first_order_lag_of_columns(tau: float, time: Array, values: Array, out: Array) -> None:
    """The same for each column of values, (nodes, columns), at rest before the first node, to the bit: the nodes'
    exponentials are computed once for all of them."""
    out[0] = values[0]
    for k in range(1, values.shape[0]):
        dt = time[k] - time[k - 1]
        if dt <= 0.0:
            out[k] = out[k - 1]
        elif tau <= 1e-9:
            out[k] = values[k]
        else:
            decay = math.exp(-dt / tau)
            for j in range(values.shape[1]):
                ramp = tau * (values[k, j] - values[k - 1, j]) / dt
                out[k, j] = values[k, j] - ramp + (out[k - 1, j] - values[k - 1, j] + ramp) * decay
