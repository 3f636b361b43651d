"""Estimate plate and thermometer from one small current pulse, before there is any model.

The pulse is rest, a current, and 0 A until the temperature has responded. The fit uses the smallest chain that predicts
how much heat has not shown yet:

    reading = drift at rest + gain x (charge that acts after a delay, seen through the thermometer's lag, losing heat)

gain (K per A s) is the heating rate per ampere. Lag, delay and loss are taken from grids, and a linear regression gives
gain and drift for each of their combinations. One pulse does not determine the ratio of R_e to S, which is taken from
what such plates have in common: the current of largest cooling is some three times the limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import KELVIN, Array
from compensator.thermal.plate import Kind, PlateModel

# grid: factors of some 1.4 for long lags, which move the predicted curve by less than its uncertainty
LAGS_S: Final = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.5, 6.5, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0)
DELAYS_S: Final = (0.0, 0.2, 0.5, 1.0, 2.0, 3.5, 5.0)  # grid, of drivers and lines
LOSSES_PER_S: Final = (0.003, 0.01, 0.03, 0.08)  # G / C: 60 J/K with 0.2 W/K to 10 J/K with 0.8 W/K
USUAL_LOSS_W_PER_K, USUAL_SEEBECK_V_PER_K = 0.5, 0.045  # the middle of 0.3 to 0.8 and of 0.03 to 0.06
JOULE_SHARE = 0.4  # r I_max over s 300 K: a current limit is set to some 40 % of the current of largest cooling
LIKELY: Final = 9.0  # of chi square: a lag that fits worse by this much is still possible


@dataclass(frozen=True)
class Doubt:
    """Uncertainty of a plate model.

    gain, loss: relative, of the heating rate by the current and of the loss. lag_s, lag: absolute and relative, of the
    thermometer's lag and the driver's delay. settle_K: settling time of the watch's disturbance observer, as a
    temperature to be divided by the fastest heating rate; settle_s: bounds of that time.
    """

    gain: float
    loss: float
    lag_s: float
    lag: float
    settle_K: float
    settle_s: tuple[float, float]


# from simulated runs with each effect of the catalogue (docs/decisions.md, 19)
OF_A_PULSE: Final = Doubt(0.15, 0.4, 0.5, 0.3, 25.0, (15.0, 40.0))
OF_PULSES: Final = Doubt(0.08, 0.2, 0.5, 0.3, 30.0, (20.0, 50.0))  # of a calibration's pulses of both signs
OF_A_MODEL: Final = Doubt(0.04, 0.07, 0.5, 0.3, 50.0, (35.0, 80.0))  # of a model, identified or calibrated


@dataclass(frozen=True)
class KnownPlate:
    """A plate model with its thermometer, and their uncertainty.

    lag_s: of the thermometer behind the plate; delay_s: from a command to its current. least_lag_s, largest_lag_s:
    bounds of lag and delay together.
    """

    plate: PlateModel
    lag_s: float = 0.0
    delay_s: float = 0.0
    least_lag_s: float = 0.0
    largest_lag_s: float = 0.0
    doubt: Doubt = OF_A_MODEL

    @property
    def behind_s(self) -> float:
        """Return the largest time from a command until the thermometer shows it, s."""
        return max(self.lag_s + self.delay_s, self.largest_lag_s)


def first_plate(
    time_s: Array, temperature_degC: Array, current_A: Array, limit_A: float, kind: Kind = "peltier"
) -> KnownPlate | None:
    """Return plate and thermometer, fitted to a pulse; None if the pulse moved nothing.

    Parameters
    ----------
    time_s, temperature_degC, current_A
        Shape (samples,); a row's current (for a heater its drive) flows until the next row.
    limit_A
        Largest current of the run.
    """
    known = np.isfinite(temperature_degC)
    time, reading, current = time_s - time_s[0], temperature_degC[known], np.nan_to_num(current_A)
    if reading.size < 8 or not np.any(current):
        return None
    trials = []
    for delay in DELAYS_S:
        for lag in LAGS_S:
            for loss in LOSSES_PER_S:
                shape = _response(time, current, lag, delay, loss)[known]
                columns = np.column_stack((shape, np.ones(reading.size), time[known]))
                found, *_ = np.linalg.lstsq(columns, reading, rcond=None)
                residual = reading - columns @ found
                trials.append((float(residual @ residual), lag, delay, loss, found))
    trials.sort(key=lambda trial: trial[0])
    noise = max(_noise_K(reading), _step_K(reading) / math.sqrt(12.0))
    bound = trials[0][0] * (1.0 + LIKELY / reading.size) + LIKELY * noise**2
    likely = [trial for trial in trials if trial[0] <= bound and trial[4][0] > 0.0]
    if not likely:
        return None
    best = likely[0]
    if best is not trials[0]:  # coarse steps: a drift alone fits as well; prefer the least drift
        best = min(likely, key=lambda trial: abs(float(trial[4][2])))
    _, lag, delay, loss, (gain, at_rest_degC, drift) = best
    behind = [lag + delay for _, lag, delay, _, _ in likely]
    seebeck = gain / (at_rest_degC + KELVIN)
    usual = seebeck * USUAL_LOSS_W_PER_K / USUAL_SEEBECK_V_PER_K
    ambient = float(at_rest_degC + min(max(drift / usual, -40.0), 40.0))
    if kind == "heater":
        heater = PlateModel(0.0, 0.0, float(loss), ambient, float(gain), "heater")
        return KnownPlate(heater, lag, delay, min(behind), max(behind), OF_A_PULSE)
    plate = PlateModel(
        seebeck_over_capacity_per_A_s=float(seebeck),
        resistance_over_capacity_K_per_A2_s=float(JOULE_SHARE * 300.0 * seebeck / limit_A),
        conductance_over_capacity_per_s=float(usual),
        ambient_degC=ambient,
    )
    return KnownPlate(plate, lag, delay, min(behind), max(behind), OF_A_PULSE)


def _response(time: Array, current: Array, lag_s: float, delay_s: float, loss_per_s: float) -> Array:
    """Return the thermometer's response (K per A s): the delayed current through plate and lag, exact over a step."""
    when = np.maximum(time - delay_s, 0.0)
    charge = np.concatenate(([0.0], np.cumsum(current[:-1] * np.diff(time))))
    acted = np.interp(when, time, charge)
    shown = np.empty(time.size)
    p = m = 0.0
    for k in range(time.size):
        if k:
            dt = time[k] - time[k - 1]
            before = p
            p = p * math.exp(-loss_per_s * dt) + (acted[k] - acted[k - 1]) * (1.0 - 0.5 * loss_per_s * dt)
            if lag_s > 0.0:
                rate = (p - before) / dt
                m = p - lag_s * rate + (m - before + lag_s * rate) * math.exp(-dt / lag_s)
            else:
                m = p
        shown[k] = m
    return shown


def _step_K(reading: Array) -> float:
    """Return the smallest difference between two readings in sequence, the step of a thermometer that rounds."""
    steps = np.abs(np.diff(reading))
    return float(np.min(steps[steps > 0.0], initial=math.inf)) if np.any(steps > 0.0) else 0.0


def _noise_K(reading: Array) -> float:
    """Return the thermometer's noise, from second differences, which a slope does not enter."""
    return float(np.std(np.diff(reading, 2)) / math.sqrt(6.0)) if reading.size > 3 else 0.0
