"""The plate is watched: heat that was put in has to show, and nothing may show that was not put in.

Plate and thermometer are simulated beside the run from the currents that were sent: the plate's temperature, what the
thermometer should show of it, and a disturbance that takes up what the model does not know (a heat sink that warms up,
a draught, a loss that is off). The disturbance follows slowly, so that what is slowly wrong of the model is learned,
while a fault, which comes at once, stands out between the reading and what the thermometer should show. Trips:

unseen_heat  the reading is further from what it should show than noise, steps, and what may be wrong of the model: a
             sensor that fell off, stands still, steps or drifts; a polarity that turned
disturbed    the disturbance has come to more than a heat sink can do
hidden_heat  the plate may be above its limit though the thermometer is not: it lags, or has lost contact
runaway      all the current there is for a whole window, and the plate stands still or goes the other way: a heat sink
             that is saturated, a fan that died

A law that is wrong cannot argue with this: it sees readings and the commands that were sent, and raises `Tripped`.
The observer has both poles at 1 / settle: to a heating rate that is off by a K/s from one moment on it answers with a
difference of a settle / e at the most, one settling time later.
"""

from __future__ import annotations

import math
from collections import deque
from copy import copy
from typing import Final

from rig.core.outcome import Tripped
from rig.safety.first_plate import OF_A_MODEL, OF_A_PULSE, KnownPlate

LEAST_K: Final = 2.0  # a draught, a neighbour's heat
STEPS, SIGMAS = 2.0, 8.0  # of the thermometer
WARM_SINK_K, COLD_SINK_K = 50.0, 25.0  # that a heat sink may be from the model's ambient, either way
HIDDEN_K = 2.0  # above the limit
OTHER_PLATE: Final = " If all is well with it, the plate is another than the model's: calibrate anew"
FULL = 0.9  # of the useful current
LEAST_SHARE, LEAST_PREDICTED_K, AGAINST_K = 0.1, 3.0, 1.0
NOISE_SHARE, BEND = 0.02, 1.95  # of a second difference, whose mean size is so many times the noise
UNSEEN_K = 10.0  # that a plate may be ahead of its thermometer
FASTEST_K_PER_S = 3.0  # at which a sensor that comes off within 20 s is seen before the plate is 15 K hotter
STEP_S = 0.25  # of the simulation, at most
LONGEST_S = 5.0  # that one reading stands for, before it and after it: what a longer gap did nobody has seen


class _Answer:
    """What the observer's difference makes of a heating rate that it does not know of, K; its largest of late.

    The same two poles as the observer: x' = rate + v - 2 x / settle, v' = -x / settle^2.
    """

    def __init__(self) -> None:
        self._x = self._v = self.lately_K = 0.0

    def take(self, rate_K_per_s: float, dt: float, settle_s: float) -> None:
        self._x += dt * (rate_K_per_s + self._v - 2.0 * self._x / settle_s)
        self._v -= dt * self._x / settle_s**2
        self.lately_K = max(self.lately_K * math.exp(-dt / settle_s), abs(self._x))


class _Seen:
    """The observer: plate and thermometer as they should be (degC), disturbance (K/s), what its doubt is made of."""

    def __init__(self, reading_degC: float) -> None:
        self.plate_degC = self.shown_degC = self.reading_degC = reading_degC
        self.disturbance_K_per_s = 0.0
        self.driven, self.lost = _Answer(), _Answer()
        self.smooth_K_per_s = self.bend_K_per_s = 0.0  # rate of the plate, smoothed; how far it was from that lately
        self.step_K, self.noise_K = math.inf, 0.0
        self.corrected_s = self.change_K = math.nan

    @property
    def settled(self) -> bool:
        """Whether it was held against a reading before."""
        return not math.isnan(self.corrected_s)


class PlateWatch:
    """One run's watch. limit_A: of the current; high_degC: of the plate; window_s: limits.runaway_s."""

    def __init__(self, limit_A: float, high_degC: float, window_s: float) -> None:
        self.known: KnownPlate | None = None
        self._limit_A, self._high_degC, self._window_s = limit_A, high_degC, window_s
        self._sent: deque[tuple[float, float]] = deque()  # (when it acts, A)
        self._acting_A = 0.0
        self._at_s = math.nan
        self._seen: _Seen | None = None
        self._full: tuple[float, float, float] | None = None  # since when, reading then, what the model makes of it

    def know(self, known: KnownPlate) -> None:
        """From now on readings are judged by this plate; where it is now goes on."""
        self.known = known
        self._fastest_K_per_s = known.plate.rate_range_K_per_s(50.0, self._limit_A)[1]
        doubt = known.doubt
        shortest, longest = doubt.settle_s
        self._settle_s = known.lag_s + min(max(doubt.settle_K / max(self._fastest_K_per_s, 1e-3), shortest), longest)
        if self._seen is not None:
            before, self._seen = self._seen, _Seen(self._seen.reading_degC)
            self._seen.step_K, self._seen.noise_K = before.step_K, before.noise_K

    def forget(self) -> None:
        """The output was off, or nobody looked: the next reading is where the plate is."""
        self._sent.clear()
        self._acting_A, self._at_s, self._seen, self._full = 0.0, math.nan, None, None

    def expected_degC(self, now_s: float, current_A: float) -> float:
        """What the thermometer should show at a time, the current having been this since the last look; or nan."""
        if self._seen is None or self.known is None or math.isnan(current_A) or not self._seen.settled:
            return math.nan
        plate, dt = self.known.plate, min(max(now_s - self._at_s, 0.0), LONGEST_S)
        seen = self._seen
        acting_A = current_A if self.known.delay_s == 0.0 else self._acting_A
        to_degC = plate.step(seen.plate_degC, acting_A, dt) + seen.disturbance_K_per_s * dt
        if self.known.lag_s == 0.0:
            return to_degC
        return seen.shown_degC + (to_degC - seen.shown_degC) * -math.expm1(-dt / self.known.lag_s)

    def look(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """A reading (nan: none), and the current sent since the time before (nan: not known). Raises Tripped."""
        if self.known is None or math.isnan(current_A):
            self.forget()
            return
        if self._seen is None:
            if not math.isnan(temperature_degC):
                self._seen, self._at_s = _Seen(temperature_degC), now_s
            return
        self._advance(self.known, self._seen, now_s, current_A)
        if math.isnan(temperature_degC):
            return
        self._correct(self.known, self._seen, temperature_degC, now_s)

    def copy(self) -> PlateWatch:
        """The same, to be run on by itself."""
        other = copy(self)
        other._sent = self._sent.copy()
        if self._seen is not None:
            other._seen = copy(self._seen)
            other._seen.driven, other._seen.lost = copy(self._seen.driven), copy(self._seen.lost)
        return other

    @property
    def looked_s(self) -> float:
        """When it was looked at last; nan where nothing is known of where the plate is."""
        return self._at_s if self.known is not None and self._seen is not None else math.nan

    def run_on(self, now_s: float, current_A: float) -> float:
        """Simulate on to a time with a current, without a reading: what the thermometer should show then (degC)."""
        assert self.known is not None
        assert self._seen is not None
        self._advance(self.known, self._seen, now_s, current_A)
        return self._seen.shown_degC

    @property
    def off_K(self) -> float:
        """By how much the last reading was elsewhere than it should have been."""
        return abs(self._seen.reading_degC - self._seen.shown_degC) if self._seen is not None else 0.0

    @property
    def late_K(self) -> float:
        """By how much the plate may be elsewhere for that, after its rate has changed as it did of late."""
        return self.late_s * self._seen.bend_K_per_s if self._seen is not None else 0.0

    @property
    def late_s(self) -> float:
        """By how much more than is known what was sent may show late."""
        known = self.known
        if known is None:
            return 0.0
        behind_s = known.lag_s + known.delay_s
        return max(known.doubt.lag_s + known.doubt.lag * behind_s, known.behind_s - behind_s)

    @property
    def step_K(self) -> float:
        """The smallest step that the thermometer was seen to make, 0 where it is not known."""
        return self._seen.step_K if self._seen is not None and math.isfinite(self._seen.step_K) else 0.0

    def check_cooling(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Raises Tripped where a current lies beyond that of largest cooling, where more of it cools less."""
        if self.known is None or self.known.doubt is OF_A_PULSE or math.isnan(temperature_degC):
            return
        least_A, _ = self.known.plate.current_range_A(temperature_degC, math.inf)
        if current_A < least_A - 1e-6 - 0.02 * abs(least_A):
            text = (
                f"{current_A:g} A at {temperature_degC:.1f} degC: beyond {least_A:.3g} A more current cools less "
                "(I = S T / R_e of the plate model)"
            )
            raise Tripped("cooling_limit", text, now_s)

    def _advance(self, known: KnownPlate, seen: _Seen, now_s: float, current_A: float) -> None:
        """Plate and thermometer to now; the current was sent at the last look."""
        self._sent.append((self._at_s + known.delay_s, current_A))
        settle = self._settle_s
        while self._at_s < now_s - 1e-9:
            if self._sent and self._sent[0][0] <= self._at_s + 1e-9:
                self._acting_A = self._sent.popleft()[1]
                continue
            until = min(now_s, self._at_s + STEP_S, self._sent[0][0] if self._sent else math.inf)
            dt, before = until - self._at_s, seen.plate_degC
            seen.plate_degC = known.plate.step(before, self._acting_A, dt) + seen.disturbance_K_per_s * dt
            rate = (seen.plate_degC - before) / dt
            behind = seen.shown_degC - before + known.lag_s * rate
            kept = math.exp(-dt / known.lag_s) if known.lag_s > 0.0 else 0.0
            seen.shown_degC = seen.plate_degC - known.lag_s * rate + behind * kept
            loss = known.plate.conductance_over_capacity_per_s * (before - known.plate.ambient_degC)
            seen.lost.take(loss, dt, settle)
            seen.driven.take(known.plate.rate_K_per_s(before, self._acting_A) + loss, dt, settle)
            fading = math.exp(-dt / settle)
            seen.smooth_K_per_s += (1.0 - fading) * (rate - seen.smooth_K_per_s)
            seen.bend_K_per_s = max(fading * seen.bend_K_per_s, abs(rate - seen.smooth_K_per_s))
            self._at_s = until

    def _correct(self, known: KnownPlate, seen: _Seen, reading_degC: float, now_s: float) -> None:
        """Hold the reading against what it should be, then learn from it."""
        change = reading_degC - seen.reading_degC
        if change != 0.0:
            seen.step_K = min(seen.step_K, abs(change))
        bend_K = change - seen.change_K if math.isfinite(seen.change_K) else 0.0
        seen.noise_K += NOISE_SHARE * (min(abs(bend_K) / BEND, 1.0) - seen.noise_K)
        seen.reading_degC, seen.change_K = reading_degC, change
        off_K = reading_degC - seen.shown_degC
        settle = self._settle_s
        bound_K = self._tolerance_K(known, seen)
        if abs(off_K) > bound_K:
            self._trip_unseen(now_s, seen, off_K, bound_K)
        dt = min(now_s - seen.corrected_s, LONGEST_S) if seen.settled else 0.0
        share = min(2.0 * dt / settle, 1.0)
        seen.plate_degC += share * off_K
        seen.shown_degC += share * off_K
        seen.disturbance_K_per_s += dt / settle**2 * off_K
        seen.corrected_s = now_s
        most = self._most_K_per_s(known, seen)
        if abs(seen.disturbance_K_per_s) > most + LEAST_K / settle:
            self._trip_disturbed(now_s, seen, most)
        if seen.plate_degC > self._high_degC + HIDDEN_K:
            text = (
                f"the thermometer shows {reading_degC:.2f} degC, but from the current that was sent the plate may be "
                f"at {seen.plate_degC:.1f} degC, above the limit of {self._high_degC:g} degC"
            )
            raise Tripped("hidden_heat", text, now_s)
        self._look_against(known, now_s, reading_degC)

    def _most_K_per_s(self, known: KnownPlate, seen: _Seen) -> float:
        """The largest disturbance that is none: a heat sink that has warmed up or cooled down, and a model that is off.
        A heat sink does not get far below the room."""
        sink_K = WARM_SINK_K if seen.disturbance_K_per_s > 0.0 else COLD_SINK_K
        g, doubt = known.plate.conductance_over_capacity_per_s, known.doubt
        loss = g * abs(seen.plate_degC - known.plate.ambient_degC)
        drive = abs(known.plate.rate_K_per_s(seen.plate_degC, self._acting_A)) + loss
        return g * sink_K + 2.0 * (doubt.gain * drive + doubt.loss * loss)

    def _tolerance_K(self, known: KnownPlate, seen: _Seen) -> float:
        doubt = known.doubt
        gain_K, loss_K = doubt.gain * seen.driven.lately_K, doubt.loss * seen.lost.lately_K
        model = math.hypot(gain_K, loss_K, self.late_K)  # errors that know nothing of each other
        step = seen.step_K if math.isfinite(seen.step_K) else 0.0
        return LEAST_K + model + STEPS * step + SIGMAS * min(seen.noise_K, 0.25)

    def _trip_unseen(self, now_s: float, seen: _Seen, off_K: float, bound_K: float) -> None:
        of_a_model = self.known is not None and self.known.doubt is OF_A_MODEL
        off, bound = told_apart(abs(off_K), bound_K)
        text = (
            f"the thermometer shows {seen.reading_degC:.2f} degC, where the current that was sent and the plate give "
            f"{seen.shown_degC:.2f} degC: {off} K {'less' if off_K < 0.0 else 'more'}, more than the "
            f"{bound} K that the plate model may be wrong by: thermometer fallen off or stuck, polarity, or "
            f"something else that heats or cools?{OTHER_PLATE if of_a_model else ''}"
        )
        raise Tripped("unseen_heat", text, now_s)

    def _trip_disturbed(self, now_s: float, seen: _Seen, most: float) -> None:
        text = (
            f"something {'heats' if seen.disturbance_K_per_s > 0.0 else 'cools'} the plate by "
            f"{abs(seen.disturbance_K_per_s):.2f} K/s, more than a heat sink can ({most:.2f} K/s): is the thermometer "
            "on the plate, does the fan run?"
        )
        raise Tripped("disturbed", text, now_s)

    def _look_against(self, known: KnownPlate, now_s: float, reading_degC: float) -> None:
        """All the current there is, for a whole window."""
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


def told_apart(more: float, less: float) -> tuple[str, str]:
    """Two numbers, one above the other, with as many digits as show it: at least one, at most three."""
    for digits in (1, 2, 3):
        texts = f"{more:.{digits}f}", f"{less:.{digits}f}"
        if texts[0] != texts[1]:
            break
    return texts


def watchable_rate_K_per_s(known: KnownPlate) -> float:
    """How fast a plate may be moved so that what has not shown yet stays bounded (`UNSEEN_K`)."""
    return min(FASTEST_K_PER_S, UNSEEN_K / max(known.behind_s, 1e-3))
