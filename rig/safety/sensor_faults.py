"""Detect frozen and jumping readings; lower their quality and give the reason in words.

frozen   the same number, to the last bit, many times. An instrument whose noise moved its readings up and down just
         before is frozen if so many equal readings have a probability below `BY_CHANCE`. One with coarse steps, or
         without noise, is frozen if something else shows that the quantity has moved meanwhile: the current has since
         changed by enough to move it by several steps, or the other instrument's reading has moved.
jumping  a temperature that moved by more than the current that was sent explains, plus what any plate may add: no
         reading counts until it is back where the plate can be, so that a lasting step becomes a stale thermometer.
         A resistance that moved by half a decade at once: the film can do that, so the third equal reading counts.

Readings that are impossible by themselves (nan, a negative resistance, an open sensor) are marked by the driver.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from rig.core.reading import Quality, Reading

ENOUGH = 10  # equal readings, at least
BY_CHANCE = 1e-9
JUST_BEFORE = 40  # earlier readings, which show the instrument's noise
LEVELS = 4  # different numbers among them: near a threshold a coarse instrument alternates between two
TURNS = 0.15  # share of them that reverse the direction: two thirds for pure noise, fewer on a ramp, none without noise
LOOK_BACK_S = 20.0  # over which current and the other reading are compared
LEAST_K = 0.5  # movement that the current should have caused: fifty times a thermometer's typical noise
LEAST_JUMP_K = 1.0  # noise and drift between two readings stay below a tenth of it
STEPS = 4.0  # of a coarse instrument: least size of a movement or a jump
LEAST_JUMP_DEC, LEAST_JUMP_DEC_PER_S = 0.5, 5.0
AGREEING_DEC = 0.3  # between readings after a jump: a film in its transition moves by less
THRICE = 3  # agreeing readings after a jump: then the film has jumped, not the meter
OTHER_DEC, OTHER_K = 0.1, 3.0  # least movement of the other instrument
ANY_PLATE_K_PER_S = 3.0  # in addition to the effect of the current; a lasting step of 10 K is never within it
SLOWEST_K_PER_S = 1.5  # at the current limit, while no plate is known: it may be ten times slower
STEEPEST_DEC_PER_K = 2.0  # steepest film: below that, a coarse thermometer need not have moved


class Repeats:
    """Counts equal readings in sequence, and how far current and the other instrument moved meanwhile."""

    def __init__(self) -> None:
        self.step = math.inf  # smallest difference seen
        self._last = math.nan
        self._last_change = 0.0
        self._alike = 1
        self._runs: deque[tuple[float, int, bool]] = deque()  # value, how often in sequence, whether it reversed
        self._since_s = self._time_s = 0.0
        self._drives: list[float] = []  # at the first of the equal readings
        self._first_other = math.nan
        self._drive = 0.0
        self.frozen = False  # set by the owner; cleared by a different reading

    def take(self, value: float, time_s: float, drive: float, other: float) -> tuple[int, float, float]:
        """Return the number of equal readings, the integral of drive minus its first mean, and the other's movement.

        drive: what moves the quantity (nan: unknown); other: the other instrument's reading (nan: none).
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
    def is_improbable(self) -> bool:
        """True if the noise just before hardly ever gives so many equal readings."""
        count = self._count()
        turns, levels = sum(turned for *_, turned in self._runs), len({value for value, *_ in self._runs})
        if count < JUST_BEFORE or turns < TURNS * count or levels < LEVELS:
            return False
        again = (count - len(self._runs) + 2) / (count + 2)  # probability of one more, a little above that seen
        return self._alike >= ENOUGH and again**self._alike < BY_CHANCE

    def _count(self) -> int:
        """Return the number of readings just before."""
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


class ThermometerCheck:
    """Checks temperatures (degC). rate_K_per_s: limits.rate_K_per_s; limit_A: of the current."""

    def __init__(self, rate_K_per_s: float, limit_A: float) -> None:
        self._rate_K_per_s = min(rate_K_per_s, ANY_PLATE_K_PER_S)
        self._gain_K_per_A_s = SLOWEST_K_PER_S / limit_A
        self._same = Repeats()
        self._good: Reading | None = None
        self._off_K = math.nan

    def ignore_currents(self) -> None:
        """Judge frozen readings without the current: `plate_watch` knows the plate, its loss and its lag."""
        self._gain_K_per_A_s = 0.0

    def forget(self) -> None:
        """Forget the last good reading: too much time has passed since."""
        self._good = None

    def judge(
        self, reading: Reading, current_A: float, log_resistance: float, expected_degC: float = math.nan
    ) -> tuple[Reading, str]:
        """Return the reading, its quality lowered if it does not count, and the reason.

        current_A: sent since the reading before (nan: unknown); log_resistance: log10 of the film's, now;
        expected_degC: of the plate model (nan: unknown).
        """
        if not reading.is_number:
            return reading, reading.why or f"it is {reading.quality}"
        value, now = reading.value, reading.time_s
        alike, charge, moved_dec = self._same.take(value, now, current_A, log_resistance)
        step = self._same.step if math.isfinite(self._same.step) else 0.0
        if alike >= ENOUGH:
            by_current = abs(charge) * self._gain_K_per_A_s > STEPS * step + LEAST_K
            by_film = moved_dec > max(OTHER_DEC, STEEPEST_DEC_PER_K * STEPS * step)
            self._same.frozen |= self._same.is_improbable or by_current or by_film
            if self._same.frozen:
                return replace(reading, quality=Quality.STALE), f"frozen at {value!r} degC for {alike} readings"
        if self._good is not None:
            room = max(LEAST_JUMP_K, STEPS * step) + self._rate_K_per_s * (now - self._good.time_s)
            off_K = value - expected_degC
            moved_K = value - self._good.value if math.isnan(off_K) or math.isnan(self._off_K) else off_K - self._off_K
            if abs(moved_K) > room:
                why = f"{value:.3f} degC is a jump from {self._good.value:.3f} degC"
                return replace(reading, quality=Quality.INVALID), why
        self._good, self._off_K = reading, value - expected_degC
        return reading, ""


class OhmmeterCheck:
    """Checks resistances (ohm), or another quantity, of which only frozen readings are detected."""

    def __init__(self, resistance: bool = True) -> None:
        self._resistance = resistance
        self._same = Repeats()
        self._good = self._jumped = math.nan  # log10 of ohm
        self._good_s = 0.0
        self._times = 0

    def judge(self, reading: Reading, temperature_degC: float) -> tuple[Reading, str]:
        """Return the reading as `ThermometerCheck.judge` does. temperature_degC: the film's, now, or nan."""
        if not reading.is_number:
            if reading.quality is Quality.OVERRANGE:
                self._good = math.nan
            return reading, reading.why or f"it is {reading.quality}"
        value, now = reading.value, reading.time_s
        alike, _, moved_K = self._same.take(value, now, math.nan, temperature_degC)
        self._same.frozen |= alike >= ENOUGH and (self._same.is_improbable or moved_K > OTHER_K)
        if self._same.frozen:
            return replace(reading, quality=Quality.STALE), f"frozen at {value!r} for {alike} readings"
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
