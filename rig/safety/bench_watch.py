"""Everything that watches one run, in the order in which a tick meets it.

late       the program itself did not look for too long while the output was on
credible   a reading that is frozen, jumps or is missing is none
limits     temperature, test current; no good reading for too long
plate      heat that was put in has to show (`plate_watch`); without a known plate, coarsely (`runaway`)
command    a current within the limits, and not beyond that of largest cooling
status     about once a second, what the controller says about itself

It sees readings and commands, no law and no model of the film, and raises `Tripped`; what follows is not its business.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from rig.core.errors import Disconnected, InstrumentError
from rig.core.outcome import Tripped
from rig.core.reading import Quality, Reading
from rig.drivers.controller import Status, TemperatureController
from rig.safety.after_off import Courses
from rig.safety.courses import HeldSetpoint, of_a_plate
from rig.safety.credible import OhmmeterTrust, ThermometerTrust
from rig.safety.first_plate import KnownPlate
from rig.safety.interlock import Limits, Watch, check_current, check_readings
from rig.safety.plate_watch import PlateWatch
from rig.safety.runaway import RunawayWatch

STATUS_EVERY_S = 1.0  # an exchange takes some milliseconds of a tick


@dataclass(frozen=True)
class Sent:
    """What is on: a current (A, nan: not known), a setpoint of the controller's own regulation (degC, nan: none).

    armed: whether the output is on at all.
    """

    current_A: float = 0.0
    setpoint_degC: float = math.nan
    armed: bool = False

    @property
    def heats_or_cools(self) -> bool:
        """Whether anything flows, or may flow."""
        return self.armed and self.current_A != 0.0


OFF = Sent()


class BenchWatch:
    """One run's watch. resistance: whether the meter reads one (otherwise only frozen readings of it are known)."""

    def __init__(self, limits: Limits, now_s: float, resistance: bool) -> None:
        self.limits = limits
        self.plate = PlateWatch(limits.current_A, limits.high_degC, limits.runaway_s)
        self._held, self._is_off = HeldSetpoint(), True
        self._coarse = RunawayWatch(limits.current_A, limits.runaway_s)
        self._thermometer = ThermometerTrust(limits.rate_K_per_s, limits.current_A)
        self._ohmmeter = OhmmeterTrust(resistance)
        self._resistance = resistance
        self._good = Watch(now_s, now_s)
        self._looked_s = self._status_s = now_s

    def know(self, known: KnownPlate) -> None:
        """From now on readings are judged by what this plate does."""
        self.plate.know(known)
        self._thermometer.leave_currents_to_the_watch()

    def begin_anew(self, now_s: float) -> None:
        """The output was off for a while: nothing of before says anything about now."""
        self._good = Watch(now_s, now_s)
        self._looked_s = now_s
        self.plate.forget()
        self._coarse.forget()
        self._thermometer.forget()

    def unwatched_s(self, now_s: float) -> float:
        """How long nobody has looked."""
        return now_s - self._looked_s

    def judge(
        self, asked_s: float, now_s: float, sent: Sent, temperature: Reading, resistance: Reading | None
    ) -> tuple[Reading, Reading | None, dict[str, str]]:
        """The readings with the quality that they deserve, and why one is none, by instrument. Raises Tripped.

        asked_s: when the instruments were asked for them; now_s: when they had answered, or not. sent: since the tick
        before.
        """
        self._check_late(asked_s, sent)
        self._looked_s = now_s
        degC = temperature.value if temperature.is_number else math.nan
        log_ohm = self._log_ohm(resistance)
        expected = self.plate.expected_degC(now_s, sent.current_A)
        temperature, why = self._thermometer.judge(temperature, sent.current_A, log_ohm, expected)
        why_not = ""
        if resistance is not None:
            resistance, why_not = self._ohmmeter.judge(resistance, degC)
        self._good = check_readings(self.limits, self._good, now_s, temperature, resistance, (why, why_not))
        known = temperature.value if temperature.is_number else math.nan
        self.plate.look(now_s, known, sent.current_A)
        self._held.look(now_s, known, sent.setpoint_degC, sent.armed)
        if self.plate.known is None or math.isnan(sent.current_A):
            self._coarse.look(now_s, known, sent.current_A, sent.setpoint_degC)
        reasons = {"thermometer": why, "ohmmeter": why_not}
        return temperature, resistance, {name: reason for name, reason in reasons.items() if reason}

    def allow(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Raises Tripped where a current may not be sent."""
        check_current(self.limits, now_s, current_A)
        self.plate.check_cooling(now_s, temperature_degC, current_A)

    def look_at_status(self, now_s: float, sent: Sent, controller: TemperatureController) -> None:
        """About once a second. Raises Tripped where the controller is in an error, or has switched its output off."""
        if not sent.armed or now_s - self._status_s < STATUS_EVERY_S:
            return
        self._status_s = now_s
        status = status_of(controller)
        if status is not None and status.is_error:
            raise Tripped("controller_error", f"the controller reports {status_in_words(status)}", now_s)
        if status is not None and sent.heats_or_cools and not status.output_is_on:
            text = f"the controller has switched its output off by itself; it says: {status.text}"
            raise Tripped("controller_off", text, now_s)

    def armed(self, now_s: float) -> None:
        """The output was switched on, and its status was seen to be on."""
        self._status_s, self._is_off = now_s, False

    def rests(self) -> None:
        """The output was switched off, and goes on again later."""
        self._is_off = True

    def after_off(self, current_A: float, within_s: float | None = None) -> Courses | None:
        """What the thermometer would show if the output went off now; None where no reading could choose in time.

        current_A: what is on, nan where that is not known. within_s: how long anybody will look, s.
        """
        if self._is_off:
            return None
        return of_a_plate(self.plate, current_A, within_s) or self._held.courses(within_s)

    def _check_late(self, asked_s: float, sent: Sent) -> None:
        unwatched_s = self.unwatched_s(asked_s)
        if sent.heats_or_cools and unwatched_s > self.limits.stale_s:
            text = (
                f"this program did not read for {unwatched_s:.2f} s with the output on; expected every "
                f"{self.limits.stale_s:g} s at the most: is the computer busy, or was it asleep?"
            )
            raise Tripped("program_late", text, asked_s)
        if unwatched_s > 0.5 * self.limits.stale_s:  # what is old is not the thermometer's fault
            self._good = Watch(self._good.temperature_s + unwatched_s, self._good.resistance_s + unwatched_s)

    def _log_ohm(self, reading: Reading | None) -> float:
        if self._resistance and reading is not None and reading.is_number and reading.value > 0.0:
            return math.log10(reading.value)
        return math.nan


def status_of(controller: TemperatureController) -> Status | None:
    """What the controller says about itself; None where it does not answer (that is for the readings to judge)."""
    try:
        return controller.status()
    except Disconnected:
        raise
    except InstrumentError:
        return None


def status_in_words(status: Status) -> str:
    """What it says, what that means and how to clear it, as far as that is known."""
    return "; ".join(part for part in (status.text, status.meaning, status.remedy) if part)


def is_reading(reading: Reading | None) -> bool:
    """Whether it counts, as a number or as beyond the range."""
    return reading is not None and (reading.is_number or reading.quality is Quality.OVERRANGE)
