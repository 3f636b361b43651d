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
from dataclasses import dataclass

import numpy as np
from numba import njit

from compensator.hysteresis.functions import Array


@njit(cache=True)
def output_of(
    gains: Array,
    integral: float,
    derivative: float,
    weighted_error: float,
    setpoint: float,
    measured: float,
    period: float,
) -> tuple[float, float, float]:
    """(P + I + D, derivative, c r - y) at this sample; gains: (kp, ki, kd, filter time, tracking time, b, c)."""
    error = gains[6] * setpoint - measured
    change = 0.0 if math.isnan(weighted_error) else error - weighted_error
    derivative = (gains[3] * derivative + gains[2] * change) / (gains[3] + period)
    return gains[0] * (gains[5] * setpoint - measured) + integral + derivative, derivative, error


@njit(cache=True)
def integral_of(
    gains: Array, integral: float, setpoint: float, measured: float, shortfall: float, period: float
) -> float:
    """The integral for the next sample; shortfall: what was applied minus what was wanted."""
    integral += gains[1] * period * (setpoint - measured)
    return float(integral + min(period / gains[4], 1.0) * shortfall)


@dataclass(frozen=True)
class PidGains:
    """Kp in u/y, Ki in u/(y s), Kd in u s/y, times in s. b, c: setpoint weights of P and D."""

    kp: float
    ki: float
    kd: float = 0.0
    filter_time_s: float = 0.0
    tracking_time_s: float = math.inf
    b: float = 1.0
    c: float = 0.0

    def array(self) -> Array:
        """(kp, ki, kd, filter time, tracking time, b, c) as the compiled loops take them."""
        times = self.filter_time_s, self.tracking_time_s
        return np.array([self.kp, self.ki, self.kd, *times, self.b, self.c], dtype=np.float64)


@dataclass(frozen=True)
class PidState:
    """Integral and filtered derivative in units of u, and c r - y of the sample before."""

    integral: float = 0.0
    derivative: float = 0.0
    weighted_error: float = math.nan


def pid_output(
    gains: PidGains, state: PidState, setpoint: float, measured: float, period_s: float
) -> tuple[float, PidState]:
    """P + I + D at this sample, unlimited, and the state with its derivative brought up to date."""
    output, derivative, error = output_of(
        gains.array(), state.integral, state.derivative, state.weighted_error, setpoint, measured, period_s
    )
    return output, PidState(state.integral, derivative, error)


def pid_integrate(
    gains: PidGains, state: PidState, setpoint: float, measured: float, shortfall: float, period_s: float
) -> PidState:
    """The integral for the next sample; shortfall: what was applied minus what was wanted (0 when not limited)."""
    integral = integral_of(gains.array(), state.integral, setpoint, measured, shortfall, period_s)
    return PidState(integral, state.derivative, state.weighted_error)


def bumpless(gains: PidGains, new: PidGains, state: PidState, setpoint: float, measured: float) -> PidState:
    """The state with which new gains give the output of the old ones at this sample."""
    proportional = gains.kp * (gains.b * setpoint - measured) - new.kp * (new.b * setpoint - measured)
    return PidState(state.integral + proportional, state.derivative, new.c * setpoint - measured)
