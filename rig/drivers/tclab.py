"""TCLab, the Temperature Control Lab: an Arduino with two heaters and two thermometers, on USB at 115200 Bd.

Source: the board's public firmware, TCLab-sketch 1.4.0 and 2.0.1 (older ones take whole percents only and are Refused).

A heater takes a drive and cannot cool (`rig.drivers.heater_drive`): 1 is 100 % of the heater's power limit, `full_pwm`
of 255. The board truncates to whole steps of 1/255 of the supply, so that with the usual 200 the drive has 200 steps.
It has no regulation, so no setpoints, and no limits of its own: beyond 50 degC its LED blinks, that is all.

Its dead man: none. The text at the head of the firmware says that the heaters are shut down when no command comes for
a while; the code did so after 300 s in 2017 (0.03), and from 1.1.0 on it does not. What it does do: an unknown command,
such as a garbled one, switches both heaters off.

A reading is the middle one of three conversions (0.32 K each on 1.4.0, the mean of ten of them from 1.6.0), which have
to be within `agreement_K` of each other; otherwise three more are made. Residual: all three hurt alike. What was set is
read back (R1, R2); that is the board's memory of what it was told, there is no ammeter. How the replies are proven:
`rig.drivers.tclab_link`.
"""

from __future__ import annotations

import re
from math import nan
from typing import ClassVar

from rig.core.errors import Corrupt, Refused
from rig.core.reading import Quality, Reading
from rig.drivers.asked_again import asked_again
from rig.drivers.confirmed import OFF_S, confirmed_off
from rig.drivers.controller import Status
from rig.drivers.heater_drive import HeaterDrive
from rig.drivers.identity import Identity
from rig.drivers.tclab_link import TcLabLink
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

TRIALS = 3  # one answer may be hurt, and its repetition by the same disturbance
VERSION = re.compile(r"TCLab Firmware (?:Version )?(\d+)\.(\d+)\.?(\S*)\s*(.*)", re.IGNORECASE)
OLDEST = (1, 4)  # of firmware: those before take whole percents only
NUMBER = re.compile(r"-?\d{1,3}\.\d{2,3}")
RESOLUTION_PERCENT = 0.006  # replies have two decimals or three
LOWEST_DEGC, HIGHEST_DEGC = -40.0, 150.0  # of its thermometers, TMP36; beyond it is an open input
LONGEST_BOOT_S = 10.0  # an Arduino needs two seconds; `peltier off` waits for it where nobody answers
FIRMWARE_PWM = 200  # its default for heater 1


class TcLabController(HeaterDrive):
    """See `rig.drivers.controller.TemperatureController`.

    heater: 1 or 2, with the thermometer of that number; the other one stays off. full_pwm: what full drive is, of 255.
    boot_s: how long a board that restarts when its port is opened does not listen. agreement_K: see above.
    """

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=115200)
    confirms_off_by: ClassVar[str] = "both heaters read back twice as 0; it measures no current"
    NAME = "a TCLab"

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        heater: int = 1,
        full_pwm: int = FIRMWARE_PWM,
        boot_s: float = 2.0,
        agreement_K: float = 1.0,
        first_token: int | None = None,
    ) -> None:
        if heater not in (1, 2):
            raise ValueError(f"heater {heater}: 1 or 2 is expected")
        if not 1 <= full_pwm <= 255:
            raise ValueError(f"full_pwm {full_pwm}: 1 to 255 is expected")
        if agreement_K <= 0.0:
            raise ValueError(f"agreement_K {agreement_K}: more than 0 is expected")
        if not 0.0 <= boot_s <= LONGEST_BOOT_S:
            raise ValueError(f"boot_s {boot_s}: 0 to {LONGEST_BOOT_S:g} is expected")
        self.transport = transport
        self.link = TcLabLink(
            transport, fence=f"P{3 - heater}", byte_s=line.byte_s, boot_s=boot_s, first_token=first_token
        )
        self._heater, self._full_pwm = heater, full_pwm
        self._byte_s, self._agreement_K = line.byte_s, agreement_K
        self._armed = False
        self._percent = 0.0
        self._looked_after = 0

    @asked_again
    def identify(self) -> Identity:
        """VER. Refused where it is no TCLab, or one whose firmware is too old."""
        (text,) = self.link.ask("VER")
        found = VERSION.fullmatch(text)
        if found is None:
            raise Refused(None, f"{text!r} is no TCLab")
        firmware = ".".join(part for part in found.groups()[:3] if part)
        if (int(found[1]), int(found[2])) < OLDEST:
            raise Refused(None, f"TCLab firmware {firmware} is too old; 1.4.0 or newer is expected")
        return Identity("TCLab", found[4], "", firmware)

    @asked_again
    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Both heaters off, and what full drive is; each read back. current_limit_A: the largest drive, at most 1.

        The board has no temperature limits and no dead man that could be set.
        """
        self._check_limits(current_limit_A, temperature_limits_degC)
        self._armed = False
        self._set("Q1", 0.0)
        self._set("Q2", 0.0)
        self._set(f"P{self._heater}", float(self._full_pwm))
        self._percent = 0.0
        self.drive_limit = current_limit_A
        self.temperature_limits_degC = temperature_limits_degC

    def arm_current(self) -> None:
        """Ready for `set_current_A`, at no drive: the board has no switch for that, this driver keeps it."""
        self._check_drive(0.0)
        self._set(f"Q{self._heater}", 0.0)
        self._looked_after = self.link.resynchronised
        self._percent, self._armed = 0.0, True

    def set_current_A(self, current_A: float) -> None:
        """Drive from now on, 0 to 1 of full drive, read back. ValueError outside the limit: nothing is sent."""
        self._check_drive(current_A)
        if self.link.in_doubt:
            self.link.resynchronise()
        self._look_after_doubt()
        if not self._armed:
            raise Refused(None, "the heater is not armed")
        percent = 100.0 * current_A
        self._set(f"Q{self._heater}", percent)
        self._percent = percent

    def read_temperature(self) -> Reading:
        """Thermometer of the heater, degC; `time_s` is when the second of three conversions was made."""
        question = f"T{self._heater}"
        for _ in range(TRIALS):
            replies = self.link.ask(question, question, question)
            low, middle, high = sorted(self._number(reply) for reply in replies)
            if high - low <= self._agreement_K:
                self._look_after_doubt()
                good = LOWEST_DEGC <= middle <= HIGHEST_DEGC
                # after two questions and one reply on the line
                time_s = self.link.sent_s + (2 * len("T1\n") + len("25.00\r\n")) * self._byte_s
                return Reading(middle if good else nan, time_s, Quality.OK if good else Quality.INVALID)
        self.link.doubt()
        raise Corrupt(f"three readings one after the other are {low}, {middle} and {high} degC")

    def read_current(self) -> Reading:
        """Drive as the board remembers it, 0 to 1 of full drive."""
        first, second = self._number_pair(f"R{self._heater}")
        if first != second:
            self.link.doubt()
            raise Corrupt(f"{first} and {second} are not twice the same drive")
        return Reading(first / 100.0, self.link.sent_s, Quality.OK)

    def status(self) -> Status:
        """The drives of both heaters; the board tells nothing else."""
        first, second = (self._number(reply) for reply in self.link.ask("R1", "R2"))
        self._look_after_doubt()
        return Status(f"heater 1 at {first:g} %, heater 2 at {second:g} %", False, first > 0.0 or second > 0.0)

    def off(self) -> bool:
        """Both heaters off, at once, and again until both read back 0, twice, which makes it True. Never raises.

        A board whose port was opened less than `boot_s` ago may not listen yet: it is asked once more when it does.
        """
        self._armed = False
        clock, ways = self.transport.clock, ((self._off_once, OFF_S),)
        is_off = confirmed_off(self.transport, ways, self.link.doubt)
        if is_off or clock.now_s() >= self.link.listens_s:
            return is_off
        clock.sleep_until_s(self.link.listens_s)
        return confirmed_off(self.transport, ways, self.link.doubt)

    def _off_once(self) -> bool:
        if self.link.in_doubt:
            self.link.shout("X")
            self.link.resynchronise(trials=1, boots=False)
        replies = self.link.ask("Q1 0", "Q2 0", "R1", "R2", "R1", "R2")
        return [self._number(reply) for reply in replies] == [0.0] * 6

    def _set(self, name: str, value: float) -> None:
        """Set; the reply is what the board has kept. A heater is asked again. Refused where that differs."""
        commands = [f"{name} {value:.2f}"] + ([f"R{name[1]}"] if name.startswith("Q") else [])
        for reply in self.link.ask(*commands):
            if abs(self._number(reply) - value) > RESOLUTION_PERCENT:
                self.link.doubt()
                raise Refused(None, f"{name} was set to {value:.2f}, and the board answers {reply!r}")

    def _number_pair(self, question: str) -> tuple[float, float]:
        first, second = self.link.ask(question, question)
        return self._number(first), self._number(second)

    def _number(self, text: str) -> float:
        if NUMBER.fullmatch(text) is None:
            self.link.doubt()
            raise Corrupt(f"{text!r} is no number of a TCLab")
        return float(text)

    def _look_after_doubt(self) -> None:
        """A board that has restarted in between, or has not understood a command, has its heaters off: not armed."""
        if self.link.resynchronised == self._looked_after:
            return
        if self._armed and self._percent > 0.0:
            first, second = self._number_pair(f"R{self._heater}")
            self._armed = first == second and abs(first - self._percent) <= RESOLUTION_PERCENT
        self._looked_after = self.link.resynchronised
