"""TCLab, the Temperature Control Lab: an Arduino with two heaters and two thermometers, on USB at 115200 Bd.

Source: the board's public firmware, TCLab-sketch 1.4.0 and 2.0.1 (older ones take whole percents only and are Refused).

A heater takes a drive and cannot cool: 1 is 100 % of the heater's power limit, 200 of 255, in 200 steps. It has no
regulation, so no setpoints, and no limits of its own. It has no dead man: the text at the head of the firmware says so,
the code had one in 2017 (0.03) and none from 1.1.0 on. But an unknown command, such as a garbled one, switches both
heaters off.

A command is a line, and so is its reply; nothing in a reply names its command, there is no checksum, and the board
obeys in order. A fence closes every group of commands: the power limit of the heater that is not in use (P2 for heater
1) is set to a number that counts up from 0.01 to 100.00 (never above the board's own default), and the board answers
with it. If every command has had one line, and the fence its own, none of them was an older one's. A line in doubt gets
an end of line, which closes what may lie half-sent, then fences until one comes back. Residual: a reply lost and
another doubled in the same group.

A reading is the middle one of three conversions (0.32 K each on 1.4.0, the mean of ten of them from 1.6.0), which have
to be within a kelvin of each other. Residual: all three hurt alike. A setting is read back (R1, R2) from the board's
memory; there is no ammeter.

Opening the port restarts an Arduino Uno (not a Leonardo): its heaters are off then, and it listens `boot_s` later. Only
the first exchange waits for that: a port that is opened anew in mid-run may have a STOP behind that exchange.
"""

from __future__ import annotations

import re
from math import nan
from typing import Any, ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import OF_FULL_DRIVE, OFF_S, Status, TemperatureController, check_within, confirmed_off
from rig.drivers.in_step import RESYNCHRONISATIONS, SteppedLink, retry_once
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

END = b"\n"
REPLY_END = b"\r\n"
LONGEST_GROUP = 60  # bytes; the Arduino holds 64 that it has not read yet
LONGEST_REPLY = 40  # characters
STALE_LINES = 64  # that may come before a fence, when the line is in doubt
TRIALS = 3  # one answer may be hurt, and its repetition by the same disturbance
VERSION = re.compile(r"TCLab Firmware (?:Version )?(\d+)\.(\d+)\.?(\S*)\s*(.*)", re.IGNORECASE)
OLDEST = (1, 4)  # of firmware: those before take whole percents only
NUMBER = re.compile(r"-?\d{1,3}\.\d{2,3}")
RESOLUTION_PERCENT = 0.006  # replies have two decimals or three
LOWEST_DEGC, HIGHEST_DEGC = -40.0, 150.0  # of its thermometers, TMP36; beyond it is an open input
LONGEST_BOOT_S = 10.0  # an Arduino needs two seconds; `peltier off` waits for it if no answer comes
FULL_PWM = 200.0  # power limit of 255 that is full drive: the firmware's default for heater 1
AGREEMENT_K = 1.0  # of three conversions


class TcLabLink(SteppedLink):
    """The line of one board; see `SteppedLink`. fence: the command whose number fences.

    answer_s: until a group's last reply, beyond the time on the wire.
    """

    LARGEST_TOKEN = 10000  # hundredths
    REOPENS = False  # that restarts some boards

    def __init__(
        self,
        transport: Transport,
        *,
        fence: str,
        byte_s: float,
        boot_s: float,
        answer_s: float = 0.25,
        **options: Any,
    ) -> None:
        super().__init__(transport, byte_s=byte_s, **options)
        self._fence, self._answer_s = fence, answer_s
        self.listens_s = transport.clock.now_s() + boot_s  # the past, once it has answered
        self.sent_s = 0.0  # when the last group was sent

    def ask(self, *commands: str) -> list[str]:
        """Return the replies to some commands, proven by a fence. TimedOut, Corrupt, OutOfStep, Disconnected."""
        transport = self.transport
        self.be_in_step()
        self.in_doubt = True
        expected = self._next_token()
        data = "\n".join((*commands, f"{self._fence} {expected}\n")).encode("ascii")
        if len(data) > LONGEST_GROUP:
            raise ValueError(f"{data!r} does not fit into the board's {LONGEST_GROUP} bytes")
        transport.send(data)
        self.sent_s = transport.clock.now_s()
        characters = len(data) + LONGEST_REPLY * (len(commands) + 1)
        deadline_s = self.sent_s + self._answer_s + characters * self._byte_s
        *replies, fence = [self._line(deadline_s) for _ in range(len(commands) + 1)]
        if fence != expected:
            raise OutOfStep(f"{fence!r} came back where {expected!r} was expected: replies are out of step")
        if transport.has_more:
            raise OutOfStep("there were more replies than commands")
        self.in_doubt = False
        return replies

    def shout(self, command: str) -> None:
        """Send a command at once, whatever the line is doing, and wait for no reply."""
        self.in_doubt = True
        self.transport.send(END + command.encode("ascii") + END)

    def resynchronise(self, trials: int = RESYNCHRONISATIONS, *, boots: bool = True) -> None:
        """Send fences until one comes back; open a port whose device was gone anew. InstrumentError.

        boots: whether a board that was opened just now is given the time until it listens.
        """
        if boots:
            self.transport.clock.sleep_until_s(self.listens_s)
        super().resynchronise(trials)
        self.listens_s = self.transport.clock.now_s()

    def _prove(self, attempt: int) -> None:
        transport = self.transport
        transport.drain()
        expected = self._next_token()
        data = END + f"{self._fence} {expected}\n".encode("ascii")
        transport.send(data)
        deadline_s = transport.clock.now_s() + self._answer_s + (len(data) + LONGEST_REPLY) * self._byte_s
        for _ in range(STALE_LINES):
            if self._line(deadline_s) == expected:
                return
        raise OutOfStep("the line cannot be brought in step")

    def _line(self, deadline_s: float) -> str:
        return self.transport.receive_line(REPLY_END, deadline_s).decode("latin-1")

    def _next_token(self) -> str:
        self._token = self._token % self.LARGEST_TOKEN + 1
        return f"{self._token / 100.0:.2f}"


class TcLabController(TemperatureController):
    """See `rig.drivers.controller.TemperatureController`.

    heater: 1 or 2, with the thermometer of that number; the other one stays off.
    boot_s: how long a board that restarts when its port is opened does not listen.
    """

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=115200)
    ON_VISA: ClassVar[bool] = False
    LARGEST_CURRENT: ClassVar[float] = 1.0
    drive_unit: ClassVar[str] = OF_FULL_DRIVE
    cools: ClassVar[bool] = False
    commands_current: ClassVar[bool] = True
    confirms_off_by: ClassVar[str] = "both heaters read back twice as 0; it measures no current"
    NAME = "a TCLab"
    link: TcLabLink

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        heater: int = 1,
        boot_s: float = 2.0,
        first_token: int | None = None,
    ) -> None:
        if heater not in (1, 2):
            raise ValueError(f"heater {heater}: 1 or 2 is expected")
        check_within(boot_s=(boot_s, 0.0, LONGEST_BOOT_S))
        self.transport = transport
        self.link = TcLabLink(
            transport,
            fence=f"P{3 - heater}",
            byte_s=line.byte_s,
            boot_s=boot_s,
            first_token=first_token,
            after_resynchronisation=self._check_after_doubt,
        )
        self._heater, self._byte_s = heater, line.byte_s
        self._percent = 0.0

    @retry_once
    def identify(self) -> Identity:
        """Ask VER. Refused if it is no TCLab, or one whose firmware is too old."""
        (text,) = self.link.ask("VER")
        found = VERSION.fullmatch(text)
        if found is None:
            raise Refused(None, f"{text!r} is no TCLab")
        firmware = ".".join(part for part in found.groups()[:3] if part)
        if (int(found[1]), int(found[2])) < OLDEST:
            raise Refused(None, f"TCLab firmware {firmware} is too old; 1.4.0 or newer is expected")
        return Identity("TCLab", found[4], "", firmware)

    @retry_once
    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Set both heaters off, and full drive; read back each. current_limit_A: the largest drive, at most 1.

        The board has no temperature limits and no dead man that could be set.
        """
        self._set("Q1", 0.0)
        self._set("Q2", 0.0)
        self._set(f"P{self._heater}", FULL_PWM)
        self._percent = 0.0

    def _send(self, commands: str, value: float, arming: bool) -> None:
        percent = 100.0 * value
        self._set(f"Q{self._heater}", percent)
        self._percent = percent

    def _switch_on(self, commands: str) -> None:
        """Do nothing: the board has no such switch."""

    def read_temperature(self) -> Reading:
        """Read the heater's thermometer, degC; `time_s` is when the second of three conversions was made."""
        question = f"T{self._heater}"
        for _ in range(TRIALS):
            replies = self.link.ask(question, question, question)
            low, middle, high = sorted(self._number(reply) for reply in replies)
            if high - low <= AGREEMENT_K:
                good = LOWEST_DEGC <= middle <= HIGHEST_DEGC
                # after two questions and one reply on the line
                time_s = self.link.sent_s + (2 * len("T1\n") + len("25.00\r\n")) * self._byte_s
                return Reading(middle if good else nan, time_s, Quality.OK if good else Quality.INVALID)
        self.link.doubt()
        raise Corrupt(f"three readings one after the other are {low}, {middle} and {high} degC")

    def read_current(self) -> Reading:
        """Read the drive as the board remembers it, 0 to 1 of full drive."""
        first, second = self._number_pair(f"R{self._heater}")
        if first != second:
            self.link.doubt()
            raise Corrupt(f"{first} and {second} are not twice the same drive")
        return Reading(first / 100.0, self.link.sent_s, Quality.OK)

    def status(self) -> Status:
        """Read the drives of both heaters; the board reports nothing else."""
        first, second = (self._number(reply) for reply in self.link.ask("R1", "R2"))
        return Status(f"heater 1 at {first:g} %, heater 2 at {second:g} %", False, first > 0.0 or second > 0.0)

    def off(self) -> bool:
        """Switch both heaters off, again and again; return True if both read back 0 twice. Never raises.

        A board whose port was opened less than `boot_s` ago may not listen yet: it is asked once more when it does.
        """
        self._armed = None
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
        """Set a value; the reply is the value that the board kept. A heater is asked again. Refused if that differs."""
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

    def _is_on(self, _: str) -> bool:
        if not self._percent:
            return True
        first, second = self._number_pair(f"R{self._heater}")
        return first == second and abs(first - self._percent) <= RESOLUTION_PERCENT
