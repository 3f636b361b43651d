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
"""

from __future__ import annotations

import math
from collections import deque
from copy import copy
from typing import Final

import numpy as np

from rig.core.outcome import Tripped
from rig.safety.first_plate import OF_A_MODEL, OF_A_PULSE, KnownPlate

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
