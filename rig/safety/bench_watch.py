"""The interlock: all checks of one run, outside the control law, so that a wrong model cannot argue with them.

Each tick gives it the readings and the command that the law wants to send. It passes them or raises `Tripped`; it never
corrects a value silently. Switching the output off after a trip is not its task. In the order of a tick:

late       this program itself did not read for too long while the output was on
readings   a frozen, jumping or missing reading does not count (`ThermometerCheck`, `OhmmeterCheck`)
limits     temperature, test current; no good reading for too long
plate      heat that was put in has to show (`rig.safety.plate_watch`)
command    a current within the limits, and not beyond that of largest cooling
status     about once a second, the controller's own report

Readings that do not count have their quality lowered, with the reason in words:

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
from dataclasses import dataclass, replace

from rig.core.errors import Disconnected, InstrumentError
from rig.core.outcome import Tripped
from rig.core.reading import Quality, Reading
from rig.drivers.controller import Status, TemperatureController
from rig.safety.plate_watch import KnownPlate, PlateWatch, RunawayWatch
from rig.safety.switching_off import ExpectedCurves, HeldSetpoint, curves_of_plate

STATUS_EVERY_S = 1.0  # an exchange takes some milliseconds of a tick
ROUNDING = 1.0 + 1e-9  # of a limit that was computed in other units


@dataclass(frozen=True)
class Limits:
    """Limits of the interlock.

    stale_s: largest age of the last good reading; rate_K_per_s: faster than any plate; runaway_s: longest time for
    which the temperature may go against the current.
    """

    low_degC: float
    high_degC: float
    current_A: float
    meter_current_A: float
    stale_s: float
    rate_K_per_s: float = 20.0
    runaway_s: float = 20.0


@dataclass(frozen=True)
class LastGood:
    """Times (s) of the last good readings of the two instruments."""

    temperature_s: float
    resistance_s: float


@dataclass(frozen=True)
class Sent:
    """The output as commanded: a current (A, nan: unknown), the controller's setpoint (degC, nan: none), armed."""

    current_A: float = 0.0
    setpoint_degC: float = math.nan
    armed: bool = False

    @property
    def heats_or_cools(self) -> bool:
        """True if a current flows, or may flow."""
        return self.armed and self.current_A != 0.0


OFF = Sent()


class BenchWatch:
    """Checks one run. resistance: True if the meter reads one; of another quantity only freezing is checked."""

    def __init__(self, limits: Limits, now_s: float, resistance: bool) -> None:
        self.limits = limits
        self.plate = PlateWatch(limits.current_A, limits.high_degC, limits.runaway_s)
        self._held, self._is_off = HeldSetpoint(), True
        self._coarse = RunawayWatch(limits.current_A, limits.runaway_s)
        self._thermometer = ThermometerCheck(limits.rate_K_per_s, limits.current_A)
        self._ohmmeter = OhmmeterCheck(resistance)
        self._resistance = resistance
        self._good = LastGood(now_s, now_s)
        self._looked_s = self._status_s = now_s

    def know(self, known: KnownPlate) -> None:
        """Judge the readings by this plate from now on."""
        self.plate.know(known)
        self._thermometer.ignore_currents()

    def begin_anew(self, now_s: float) -> None:
        """Forget all earlier readings: the output was off for a while."""
        self._good = LastGood(now_s, now_s)
        self._looked_s = now_s
        self.plate.forget()
        self._coarse.forget()
        self._thermometer.forget()

    def unwatched_s(self, now_s: float) -> float:
        """Return the time since the last readings."""
        return now_s - self._looked_s

    def judge(
        self, asked_s: float, now_s: float, sent: Sent, temperature: Reading, resistance: Reading | None
    ) -> tuple[Reading, Reading | None, dict[str, str]]:
        """Return the readings with their quality corrected, and the reasons by instrument. Raises Tripped.

        asked_s, now_s: when the instruments were asked and had answered, or not. sent: since the tick before.
        """
        self._check_late(asked_s, sent)
        self._looked_s = now_s
        degC = temperature.value if temperature.is_number else math.nan
        expected = self.plate.expected_degC(now_s, sent.current_A)
        temperature, why = self._thermometer.judge(temperature, sent.current_A, self._log_ohm(resistance), expected)
        why_not = ""
        if resistance is not None:
            resistance, why_not = self._ohmmeter.judge(resistance, degC)
        self._good = check_readings(self.limits, self._good, now_s, temperature, resistance, (why, why_not))
        known = temperature.value if temperature.is_number else math.nan
        self.plate.look(now_s, known, sent.current_A)
        self._held.add(now_s, known, sent.setpoint_degC, sent.armed)
        if self.plate.known is None or math.isnan(sent.current_A):
            self._coarse.look(now_s, known, sent.current_A, sent.setpoint_degC)
        reasons = {"thermometer": why, "ohmmeter": why_not}
        return temperature, resistance, {name: reason for name, reason in reasons.items() if reason}

    def allow(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Raise Tripped if a current may not be sent."""
        check_current(self.limits, now_s, current_A)
        self.plate.check_cooling(now_s, temperature_degC, current_A)

    def look_at_status(self, now_s: float, sent: Sent, controller: TemperatureController) -> None:
        """Ask for the status about once a second. Raises Tripped if the controller reports an error or is off."""
        if not sent.armed or now_s - self._status_s < STATUS_EVERY_S:
            return
        self._status_s = now_s
        status = status_of(controller)
        if status is not None and status.is_error:
            raise Tripped("controller_error", f"the controller reports {status_in_words(status)}", now_s)
        if status is not None and sent.heats_or_cools and not status.output_is_on:
            text = f"the controller has switched its output off by itself; it reports: {status.text}"
            raise Tripped("controller_off", text, now_s)

    def armed(self, now_s: float) -> None:
        """Note that the output was switched on, and that its status was on."""
        self._status_s, self._is_off = now_s, False

    def rests(self) -> None:
        """Note that the output was switched off, to go on again later."""
        self._is_off = True

    def after_off(self, current_A: float, within_s: float | None = None) -> ExpectedCurves | None:
        """Return the temperatures to expect if the output went off now; None if no reading could decide in time.

        current_A: now on (nan: unknown). within_s: for how long the temperature will be read.
        """
        if self._is_off:
            return None
        return curves_of_plate(self.plate, current_A, within_s) or self._held.curves(within_s)

    def _check_late(self, asked_s: float, sent: Sent) -> None:
        unwatched_s = self.unwatched_s(asked_s)
        if sent.heats_or_cools and unwatched_s > self.limits.stale_s:
            text = (
                f"this program did not read for {unwatched_s:.2f} s with the output on; expected at most "
                f"{self.limits.stale_s:g} s: is the computer overloaded, or was it asleep?"
            )
            raise Tripped("program_late", text, asked_s)
        if unwatched_s > 0.5 * self.limits.stale_s:  # the age of the readings is not the instruments' fault
            self._good = LastGood(self._good.temperature_s + unwatched_s, self._good.resistance_s + unwatched_s)

    def _log_ohm(self, reading: Reading | None) -> float:
        if self._resistance and reading is not None and reading.is_number and reading.value > 0.0:
            return math.log10(reading.value)
        return math.nan


def check_readings(
    limits: Limits,
    last: LastGood,
    now_s: float,
    temperature: Reading,
    resistance: Reading | None,
    why: tuple[str, str] = ("", ""),
) -> LastGood:
    """Return the times of the last good readings. Raises Tripped: out of limits, or no good reading for too long.

    why: of each instrument, the reason why its reading does not count. A good reading after too long a gap does not
    help: nobody knows what plate and film did meanwhile.
    """
    if temperature.is_number and not limits.low_degC <= temperature.value <= limits.high_degC:
        text = (
            f"temperature {temperature.value:.3f} degC is outside the limits "
            f"[{limits.low_degC:g}, {limits.high_degC:g}] degC"
        )
        raise Tripped("temperature_limit", text, now_s)
    for name, last_s, reason in (
        ("thermometer", last.temperature_s, why[0]),
        ("ohmmeter", now_s if resistance is None else last.resistance_s, why[1]),
    ):
        if now_s - last_s > limits.stale_s:
            text = f"no good reading of the {name} for {now_s - last_s:.2f} s; expected one every {limits.stale_s:g} s"
            raise Tripped(f"{name}_stale", text + (f"; {reason}" if reason else ""), now_s)
    if temperature.is_number:
        last = replace(last, temperature_s=now_s)
    if resistance is None or is_reading(resistance):
        last = replace(last, resistance_s=now_s)
    return last


def check_current(limits: Limits, now_s: float, current_A: float) -> None:
    """Raise Tripped if a current is not finite, or beyond the limit."""
    if not math.isfinite(current_A) or abs(current_A) > limits.current_A * ROUNDING:
        text = f"the law asked for {current_A!r} A; the limit is {limits.current_A:g} A"
        raise Tripped("current_limit", text, now_s)


def check_test_current(limits: Limits, now_s: float, test_current_A: float) -> None:
    """Raise Tripped if the meter's test current is above the limit; nan (unknown) passes."""
    if test_current_A > limits.meter_current_A * ROUNDING:
        text = (
            f"the meter's test current is {test_current_A:g} A; the limit is {limits.meter_current_A:g} A "
            "(limits.meter_current_A)"
        )
        raise Tripped("meter_current_limit", text, now_s)


def status_of(controller: TemperatureController) -> Status | None:
    """Return the controller's status; None if it does not answer, which the readings judge."""
    try:
        return controller.status()
    except Disconnected:
        raise
    except InstrumentError:
        return None


def status_in_words(status: Status) -> str:
    """Return the status, its meaning and its remedy, as far as they are known."""
    return "; ".join(part for part in (status.text, status.meaning, status.remedy) if part)


def is_reading(reading: Reading | None) -> bool:
    """Return True if the reading counts, as a number or as beyond the range."""
    return reading is not None and (reading.is_number or reading.quality is Quality.OVERRANGE)


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
