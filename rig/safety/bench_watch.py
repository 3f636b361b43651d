"""The interlock: all checks of one run, outside the control law, so that a wrong model cannot argue with them.

Each tick gives it the readings and the command that the law wants to send. It passes them or raises `Tripped`; it never
corrects a value silently. Switching the output off after a trip is not its task. In the order of a tick:

late       this program itself did not read for too long while the output was on
readings   a frozen, jumping or missing reading does not count (`rig.safety.sensor_faults`)
limits     temperature, test current; no good reading for too long
plate      heat that was put in has to show (`rig.safety.plate_watch`)
command    a current within the limits, and not beyond that of largest cooling
status     about once a second, the controller's own report
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from rig.core.errors import Disconnected, InstrumentError
from rig.core.outcome import Tripped
from rig.core.reading import Quality, Reading
from rig.drivers.controller import Status, TemperatureController
from rig.safety.after_off import ExpectedCurves, HeldSetpoint, curves_of_plate
from rig.safety.first_plate import KnownPlate
from rig.safety.plate_watch import PlateWatch, RunawayWatch
from rig.safety.sensor_faults import OhmmeterCheck, ThermometerCheck

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
