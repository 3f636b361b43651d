"""Discrete PID with two degrees of freedom, derivative filter and anti-windup.

    P_k = Kp (b r_k - y_k)
    D_k = Tf / (Tf + h) D_(k-1) + Kd / (Tf + h) ((c r_k - y_k) - (c r_(k-1) - y_(k-1)))
    v_k = P_k + I_k + D_k + feedforward
    u_k = v_k held within [low, high] by what follows
    I_(k+1) = I_k + Ki h (r_k - y_k) + h / Tt (u_k - v_k)              back-calculation, tracking time Tt

r setpoint, y process variable, u manipulated variable, h period. Source: Astrom and Hagglund, Advanced PID Control
(ISA 2006), ch. 3 (set-point weights, anti-windup) and 13 (discretization).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from compensator.compiled import njit


class PidGains(NamedTuple):
    """Gains: Kp in u/y, Ki in u/(y s), Kd in u s/y, times in s. b, c: setpoint weights of P and D."""

    kp: float
    ki: float
    kd: float = 0.0
    filter_time_s: float = 0.0
    tracking_time_s: float = math.inf
    b: float = 1.0
    c: float = 0.0


class PidState(NamedTuple):
    """Integral and filtered derivative in units of u, and c r - y of the sample before."""

    integral: float = 0.0
    derivative: float = 0.0
    weighted_error: float = math.nan


@njit
def pid_output(
    gains: PidGains, state: PidState, setpoint: float, measured: float, period_s: float
) -> tuple[float, PidState]:
    """Return P + I + D at this sample, unlimited, and the state with its derivative brought up to date."""
    error = gains.c * setpoint - measured
    change = 0.0 if math.isnan(state.weighted_error) else error - state.weighted_error
    derivative = (gains.filter_time_s * state.derivative + gains.kd * change) / (gains.filter_time_s + period_s)
    output = gains.kp * (gains.b * setpoint - measured) + state.integral + derivative
    return output, PidState(state.integral, derivative, error)


@njit
def pid_integrate(
    gains: PidGains, state: PidState, setpoint: float, measured: float, shortfall: float, period_s: float
) -> PidState:
    """Return the state with the integral for the next sample; shortfall: applied minus wanted (0 if not limited)."""
    integral = state.integral + gains.ki * period_s * (setpoint - measured)
    integral += min(period_s / gains.tracking_time_s, 1.0) * shortfall
    return PidState(integral, state.derivative, state.weighted_error)
