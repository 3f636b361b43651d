"""The PI controllers of the law, discrete and with anti-windup, and gains from the plate model with their margins.

    v_k = Kp (r_k - y_k) + I_k,   u_k = v_k held within [low, high] by what follows
    I_(k+1) = I_k + Ki h (r_k - y_k) + h / Tt (u_k - v_k)              back-calculation, tracking time Tt

r setpoint, y process variable, u manipulated variable, h period. Source: Astrom and Hagglund, Advanced PID Control
(ISA 2006), ch. 3 (anti-windup) and 13 (discretization). No derivative: a plate is of the first order.

The control law turns a heating rate (K/s) into a current through the plate's inverse, so that the plate seen by the
temperature PID is an integrator with the sample-and-hold's and the bench's dead time. A PID on log R alone sees the
plate linearized at a working point, times the film's steepest slope. Rules: S. Skogestad, J. Process Control 13
(2003) 291 (SIMC), with the closed-loop time constant lengthened until the largest sensitivity is the wanted Ms.

A temperature controller's own PID, I = Kp (e + 1/Ti integral of e dt - Td dT/dt) with e = setpoint - T, is designed by
the same rules for the plate where it answers most, until the thermometer's noise moves the current by no more than a
share of its limit (`design_own_pid`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel


class PidGains(NamedTuple):
    """Gains: Kp in u/y, Ki in u/(y s), tracking time in s."""

    kp: float
    ki: float
    tracking_time_s: float = math.inf


@njit
def pi_output(gains: PidGains, integral: float, setpoint: float, measured: float) -> float:
    """Return P + I at this sample, unlimited."""
    return gains.kp * (setpoint - measured) + integral


@njit
def pi_integrated(
    gains: PidGains, integral: float, setpoint: float, measured: float, shortfall: float, period_s: float
) -> float:
    """Return the integral for the next sample; shortfall: applied minus wanted (0 if not limited)."""
    integral += gains.ki * period_s * (setpoint - measured)
    return integral + min(period_s / gains.tracking_time_s, 1.0) * shortfall


SPLINE = 6  # each so many frequencies, between which python-control's splines find crossings: margins to 2e-5


@dataclass(frozen=True)
class Margins:
    """Gain margin (ratio), phase margin (degrees), maximum sensitivity Ms and the crossover (rad/s)."""

    gain_margin: float
    phase_margin_deg: float
    ms: float
    crossover_rad_per_s: float


@dataclass(frozen=True)
class Design:
    """Gains with their margins, and the process that they were designed for."""

    gains: PidGains
    margins: Margins
    closed_loop_time_s: float
    process_gain: float
    process_pole_per_s: float
    dead_time_s: float
    period_s: float


def sampled_loop(gains: PidGains, gain: float, pole_per_s: float, dead_time_s: float, period_s: float) -> Any:
    """Return PID(z) G(z), G the zero-order hold of gain e^(-dead_time s) / (s + pole), as a python-control function.

    The dead time is taken in whole periods, rounded up.
    """
    import control

    z = control.tf([1.0, 0.0], [1.0], period_s)
    steps = math.ceil(dead_time_s / period_s - 1e-9)
    if pole_per_s == 0.0:
        held = control.tf([gain * period_s], [1.0, -1.0], period_s)
    else:
        shrink = math.exp(-pole_per_s * period_s)
        held = control.tf([gain * (1.0 - shrink) / pole_per_s], [1.0, -shrink], period_s)
    delay = control.tf([1.0], [1.0, *([0.0] * steps)], period_s) if steps else control.tf([1.0], [1.0], period_s)
    return (gains.kp + gains.ki * period_s / (z - 1.0)) * held * delay


def loop_response(loop: Any, period_s: float) -> tuple[Array, Any]:
    """Return frequencies (rad/s) up to Nyquist's, and the loop's complex response there."""
    omega = np.logspace(-4.0, math.log10(0.9999 * math.pi / period_s), 2000)
    return omega, np.asarray(loop(np.exp(1j * omega * period_s)))


def maximum_sensitivity(loop: Any, period_s: float) -> float:
    """Return Ms, the largest |1 / (1 + L)|; infinite if the closed loop is not stable."""
    import control

    if not np.all(np.abs(np.asarray(control.feedback(loop, 1).poles())) < 1.0):
        return math.inf
    return float(np.max(1.0 / np.abs(1.0 + loop_response(loop, period_s)[1])))


def loop_margins(loop: Any, period_s: float) -> Margins:
    """Return gain margin, phase margin, Ms and crossover of a sampled loop."""
    import control

    omega, response = loop_response(loop, period_s)
    gain_margin, phase_margin, _, crossover = control.margin(
        control.frd(response[::SPLINE], omega[::SPLINE], smooth=True)
    )
    return Margins(float(gain_margin), float(phase_margin), maximum_sensitivity(loop, period_s), float(crossover))


def design_pi(
    gain: float, pole_per_s: float, dead_time_s: float, period_s: float, ms: float, at_least_s: float = 0.0
) -> Design:
    """Return the fastest PI gains by SIMC for gain e^(-dead_time s) / (s + pole) whose sampled loop keeps Ms <= ms.

    at_least_s: least sum of the closed-loop time and all delays.
    """
    total = dead_time_s + 0.5 * period_s

    def gains_for(closed_loop_s: float) -> PidGains:
        kp = 1.0 / (gain * (closed_loop_s + total))
        integral_time = 4.0 * (closed_loop_s + total)
        if pole_per_s > 0.0:
            integral_time = min(1.0 / pole_per_s, integral_time)
        return PidGains(kp=kp, ki=kp / integral_time, tracking_time_s=integral_time)

    low = max(0.05 * total, at_least_s - total)
    high = max(200.0 * total, 2.0 * low)
    for _ in range(30):
        middle = math.sqrt(low * high)
        loop = sampled_loop(gains_for(middle), gain, pole_per_s, dead_time_s, period_s)
        if maximum_sensitivity(loop, period_s) > ms:
            low = middle
        else:
            high = middle
        if high / low < 1.01:
            break
    gains = gains_for(high)
    margins = loop_margins(sampled_loop(gains, gain, pole_per_s, dead_time_s, period_s), period_s)
    return Design(gains, margins, high, gain, pole_per_s, dead_time_s, period_s)


def design_temperature(period_s: float, dead_time_s: float, ms: float) -> Design:
    """Design the temperature PID, whose output is a heating rate (K/s): with the plate's inverse the plate is 1/s."""
    return design_pi(1.0, 0.0, dead_time_s, period_s, ms)


def steepest_slope(model: FilmModel, low_degC: float, high_degC: float) -> tuple[float, float]:
    """Return the largest |d output / dT| on the major loop (output's unit per K) and its temperature (degC)."""
    grid = np.linspace(low_degC, high_degC, 2001)
    heating, _ = model.simulate(grid, model.initial_memory(low_degC, "heated"))
    cooling, _ = model.simulate(grid[::-1], model.initial_memory(high_degC, "cooled"))
    best, where = 0.0, 0.5 * (low_degC + high_degC)
    for temperatures, outputs in ((grid, heating), (grid[::-1], cooling)):
        slopes = np.abs(np.diff(outputs) / np.diff(temperatures))
        k = int(np.argmax(slopes))
        if slopes[k] > best:
            best, where = float(slopes[k]), float(0.5 * (temperatures[k] + temperatures[k + 1]))
    return best, where


def design_log_resistance(
    model: FilmModel,
    plate: PlateModel,
    low_degC: float,
    high_degC: float,
    current_limit_A: float,
    period_s: float,
    dead_time_s: float,
    ms: float,
) -> Design:
    """Design a PID on the output alone, in A per decade, at the film's steepest slope: the comparison `pid`."""
    slope, where = steepest_slope(model, low_degC, high_degC)
    current = plate.current_for_rate_A(where, 0.0, current_limit_A)
    gain, pole = plate.linearized(where, current)
    return design_pi(slope * gain, max(pole, 0.0), dead_time_s, period_s, ms)


@dataclass(frozen=True)
class OwnPid:
    """Gains of a controller's own PID: Kp in A/K, Ti and Td in s (0: no such part), sampled every tick_s.

    damping: pole of the filter on dT/dt.
    """

    kp_A_per_K: float
    ti_s: float
    td_s: float = 0.0
    damping: float = 0.3
    tick_s: float = 0.1


NOISE_SHARE = 0.05  # of the current limit, by which noise of one standard deviation may move the current


def design_own_pid(
    gain_K_per_A_s: float,
    pole_per_s: float,
    tick_s: float,
    dead_time_s: float,
    ms: float,
    noise_K: float,
    current_limit_A: float,
) -> tuple[OwnPid, Design]:
    """Design the fastest PI within Ms and the noise, without a derivative: a plate is of the first order."""
    design = design_pi(gain_K_per_A_s, pole_per_s, dead_time_s, tick_s, ms)
    most = NOISE_SHARE * current_limit_A / noise_K if noise_K > 0.0 else design.gains.kp
    if design.gains.kp > most:
        slower = 1.0 / (gain_K_per_A_s * most)  # closed-loop time and delays together
        design = design_pi(gain_K_per_A_s, pole_per_s, dead_time_s, tick_s, ms, at_least_s=slower)
    gains = design.gains
    return OwnPid(gains.kp, gains.kp / gains.ki, 0.0, tick_s=tick_s), design
