"""Compare the temperature with the currents that were sent: heat that was put in has to show, and no other heat may.

`PlateWatch` needs a plate model. An observer simulates plate and thermometer from the currents that were sent, with a
disturbance (K/s) for everything that the model does not contain (a heat sink that warms up, a draught, a wrong loss).
The disturbance follows slowly: slow model errors are learned, while a fault, which is sudden, shows as a difference
between the reading and the simulated thermometer. Trips:

unseen_heat  the difference exceeds noise, steps and model error: a sensor that fell off, is stuck, steps or drifts; a
             polarity that turned
disturbed    the disturbance exceeds what a heat sink can do
hidden_heat  the plate may be above its limit though the thermometer is not: it lags, or has lost contact
runaway      full current for a whole window, and the plate stands still or moves against it: a saturated heat sink, a
             fan that died

Both poles of the observer are at 1 / settle: after a step of a K/s in the heating rate the difference is at most
a settle / e, one settling time later.

`RunawayWatch` needs no plate model and detects less, later: strong cooling while it gets hotter above room temperature,
strong heating while it gets colder below it, no response to a current that has come on. If the instrument regulates by
itself and reports no current, the temperature has to approach a setpoint that is far away.

`first_plate` estimates plate and thermometer from one small current pulse, before there is any model. The
pulse is rest, a current, and 0 A until the temperature has responded. The fit uses the smallest chain that predicts how
much heat has not shown yet:

    reading = drift at rest + gain x (charge that acts after a delay, seen through the thermometer's lag, losing heat)

gain (K per A s) is the heating rate per ampere. Lag, delay and loss are taken from grids, and a linear regression gives
gain and drift for each of their combinations. One pulse does not determine the ratio of R_e to S, which is taken from
what such plates have in common: the current of largest cooling is some three times the limit.
"""

from __future__ import annotations

import math
from collections import deque
from copy import copy
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import KELVIN, Array
from compensator.thermal.plate import Kind, PlateModel
from rig.core.outcome import Tripped

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


LEAST_K: Final = 2.0  # a draught, heat from nearby equipment
STEPS, SIGMAS = 2.0, 8.0  # of the thermometer's resolution and noise
WARM_SINK_K, COLD_SINK_K = 50.0, 25.0  # largest distance of a heat sink from the model's ambient
HIDDEN_K = 2.0  # above the limit
OTHER_PLATE: Final = " If all of these are in order, the model is of another plate: calibrate again"
FULL = 0.9  # share of the useful current
LEAST_SHARE, LEAST_PREDICTED_K, AGAINST_K = 0.1, 3.0, 1.0  # of a movement under full current; beyond noise
NOISE_SHARE, BEND = 0.02, 1.95  # weight of a second difference; its mean size over the noise
UNSEEN_K = 10.0  # largest lead of a plate over its thermometer
FASTEST_K_PER_S = 3.0  # a sensor that comes off within 20 s is then detected before the plate is 15 K hotter
STEP_S = 0.25  # largest step of the simulation
LONGEST_S = 5.0  # for which one reading counts; what happened in a longer gap is unknown

# of the watch without a plate model
LOOK_EVERY_S = 0.5  # a plate moves by less than its noise in between
STRONG, WEAK = 0.5, 0.25  # shares of the current limit
HOT_DEGC, COLD_DEGC, RESPONSE_K = 35.0, 15.0, 0.5  # beyond any room's temperature; beyond noise
FAR_K, NEARER_K = 5.0, 0.3  # distance from a setpoint, and the least approach within the window
ONE_STEP_S = 5.0  # from weak to strong within that: a current that has come on


class _ObserverError:
    """Observer error (K) that an unmodelled heating rate causes, and its recent maximum.

    It has the observer's two poles: x' = rate + v - 2 x / settle, v' = -x / settle^2.
    """

    def __init__(self) -> None:
        self._x = self._v = self.recent_K = 0.0

    def take(self, rate_K_per_s: float, dt: float, settle_s: float) -> None:
        self._x += dt * (rate_K_per_s + self._v - 2.0 * self._x / settle_s)
        self._v -= dt * self._x / settle_s**2
        self.recent_K = max(self.recent_K * math.exp(-dt / settle_s), abs(self._x))


class _Observer:
    """State of the observer: plate and thermometer (degC), disturbance (K/s), and the parts of its tolerance."""

    def __init__(self, reading_degC: float) -> None:
        self.plate_degC = self.shown_degC = self.reading_degC = reading_degC
        self.disturbance_K_per_s = 0.0
        self.driven, self.lost = _ObserverError(), _ObserverError()
        self.smooth_K_per_s = self.bend_K_per_s = 0.0  # smoothed rate of the plate; recent distance from it
        self.step_K, self.noise_K = math.inf, 0.0
        self.corrected_s = self.change_K = math.nan

    @property
    def settled(self) -> bool:
        """True once a reading has corrected it."""
        return not math.isnan(self.corrected_s)


class PlateWatch:
    """Watches one run with a plate model. limit_A: of the current; high_degC: of the plate; window_s: runaway_s."""

    def __init__(self, limit_A: float, high_degC: float, window_s: float) -> None:
        self.known: KnownPlate | None = None
        self._limit_A, self._high_degC, self._window_s = limit_A, high_degC, window_s
        self._sent: deque[tuple[float, float]] = deque()  # (time at which it acts, A)
        self._acting_A = 0.0
        self._at_s = math.nan
        self._observer: _Observer | None = None
        self._full: tuple[float, float, float] | None = None  # sign, begin (s), reading then

    def know(self, known: KnownPlate) -> None:
        """Use this plate model from now on; the plate's present temperature is kept."""
        self.known = known
        self._fastest_K_per_s = known.plate.rate_range_K_per_s(50.0, self._limit_A)[1]
        doubt = known.doubt
        shortest, longest = doubt.settle_s
        self._settle_s = known.lag_s + min(max(doubt.settle_K / max(self._fastest_K_per_s, 1e-3), shortest), longest)
        if self._observer is not None:
            before, self._observer = self._observer, _Observer(self._observer.reading_degC)
            self._observer.step_K, self._observer.noise_K = before.step_K, before.noise_K

    def forget(self) -> None:
        """Restart from the next reading: the output was off, or nothing was read."""
        self._sent.clear()
        self._acting_A, self._at_s, self._observer, self._full = 0.0, math.nan, None, None

    def expected_degC(self, now_s: float, current_A: float) -> float:
        """Return the reading to expect at a time, with this current since the last one; nan if unknown."""
        if self._observer is None or self.known is None or math.isnan(current_A) or not self._observer.settled:
            return math.nan
        plate, dt = self.known.plate, min(max(now_s - self._at_s, 0.0), LONGEST_S)
        observer = self._observer
        acting_A = current_A if self.known.delay_s == 0.0 else self._acting_A
        to_degC = plate.step(observer.plate_degC, acting_A, dt) + observer.disturbance_K_per_s * dt
        if self.known.lag_s == 0.0:
            return to_degC
        return observer.shown_degC + (to_degC - observer.shown_degC) * -math.expm1(-dt / self.known.lag_s)

    def look(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Check a reading (nan: none) against the current sent since the one before (nan: unknown). Raises Tripped."""
        if self.known is None or math.isnan(current_A):
            self.forget()
            return
        if self._observer is None:
            if not math.isnan(temperature_degC):
                self._observer, self._at_s = _Observer(temperature_degC), now_s
            return
        self._advance(self.known, self._observer, now_s, current_A)
        if math.isnan(temperature_degC):
            return
        self._correct(self.known, self._observer, temperature_degC, now_s)

    def copy(self) -> PlateWatch:
        """Return an independent copy, for predictions."""
        other = copy(self)
        other._sent = self._sent.copy()
        if self._observer is not None:
            other._observer = copy(self._observer)
            other._observer.driven, other._observer.lost = copy(self._observer.driven), copy(self._observer.lost)
        return other

    @property
    def looked_s(self) -> float:
        """Return the time of the last reading, s; nan if the plate's temperature is unknown."""
        return self._at_s if self.known is not None and self._observer is not None else math.nan

    def run_on(self, now_s: float, current_A: float) -> float:
        """Simulate to a time without a reading; return the thermometer's expected reading then (degC)."""
        assert self.known is not None
        assert self._observer is not None
        self._advance(self.known, self._observer, now_s, current_A)
        return self._observer.shown_degC

    @property
    def off_K(self) -> float:
        """Return the distance of the last reading from its expectation, K."""
        return abs(self._observer.reading_degC - self._observer.shown_degC) if self._observer is not None else 0.0

    @property
    def late_K(self) -> float:
        """Temperature error that `late_s` causes at the recent changes of the rate."""
        return self.late_s * self._observer.bend_K_per_s if self._observer is not None else 0.0

    @property
    def late_s(self) -> float:
        """Return the largest time by which a command may show later than the model says, s."""
        known = self.known
        if known is None:
            return 0.0
        behind_s = known.lag_s + known.delay_s
        return max(known.doubt.lag_s + known.doubt.lag * behind_s, known.behind_s - behind_s)

    @property
    def step_K(self) -> float:
        """Smallest step that the thermometer has made; 0 if unknown."""
        return self._observer.step_K if self._observer is not None and math.isfinite(self._observer.step_K) else 0.0

    def check_cooling(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Raise Tripped for a current beyond that of largest cooling, where more current cools less."""
        if self.known is None or self.known.doubt is OF_A_PULSE or math.isnan(temperature_degC):
            return
        least_A, _ = self.known.plate.current_range_A(temperature_degC, math.inf)
        if current_A < least_A - 1e-6 - 0.02 * abs(least_A):
            text = (
                f"{current_A:g} A at {temperature_degC:.1f} degC: beyond {least_A:.3g} A more current cools less "
                "(I = S T / R_e of the plate model)"
            )
            raise Tripped("cooling_limit", text, now_s)

    def _advance(self, known: KnownPlate, observer: _Observer, now_s: float, current_A: float) -> None:
        """Simulate plate and thermometer to now; the current was sent at the last reading."""
        self._sent.append((self._at_s + known.delay_s, current_A))
        settle = self._settle_s
        while self._at_s < now_s - 1e-9:
            if self._sent and self._sent[0][0] <= self._at_s + 1e-9:
                self._acting_A = self._sent.popleft()[1]
                continue
            until = min(now_s, self._at_s + STEP_S, self._sent[0][0] if self._sent else math.inf)
            dt, before = until - self._at_s, observer.plate_degC
            observer.plate_degC = known.plate.step(before, self._acting_A, dt) + observer.disturbance_K_per_s * dt
            rate = (observer.plate_degC - before) / dt
            behind = observer.shown_degC - before + known.lag_s * rate
            kept = math.exp(-dt / known.lag_s) if known.lag_s > 0.0 else 0.0
            observer.shown_degC = observer.plate_degC - known.lag_s * rate + behind * kept
            loss = known.plate.conductance_over_capacity_per_s * (before - known.plate.ambient_degC)
            observer.lost.take(loss, dt, settle)
            observer.driven.take(known.plate.rate_K_per_s(before, self._acting_A) + loss, dt, settle)
            fading = math.exp(-dt / settle)
            observer.smooth_K_per_s += (1.0 - fading) * (rate - observer.smooth_K_per_s)
            observer.bend_K_per_s = max(fading * observer.bend_K_per_s, abs(rate - observer.smooth_K_per_s))
            self._at_s = until

    def _correct(self, known: KnownPlate, observer: _Observer, reading_degC: float, now_s: float) -> None:
        """Compare the reading with its expectation, then correct the observer."""
        change = reading_degC - observer.reading_degC
        if change != 0.0:
            observer.step_K = min(observer.step_K, abs(change))
        bend_K = change - observer.change_K if math.isfinite(observer.change_K) else 0.0
        observer.noise_K += NOISE_SHARE * (min(abs(bend_K) / BEND, 1.0) - observer.noise_K)
        observer.reading_degC, observer.change_K = reading_degC, change
        off_K = reading_degC - observer.shown_degC
        settle = self._settle_s
        bound_K = self._tolerance_K(known, observer)
        if abs(off_K) > bound_K:
            self._trip_unseen(now_s, observer, off_K, bound_K)
        dt = min(now_s - observer.corrected_s, LONGEST_S) if observer.settled else 0.0
        share = min(2.0 * dt / settle, 1.0)
        observer.plate_degC += share * off_K
        observer.shown_degC += share * off_K
        observer.disturbance_K_per_s += dt / settle**2 * off_K
        observer.corrected_s = now_s
        most = self._most_K_per_s(known, observer)
        if abs(observer.disturbance_K_per_s) > most + LEAST_K / settle:
            self._trip_disturbed(now_s, observer, most)
        if observer.plate_degC > self._high_degC + HIDDEN_K:
            text = (
                f"the thermometer shows {reading_degC:.2f} degC, but from the current that was sent the plate may be "
                f"at {observer.plate_degC:.1f} degC, above the limit of {self._high_degC:g} degC"
            )
            raise Tripped("hidden_heat", text, now_s)
        self._look_against(known, now_s, reading_degC)

    def _most_K_per_s(self, known: KnownPlate, observer: _Observer) -> float:
        """Return the largest harmless disturbance: a heat sink that is warm (or, less far, cold), and model error."""
        sink_K = WARM_SINK_K if observer.disturbance_K_per_s > 0.0 else COLD_SINK_K
        g, doubt = known.plate.conductance_over_capacity_per_s, known.doubt
        loss = g * abs(observer.plate_degC - known.plate.ambient_degC)
        drive = abs(known.plate.rate_K_per_s(observer.plate_degC, self._acting_A)) + loss
        return g * sink_K + 2.0 * (doubt.gain * drive + doubt.loss * loss)

    def _tolerance_K(self, known: KnownPlate, observer: _Observer) -> float:
        doubt = known.doubt
        gain_K, loss_K = doubt.gain * observer.driven.recent_K, doubt.loss * observer.lost.recent_K
        model = math.hypot(gain_K, loss_K, self.late_K)  # independent errors
        step = observer.step_K if math.isfinite(observer.step_K) else 0.0
        return LEAST_K + model + STEPS * step + SIGMAS * min(observer.noise_K, 0.25)

    def _trip_unseen(self, now_s: float, observer: _Observer, off_K: float, bound_K: float) -> None:
        of_a_model = self.known is not None and self.known.doubt is OF_A_MODEL
        off, bound = distinct(abs(off_K), bound_K)
        text = (
            f"the thermometer shows {observer.reading_degC:.2f} degC, where the plate model and the current "
            f"that was sent give {observer.shown_degC:.2f} degC: {off} K {'less' if off_K < 0.0 else 'more'}, more "
            f"than the {bound} K that the plate model may be wrong by: thermometer fallen off or stuck, polarity, or "
            f"another source of heat or cold?{OTHER_PLATE if of_a_model else ''}"
        )
        raise Tripped("unseen_heat", text, now_s)

    def _trip_disturbed(self, now_s: float, observer: _Observer, most: float) -> None:
        text = (
            f"something {'heats' if observer.disturbance_K_per_s > 0.0 else 'cools'} the plate by "
            f"{abs(observer.disturbance_K_per_s):.2f} K/s, more than a heat sink can ({most:.2f} K/s): is the "
            "thermometer on the plate, does the fan run?"
        )
        raise Tripped("disturbed", text, now_s)

    def _look_against(self, known: KnownPlate, now_s: float, reading_degC: float) -> None:
        """Check that full current for a whole window moves the plate."""
        low, high = known.plate.current_range_A(reading_degC, self._limit_A)
        sign = 1.0 if self._acting_A >= FULL * high else -1.0 if low < 0.0 and self._acting_A <= FULL * low else 0.0
        if not sign or (self._full is not None and sign != self._full[0]):
            self._full = None
            return
        if self._full is None:
            self._full = (sign, now_s, reading_degC)
            return
        _, since_s, first_degC = self._full
        length_s = now_s - since_s
        if length_s < self._window_s + 2.0 * known.behind_s:
            return
        predicted_K = known.plate.step(first_degC, self._acting_A, length_s) - first_degC
        done_K = reading_degC - first_degC
        least_K = LEAST_SHARE * sign * predicted_K if known.doubt is not OF_A_PULSE else -AGAINST_K
        if sign * predicted_K >= LEAST_PREDICTED_K and sign * done_K < least_K:
            text = (
                f"the current {'heats' if sign > 0.0 else 'cools'} ({self._acting_A:+.3g} A), which should have moved "
                f"the plate by {predicted_K:+.1f} K in {length_s:.0f} s; it went from {first_degC:.2f} to "
                f"{reading_degC:.2f} degC: polarity, fallen off, or a saturated heat sink?"
            )
            raise Tripped("runaway", text, now_s)
        self._full = (sign, now_s, reading_degC)


def distinct(more: float, less: float) -> tuple[str, str]:
    """Return two numbers with as many digits (one to three) as show their difference."""
    for digits in (1, 2, 3):
        texts = f"{more:.{digits}f}", f"{less:.{digits}f}"
        if texts[0] != texts[1]:
            break
    return texts


def watchable_rate_K_per_s(known: KnownPlate) -> float:
    """Return the fastest rate at which the plate stays within `UNSEEN_K` of its thermometer."""
    return min(FASTEST_K_PER_S, UNSEEN_K / max(known.behind_s, 1e-3))


class RunawayWatch:
    """Watches one run without a plate model. limit_A: of the current; window_s: limits.runaway_s."""

    def __init__(self, limit_A: float, window_s: float) -> None:
        self._limit_A, self._window_s = limit_A, window_s
        self._rows: deque[tuple[float, float, float, float]] = deque()  # time, reading; current, setpoint until then
        self._looked_s = -math.inf
        self._strong_sign = 0.0
        self._strong_s = self._weak_s = -math.inf
        self._strong_low = self._strong_high = self._strong_first = math.nan

    def forget(self) -> None:
        """Forget the readings so far: the output was off, or nothing was read."""
        self._rows.clear()
        self._strong_sign = 0.0

    def look(self, now_s: float, temperature_degC: float, current_A: float, setpoint_degC: float) -> None:
        """Check a reading (nan: none) against the current (nan: unknown) or setpoint until now. Raises Tripped."""
        rows = self._rows
        rows.append((now_s, temperature_degC, current_A, setpoint_degC))
        while len(rows) > 1 and now_s - rows[1][0] >= self._window_s:
            rows.popleft()
        self._note_strong(now_s, temperature_degC, current_A)
        if now_s - self._looked_s < LOOK_EVERY_S or math.isnan(temperature_degC):
            return
        self._looked_s = now_s
        if not math.isnan(setpoint_degC):
            self._look_at_setpoint(now_s)
        else:
            self._look_coarsely(now_s, temperature_degC)

    def _note_strong(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        if not abs(current_A) >= STRONG * self._limit_A:
            self._strong_sign = 0.0
            if abs(current_A) <= WEAK * self._limit_A:
                self._weak_s = now_s
            return
        sign = math.copysign(1.0, current_A)
        if sign != self._strong_sign:
            self._strong_sign, self._strong_s = sign, now_s
            self._strong_low = self._strong_high = self._strong_first = temperature_degC
        self._strong_low = min(self._strong_low, temperature_degC)
        self._strong_high = max(self._strong_high, temperature_degC)

    def _look_coarsely(self, now_s: float, temperature_degC: float) -> None:
        if not self._strong_sign or now_s - self._strong_s < self._window_s:
            return
        age_s = now_s - self._strong_s
        rise, fall = temperature_degC - self._strong_low, self._strong_high - temperature_degC
        text = f"{'heated' if self._strong_sign > 0 else 'cooled'} with a large current for {age_s:.0f} s, "
        if self._strong_sign < 0.0 and temperature_degC >= HOT_DEGC and rise >= AGAINST_K:
            text += f"and {rise:.2f} K hotter, {temperature_degC:.2f} degC: polarity, or a saturated heat sink?"
            raise Tripped("runaway", text, now_s)
        if self._strong_sign > 0.0 and temperature_degC <= COLD_DEGC and fall >= AGAINST_K:
            text += f"and {fall:.2f} K colder, {temperature_degC:.2f} degC: polarity, or a thermometer that fell off?"
            raise Tripped("runaway", text, now_s)
        moved = max(self._strong_high - self._strong_first, self._strong_first - self._strong_low)
        if self._strong_s - self._weak_s <= ONE_STEP_S and moved < RESPONSE_K:
            text += f"and the temperature has moved by {moved:.2f} K: is the plate connected, the thermometer on it?"
            raise Tripped("no_response", text, now_s)

    def _look_at_setpoint(self, now_s: float) -> None:
        table = np.array(self._rows)
        times, temperatures, setpoints = table[:, 0], table[:, 1], table[:, 3]
        distance = (setpoints - temperatures)[1:]
        distance = distance[np.isfinite(distance)]
        if now_s - times[0] < self._window_s or not distance.size or math.isnan(temperatures[0]):
            return
        sign = math.copysign(1.0, float(distance[-1]))
        first, last = float(temperatures[0]), float(temperatures[-1])
        if float(np.min(sign * distance)) >= FAR_K and sign * (last - first) < NEARER_K:
            text = (
                f"the temperature went from {first:.2f} to {last:.2f} degC in {now_s - times[0]:.0f} s, no nearer to "
                f"the setpoint of {setpoints[-1]:.2f} degC: polarity, thermometer, or more than the plate can do?"
            )
            raise Tripped("runaway", text, now_s)
