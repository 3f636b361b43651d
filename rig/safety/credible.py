"""Readings that are none: frozen, or jumping. They are marked by their quality, with the reason in words.

frozen   the same number, to the last bit, again and again. An instrument whose noise turned its readings to and fro
         just before is frozen when so many alike have a chance of `BY_CHANCE`. One that steps coarsely, or has no
         noise, is frozen when meanwhile something else says that the quantity has moved: more current has flowed
         than at their beginning, by so much that it would have moved by several steps, or the other instrument's
         reading has moved.
jumping  a temperature that moved by more than the current that was sent explains and any plate adds to it: nothing is
         believed until it is again where the plate can be, so that a step that lasts becomes a stale thermometer.
         A resistance that moved by half a decade at once: the film may do so, so it is believed when it comes thrice.

What no instrument can read (nan, a negative resistance, an open sensor) its driver has marked already.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from rig.core.reading import Quality, Reading

ENOUGH = 10  # readings alike, at least
BY_CHANCE = 1e-9
JUST_BEFORE = 40  # readings, by which an instrument's noise is judged
LEVELS = 4  # different numbers among them: beside a threshold a coarse instrument turns between two
TURNS = 0.15  # of them, that turned: of pure noise two thirds, and on a ramp fewer; without noise none does
LOOK_BACK_S = 20.0
LEAST_K = 0.5  # that the current should have moved a frozen thermometer by: fifty times its usual noise
LEAST_JUMP_K = 1.0  # noise and drift between two readings stay below a tenth of it
STEPS = 4.0  # of a coarse instrument, that a movement or a jump has to have
LEAST_JUMP_DEC, LEAST_JUMP_DEC_PER_S = 0.5, 5.0
AGREEING_DEC = 0.3  # of readings after a jump: a film in its transition moves by less between two
THRICE = 3  # that it reads alike after a jump: then the film has jumped, and not a reading
OTHER_DEC, OTHER_K = 0.1, 3.0  # that the other instrument has to have moved by
ANY_PLATE_K_PER_S = 3.0  # beyond what the current that was sent explains; a lasting step of 10 K is never within it
SLOWEST_K_PER_S = 1.5  # at the current limit, as long as no plate is known: it may be ten times slower
STEEPEST_DEC_PER_K = 2.0  # of a film: for less, a coarse thermometer need not have moved


class Sameness:
    """How often a number came again, what is usual for its instrument, and what else has moved meanwhile."""

    def __init__(self) -> None:
        self.step = math.inf  # the smallest difference that was seen
        self._last = math.nan
        self._last_change = 0.0
        self._alike = 1
        self._runs: deque[tuple[float, int, bool]] = deque()  # lately: number, how many alike, whether it turned then
        self._since_s = self._time_s = 0.0
        self._drives: list[float] = []  # the first ones of those alike
        self._first_other = math.nan
        self._drive = 0.0
        self.frozen = False  # as its owner found; until another number comes

    def take(self, value: float, time_s: float, drive: float, other: float) -> tuple[int, float, float]:
        """How many are alike, the drive's integral meanwhile, over its mean at first, and the other's movement.

        drive: what moves the quantity (nan: not known). other: the other instrument's reading (nan: none).
        """
        elapsed, self._time_s = time_s - self._time_s, time_s
        if value != self._last:
            self._learn(value)
            self._alike, self.frozen = 0, False
        self._alike += 1
        if self._alike == 1 or time_s - self._since_s > LOOK_BACK_S:
            self._since_s, self._drives, self._drive, self._first_other = time_s, [], 0.0, other
        if len(self._drives) < ENOUGH // 2:
            self._drives.append(drive)
        change = drive - sum(self._drives) / len(self._drives)
        moved = abs(other - self._first_other)
        if not math.isnan(change):
            self._drive += change * elapsed
        return self._alike, self._drive, 0.0 if math.isnan(moved) else moved

    @property
    def is_no_chance(self) -> bool:
        """Whether noise as it was just before hardly ever gives so many alike."""
        count = self._count()
        turns, levels = sum(turned for *_, turned in self._runs), len({value for value, *_ in self._runs})
        if count < JUST_BEFORE or turns < TURNS * count or levels < LEVELS:
            return False
        again = (count - len(self._runs) + 2) / (count + 2)  # chance of one more alike, a little more than was seen
        return self._alike >= ENOUGH and again**self._alike < BY_CHANCE

    def _count(self) -> int:
        """Readings just before."""
        return sum(alike for _, alike, _ in self._runs)

    def _learn(self, value: float) -> None:
        change = value - self._last
        if not math.isfinite(change):
            self._last = value
            return
        self.step = min(self.step, abs(change))
        self._runs.append((self._last, self._alike, change * self._last_change < 0.0))
        while self._count() - self._runs[0][1] >= JUST_BEFORE:
            self._runs.popleft()
        self._last, self._last_change = value, change


class ThermometerTrust:
    """Judges temperatures (degC). rate_K_per_s: limits.rate_K_per_s. limit_A: of the current."""

    def __init__(self, rate_K_per_s: float, limit_A: float) -> None:
        self._rate_K_per_s = min(rate_K_per_s, ANY_PLATE_K_PER_S)
        self._gain_K_per_A_s = SLOWEST_K_PER_S / limit_A
        self._same = Sameness()
        self._good: Reading | None = None
        self._off_K = math.nan

    def leave_currents_to_the_watch(self) -> None:
        """A plate is known: what a current should have done is for `plate_watch`, which knows loss and lag as well."""
        self._gain_K_per_A_s = 0.0

    def forget(self) -> None:
        """Nobody has looked for a while: where the temperature was says nothing."""
        self._good = None

    def judge(
        self, reading: Reading, current_A: float, log_resistance: float, expected_degC: float = math.nan
    ) -> tuple[Reading, str]:
        """The reading, with its quality lowered where it is none, and why.

        current_A: sent since the reading before, nan where it is not known. log_resistance: log10 of the film's, now.
        expected_degC: what the thermometer should show now, nan where that is not known.
        """
        if not reading.is_number:
            return reading, reading.why or f"it is {reading.quality}"
        value, now = reading.value, reading.time_s
        alike, charge, moved_dec = self._same.take(value, now, current_A, log_resistance)
        step = self._same.step if math.isfinite(self._same.step) else 0.0
        if alike >= ENOUGH:
            should_have = abs(charge) * self._gain_K_per_A_s > STEPS * step + LEAST_K
            told = moved_dec > max(OTHER_DEC, STEEPEST_DEC_PER_K * STEPS * step)
            self._same.frozen |= self._same.is_no_chance or should_have or told
            if self._same.frozen:
                return replace(reading, quality=Quality.STALE), f"frozen at {value!r} degC, {alike} times alike"
        if self._good is not None:
            room = max(LEAST_JUMP_K, STEPS * step) + self._rate_K_per_s * (now - self._good.time_s)
            off_K = value - expected_degC
            moved_K = value - self._good.value if math.isnan(off_K) or math.isnan(self._off_K) else off_K - self._off_K
            if abs(moved_K) > room:
                why = f"{value:.3f} degC is a jump from {self._good.value:.3f} degC"
                return replace(reading, quality=Quality.INVALID), why
        self._good, self._off_K = reading, value - expected_degC
        return reading, ""


class OhmmeterTrust:
    """Judges resistances (ohm); or another quantity, of which only frozen readings are known for none."""

    def __init__(self, resistance: bool = True) -> None:
        self._resistance = resistance
        self._same = Sameness()
        self._good = self._jumped = math.nan  # log10 of ohm
        self._good_s = 0.0
        self._times = 0

    def judge(self, reading: Reading, temperature_degC: float) -> tuple[Reading, str]:
        """The reading, with its quality lowered where it is none, and why. temperature_degC: read now, or nan."""
        if not reading.is_number:
            if reading.quality is Quality.OVERRANGE:
                self._good = math.nan
            return reading, reading.why or f"it is {reading.quality}"
        value, now = reading.value, reading.time_s
        alike, _, moved_K = self._same.take(value, now, math.nan, temperature_degC)
        self._same.frozen |= alike >= ENOUGH and (self._same.is_no_chance or moved_K > OTHER_K)
        if self._same.frozen:
            return replace(reading, quality=Quality.STALE), f"frozen at {value!r}, {alike} times alike"
        if not self._resistance or value <= 0.0:
            return reading, ""
        y = math.log10(value)
        if abs(y - self._good) > LEAST_JUMP_DEC + LEAST_JUMP_DEC_PER_S * (now - self._good_s):
            self._times = self._times + 1 if abs(y - self._jumped) < AGREEING_DEC else 1
            self._jumped = y
            if self._times < THRICE:
                why = f"{value:.6g} ohm is a jump from {10.0**self._good:.6g} ohm"
                return replace(reading, quality=Quality.INVALID), why
        self._good, self._good_s, self._times = y, now, 0
        return reading, ""
