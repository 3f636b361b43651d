"""What one small pulse tells of a plate and its thermometer, before there is any model.

The pulse is rest, a current, and 0 A until the temperature has done what it does. Fitted is the smallest chain that can
say how much heat has not shown yet:

    reading = drift at rest + gain x (charge that acts after a delay, seen through the thermometer's lag, losing heat)

gain (K per A s) is the heating rate per ampere; lag and delay are tried over grids, loss over another, and gain and
drift follow from a linear regression each time. What the pulse cannot tell is taken from what such plates have in
common (R_e against S: the current of largest cooling is some three times the limit).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import KELVIN, Array
from compensator.thermal.plate import Kind, PlateModel

# tried: some 1.4 apart where lags are long, which moves the reckoned course by less than its doubt
LAGS_S: Final = (0.0, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.5, 6.5, 9.0, 13.0, 18.0, 25.0, 35.0, 50.0)
DELAYS_S: Final = (0.0, 0.2, 0.5, 1.0, 2.0, 3.5, 5.0)  # tried: of drivers and lines
LOSSES_PER_S: Final = (0.003, 0.01, 0.03, 0.08)  # G / C of 60 J/K with 0.2 W/K to 10 J/K with 0.8 W/K
USUAL_LOSS_W_PER_K, USUAL_SEEBECK_V_PER_K = 0.5, 0.045  # the middle of 0.3 to 0.8 and of 0.03 to 0.06
JOULE_SHARE = 0.4  # r I_max over s 300 K: a current limit is set to some 40 % of the current of largest cooling
LIKELY: Final = 9.0  # of chi square: a lag this much worse than the best is still possible


@dataclass(frozen=True)
class Doubt:
    """What may be wrong of a plate model.

    gain, loss: shares of the heating rate by the current and of the loss. lag_s, lag: of the thermometer's lag and the
    driver's delay, and a share of them. settle_K: how long the watch takes to learn a disturbance, in K over the
    fastest heating rate; settle_s: its bounds.
    """

    gain: float
    loss: float
    lag_s: float
    lag: float
    settle_K: float
    settle_s: tuple[float, float]


# measured over simulated runs with each effect of the catalogue (docs/decisions.md, 19)
OF_A_PULSE: Final = Doubt(0.15, 0.4, 0.5, 0.3, 25.0, (15.0, 40.0))
OF_PULSES: Final = Doubt(0.08, 0.2, 0.5, 0.3, 30.0, (20.0, 50.0))  # the same, of a calibration's pulses of both signs
# the same, of a model that was identified or calibrated
OF_A_MODEL: Final = Doubt(0.04, 0.07, 0.5, 0.3, 50.0, (35.0, 80.0))


@dataclass(frozen=True)
class KnownPlate:
    """A plate with its thermometer, as far as they are known.

    lag_s: of the thermometer behind the plate; delay_s: from a command to its current. least_lag_s, largest_lag_s: lag
    and delay together may be so small, and so large.
    """

    plate: PlateModel
    lag_s: float = 0.0
    delay_s: float = 0.0
    least_lag_s: float = 0.0
    largest_lag_s: float = 0.0
    doubt: Doubt = OF_A_MODEL

    @property
    def behind_s(self) -> float:
        """From a command until the thermometer shows it, at the most."""
        return max(self.lag_s + self.delay_s, self.largest_lag_s)


def first_plate(
    time_s: Array, temperature_degC: Array, current_A: Array, limit_A: float, kind: Kind = "peltier"
) -> KnownPlate | None:
    """Plate and thermometer from a pulse; None where it moved nothing.

    Shapes (samples,): current_A is that of a row until the next. limit_A: the largest current there will be. A heater's
    drive stands in the place of the current.
    """
    known = np.isfinite(temperature_degC)
    time, reading, current = time_s - time_s[0], temperature_degC[known], np.nan_to_num(current_A)
    if reading.size < 8 or not np.any(current):
        return None
    trials = []
    for delay in DELAYS_S:
        for lag in LAGS_S:
            for loss in LOSSES_PER_S:
                shape = _seen(time, current, lag, delay, loss)[known]
                columns = np.column_stack((shape, np.ones(reading.size), time[known]))
                found, *_ = np.linalg.lstsq(columns, reading, rcond=None)
                left = reading - columns @ found
                trials.append((float(left @ left), lag, delay, loss, found))
    trials.sort(key=lambda trial: trial[0])
    noise = max(_noise_K(reading), _step_K(reading) / math.sqrt(12.0))
    bound = trials[0][0] * (1.0 + LIKELY / reading.size) + LIKELY * noise**2
    likely = [trial for trial in trials if trial[0] <= bound and trial[4][0] > 0.0]
    if not likely:
        return None
    best = likely[0]
    if best is not trials[0]:  # a drift tells it better than a plate that is moved: in coarse steps, as good as well
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


def _seen(time: Array, current: Array, lag_s: float, delay_s: float, loss_per_s: float) -> Array:
    """What a thermometer shows of 1 K per A s: the delayed current through plate and lag, each exact over a step."""
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
    """Of a thermometer that rounds: the smallest difference between two of its readings in sequence."""
    steps = np.abs(np.diff(reading))
    return float(np.min(steps[steps > 0.0], initial=math.inf)) if np.any(steps > 0.0) else 0.0


def _noise_K(reading: Array) -> float:
    """Of the thermometer: from second differences, that no slope is in."""
    return float(np.std(np.diff(reading, 2)) / math.sqrt(6.0)) if reading.size > 3 else 0.0
