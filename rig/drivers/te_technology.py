"""TE Technology TC-36-25 RS232 and TC-48-20 temperature controllers.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50 (codes are hexadecimal); TC-48-20 manual, Appendix B p. 48 to 54.

They command power in percent, never amperes, so the current is unknown and cannot be limited, and the rig falls back to
setpoints for the instrument's own regulation. There is no dead man.

TC-36-25: writing to its EEPROM (some 1e6 times) is switched off (34) first; the working units (4b) are read before a
temperature is trusted; the fence's number goes to the control deadband (25), which only the deadband type of control
uses, and the driver chooses PID (2b). Not verified: that alarm type 2 is fixed alarms, that the deadband takes 0.01 to
99.99. TC-48-20: no code is known that reads its units (`units` has to be given), switches its EEPROM off or sets its
alarms; its output enable reads back by code 64 (not verified: `power_read_code`); the model number (00) is its fence.

Frames have lower-case hexadecimal and an 8-bit sum (`sim.instruments.te_technology`); nothing in a reply names its
request. What makes up for that:

* one request at a time, `gap_s` after the last byte; bytes that come unasked put the line in doubt;
* a fence closes every sequence: a number that counts up is written to a register where it has no consequence, and the
  reply to a write is the value; without such a register a value that no temperature has is read. The instrument answers
  in order, so if every request has had one reply, and the fence its own, none of them was an older one's;
* a line in doubt is listened to until it has been silent for `drain_s`, then a fence is sent until it comes back;
* a temperature is read twice between fences. Two readings within `SAME_K` count; otherwise three are made, of which two
  have to be within `AGREEMENT_K`, and the middle one counts. The sum misses 1 of some 16 random changes of two
  neighbouring digits; these change the value by a multiple of 0.15 K, more than `AGREEMENT_K`.

Residual: of single faults none. A fence that only reads a constant does not distinguish an old reply from a new one:
there `drain_s` has to outlast the longest delay. Of double faults (one reply lost, another doubled) a reading can be
one exchange older than its time says. A plate faster than 3 K/s moves by more than the agreement between two readings
at 9600 Bd, and is never read. At 9600 Bd an exchange takes 45 ms, a temperature or a setpoint three: a period of 0.5 s
is right.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from struct import Struct
from typing import Any, ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused, TimedOut
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import (
    OFF_S,
    STATUS_S,
    OwnField,
    OwnLimits,
    Status,
    TemperatureController,
    check_within,
    confirmed_off,
    packed,
    wait_for_status,
    wait_until_on,
)
from rig.drivers.in_step import RESYNCHRONISATIONS, SteppedLink, retry_once
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

REQUESTS = 3  # trials of a request that the instrument could not read
SHOUTS, SHOUT_S = 4, 0.015  # how often, and how far apart at least
DIGITS = frozenset(b"0123456789abcdef")
FIELDS = {4: Struct(">h"), 8: Struct(">i")}  # numbers by their digits
LONGEST_PAUSE_S = 60.0  # of silence on a line; the slowest of these controllers needs 2.5 s
TRIALS = 3  # of a temperature
GAIN_UNITS = 100  # of a repeat per minute, and of a minute
LARGEST_FIELD = 32767  # of 16 bits with a sign
AGREEMENT_K = 0.14  # two of three readings that count, see above
SAME_K = 0.02  # two readings that are the same but for noise
LOWEST_DEGC, HIGHEST_DEGC = -200.0, 600.0  # a reading beyond is an open sensor
MODEL_CODE = 9613  # a TC-48-20's answer to code 00
ALARMS = ("high", "low", "computer", "over-current", "input 1 open", "input 2 open", "driver supply low")
REMEDIES = {
    "high": "wait until the plate is below the high alarm",
    "low": "wait until the plate is above the low alarm",
    "over-current": "check the element and its cables for a short",
    "input 1 open": "check the thermometer and its cable",
    "driver supply low": "check the supply's voltage",
}
MAKES_TROUBLE = 0b1011111  # an open second input does not
Request = tuple[bytes, int | None]  # code and value; None reads
CONTROL_SENSOR: Request = (b"01", None)


@dataclass(frozen=True, slots=True)
class Model:
    """A controller: its name, line, frames, units of a degree, codes (empty: not known).

    digits: of the data. quiet: a write that comes first after doubt (its acknowledgement does not matter). fence_write:
    code of the register for a counting number. fence_read, fence_value: a code that reads a constant.
    """

    name: str
    line: LineSettings
    digits: int
    has_address: bool
    per_degC: int
    power_write: bytes
    power_read: bytes
    alarms: bytes
    fence_write: bytes = b""
    fence_read: bytes = b""
    fence_value: int = 0
    quiet: tuple[bytes, int] | None = None
    units: bytes = b""
    settings: tuple[tuple[bytes, bytes, int], ...] = ()  # write, read, value, at configuration
    limits: tuple[tuple[bytes, bytes], ...] = ()  # write and read of low and high alarm
    alarm_type: tuple[bytes, bytes] = (b"", b"")
    reset_latches: bytes = b""
    drain_s: float = 0.3


MODELS = {
    "tc-36-25": Model(
        "TC-36-25 RS232",
        LineSettings(baudrate=9600),
        digits=8,
        has_address=True,
        per_degC=100,
        power_write=b"2d",
        power_read=b"46",
        alarms=b"05",
        fence_write=b"25",
        quiet=(b"34", 0),
        units=b"4b",
        settings=((b"34", b"4c", 0), (b"29", b"42", 0), (b"2b", b"44", 1), (b"2e", b"47", 1)),
        limits=((b"24", b"58"), (b"23", b"57")),
        alarm_type=(b"28", b"41"),
        reset_latches=b"33",
    ),
    "tc-48-20": Model(
        "TC-48-20",
        LineSettings(baudrate=115200),
        digits=4,
        has_address=False,
        per_degC=10,
        power_write=b"30",
        power_read=b"64",
        alarms=b"03",
        fence_read=b"00",
        fence_value=MODEL_CODE,
        drain_s=2.5,
    ),
}


def model_of(name: object) -> Model:
    """Return the model of a name; ValueError if there is none."""
    if not isinstance(name, str) or name not in MODELS:
        raise ValueError(f"model {name!r}: one of {', '.join(sorted(MODELS))} is expected")
    return MODELS[name]


class TeLink(SteppedLink):
    """The line of one controller; see `SteppedLink`.

    gap_s: from the last byte of a reply to the next request. drain_s: of silence
    that brings a line in doubt to rest. answer_s: until a reply begins, beyond the time on the wire.
    """

    LARGEST_TOKEN = 9999

    def __init__(
        self,
        transport: Transport,
        model: Model,
        *,
        address: int = 0,
        byte_s: float,
        gap_s: float = 0.01,
        drain_s: float = 0.3,
        answer_s: float = 0.25,
        **options: Any,
    ) -> None:
        super().__init__(transport, byte_s=byte_s, **options)
        self._model = model
        self._address = b"%02x" % address if model.has_address else b""
        self._gap_s, self._drain_s = gap_s, drain_s
        self._patience_s = answer_s + (2 * model.digits + 12) * byte_s
        self._quiet_s = 0.0  # when the last byte came or went
        self.arrivals_s: list[float] = []  # of the requests of the last sequence, without its fence

    def sequence(self, *requests: Request, trials: int = RESYNCHRONISATIONS) -> list[int]:
        """Return the replies to some requests, proven by a fence behind them.

        A write whose reply is not its value is OutOfStep. TimedOut, Corrupt, OutOfStep, Disconnected.
        """
        transport = self.transport
        self.be_in_step(trials)
        self.in_doubt = True
        unasked = transport.stale_bytes
        replies, self.arrivals_s = [], []
        for code, value in requests:
            reply = self._ask(code, value)
            if value is not None and reply != value:
                raise OutOfStep(f"code {code.decode()} was set to {value}, and {reply} acknowledged")
            replies.append(reply)
            self.arrivals_s.append(self.arrived_s)
        expected, reply = self._fence()
        if reply != expected:
            raise OutOfStep(f"{reply} came back where {expected} was expected: replies are out of step")
        if transport.stale_bytes != unasked:
            raise OutOfStep("there were more replies than requests")
        self.in_doubt = False
        return replies

    def shout(self, code: bytes, value: int) -> None:
        """Send a write at once, whatever the line is doing, several times, and wait for no acknowledgement.

        A request that begins while the instrument still answers the one before is lost (the manual warns of sending too
        fast), hence the repetition, for longer than an exchange takes.
        """
        self.in_doubt = True
        clock = self.transport.clock
        frame = self._frame(code, value)
        for _ in range(SHOUTS):
            self.transport.send(frame)
            clock.sleep_until_s(clock.now_s() + max(len(frame) * self._byte_s, SHOUT_S))

    def answers(self) -> bool:
        """Return True if anything comes within the time of an answer, after `shout`; it stays unread."""
        clock = self.transport.clock
        give_up_s = clock.now_s() + self._patience_s
        while not self.transport.has_more:
            if clock.now_s() >= give_up_s:
                return False
            clock.sleep_until_s(clock.now_s() + SHOUT_S)
        return True

    def _prove(self, attempt: int) -> None:
        """Listen until the line is silent, then send a fence and wait until it comes back."""
        self._await_silence()
        if self._model.quiet is not None:
            self._ask(*self._model.quiet)
        self._await_fence()

    def _await_silence(self) -> None:
        transport = self.transport
        clock = transport.clock
        give_up_s = clock.now_s() + 10.0 * self._drain_s
        while True:
            clock.sleep_until_s(clock.now_s() + self._drain_s)
            if not transport.drain():
                return
            if clock.now_s() > give_up_s:
                raise OutOfStep("the line does not fall silent")

    def _await_fence(self) -> None:
        expected, reply = self._fence()
        for _ in range(32):
            if reply == expected:
                return
            try:
                data = self._receive(self.transport.clock.now_s() + self._patience_s)
            except TimedOut:
                break
            reply = _value(data)
        raise OutOfStep(f"{reply} came back where {expected} was expected: the line cannot be brought in step")

    def _fence(self) -> tuple[int, int]:
        """Send a fence, and return its expected and its actual reply."""
        model = self._model
        if not model.fence_write:
            return model.fence_value, self._ask(model.fence_read, None)
        self._token = self._token % self.LARGEST_TOKEN + 1
        return self._token, self._ask(model.fence_write, self._token)

    def _ask(self, code: bytes, value: int | None) -> int:
        """Send one request and return the next reply, whatever it answers."""
        transport = self.transport
        clock = transport.clock
        frame = self._frame(code, value)
        for _ in range(REQUESTS):
            clock.sleep_until_s(self._quiet_s + self._gap_s)
            transport.send(frame)
            sent_s = clock.now_s()
            self.arrived_s = sent_s + len(frame) * self._byte_s
            data = self._receive(sent_s + self._patience_s)
            if data.strip(b"X"):
                return _value(data)
        raise Corrupt(f"the instrument could not read {frame!r}")

    def _receive(self, deadline_s: float) -> bytes:
        """Return the next reply's data, X instead of digits if the instrument could not read the request."""
        try:
            line = self.transport.receive_line(b"^", deadline_s)
        finally:
            self._quiet_s = self.transport.clock.now_s()
        data = line[1:-2]
        if line[:1] == b"*" and len(data) == self._model.digits and b"%02x" % (sum(data) & 0xFF) == line[-2:]:
            return data
        raise Corrupt(f"{line!r} is no reply")

    def _frame(self, code: bytes, value: int | None) -> bytes:
        if value is None:
            data = b"0" * self._model.digits if self._model.has_address else b""
        else:
            data = packed(value, FIELDS[self._model.digits], f"code {code.decode()}").hex().encode()
        body = self._address + code + data
        return b"*%b%02x\r" % (body, sum(body) & 0xFF)


def _value(data: bytes) -> int:
    """Return a number in two's complement. Corrupt if it is no lower-case hexadecimal one."""
    if not DIGITS.issuperset(data):
        raise Corrupt(f"{data!r} is no number")
    value = int(data, 16)
    return value - (1 << 4 * len(data)) if data[0] >= 0x38 else value


class TeTechnologyController(TemperatureController):
    """See `rig.drivers.controller.TemperatureController`.

    model: "tc-36-25" or "tc-48-20". address: 0, or that of an RS-485 model. gap_s: from a reply to the next request
    (the manual advises a delay; not verified how long). drain_s: how long the line has to be silent after doubt.
    units: "degC" or "degF" where the model cannot be asked. alarm_type: None leaves the alarms as they are.
    bandwidth_K, integral_per_min, derivative_min: of its own regulation (1d, 1e, 1f), as `peltier tune` prints them;
    None leaves them as they are.
    """

    LINE: ClassVar[LineSettings] = MODELS["tc-36-25"].line
    ON_VISA: ClassVar[bool] = False  # its lines do not end in LF
    _regulates = True
    SEARCH: ClassVar[tuple[dict[str, Any], ...]] = tuple({"model": model, "drain_s": 0.1} for model in MODELS)
    confirms_off_by: ClassVar[str] = "its power switch read back; it shows no current"
    link: TeLink

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings | None = None,
        model: str = "tc-36-25",
        address: int = 0,
        gap_s: float = 0.01,
        drain_s: float | None = None,
        units: str | None = None,
        alarm_type: int | None = 2,
        power_read_code: str | None = None,
        bandwidth_K: float | None = None,
        integral_per_min: float | None = None,
        derivative_min: float | None = None,
        first_token: int | None = None,
    ) -> None:
        check_within(
            address=(address, 0, 255),
            gap_s=(gap_s, 0.0, LONGEST_PAUSE_S),
            drain_s=(drain_s, 0.0, LONGEST_PAUSE_S),
            alarm_type=(alarm_type, 0, 9),
        )
        if units not in (None, "degC", "degF"):
            raise ValueError(f"units {units!r}: 'degC' or 'degF' is expected")
        if power_read_code is not None and not re.fullmatch("[0-9a-z]{2}", power_read_code):
            raise ValueError(f"power_read_code {power_read_code!r}: two digits of a command are expected")
        self._model = table = model_of(model)
        self.NAME = f"a {table.name}"
        self.transport = transport
        self.link = TeLink(
            transport,
            table,
            address=address,
            byte_s=(table.line if line is None else line).byte_s,
            gap_s=gap_s,
            drain_s=table.drain_s if drain_s is None else drain_s,
            first_token=first_token,
            after_resynchronisation=self._check_after_doubt,
        )
        self._fahrenheit: bool | None = None if units is None else units == "degF"
        self._given_units = units is not None
        self._alarm_type = alarm_type
        self._power_read = table.power_read if power_read_code is None else power_read_code.encode("ascii")
        largest = LARGEST_FIELD / GAIN_UNITS
        check_within(
            bandwidth_K=(bandwidth_K, 1.0 / table.per_degC, LARGEST_FIELD / table.per_degC),
            integral_per_min=(integral_per_min, 0.0, largest),
            derivative_min=(derivative_min, 0.0, largest),
        )
        self._own_gains = bandwidth_K, integral_per_min, derivative_min

    @classmethod
    def line_for(cls, **options: object) -> LineSettings:
        """Return the line settings of the model that the options name; ValueError if there is none."""
        return model_of(options.get("model", "tc-36-25")).line

    @staticmethod
    def own_fields(options: Mapping[str, Any], kp: float, ti_s: float, td_s: float, limit: float) -> list[OwnField]:
        per_K = model_of(options.get("model", "tc-36-25")).per_degC
        band_K = max(round(limit / kp * per_K), 1) / per_K
        integral, derivative = round(60.0 / ti_s, 2) if ti_s > 0.0 else 0.0, td_s / 60.0
        return [
            OwnField("bandwidth_K", band_K, f"code 1d = {round(band_K * per_K)}", "K"),
            OwnField("integral_per_min", integral, f"code 1e = {round(100 * integral)}", "repeats/min"),
            OwnField("derivative_min", round(derivative, 2), f"code 1f = {round(100 * derivative)}", "min"),
        ]

    @staticmethod
    def own_pid(
        limit: float, bandwidth_K: float, integral_per_min: float, derivative_min: float
    ) -> tuple[float, float, float]:
        return limit / bandwidth_K, 60.0 / integral_per_min if integral_per_min else 0.0, derivative_min * 60.0

    @retry_once
    def identify(self) -> Identity:
        """Ask for the model number; a TC-36-25 has none, and its sensor type (43) has to be 0 to 5. Refused."""
        if self._model.fence_read:
            (number,) = self.link.sequence((self._model.fence_read, None))
            wrong = number != MODEL_CODE
        else:
            (number,) = self.link.sequence((b"43", None))
            wrong = not 0 <= number <= 5
        if wrong:
            raise Refused(None, f"the instrument answers {number}, and is no {self._model.name}")
        return Identity("TE Technology", self._model.name, "", "")

    @retry_once
    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Set output off, EEPROM off, own regulation by setpoints from here, alarms that shut down; read back each.

        Neither the current limit nor a dead man can be set.
        """
        model = self._model
        self._set(model.power_write, self._power_read, 0)
        for write, read, value in model.settings:
            self._set(write, read, value)
        self._learn_units()
        self._set_own_gains()
        if model.limits and self._alarm_type is not None:
            for (write, read), limit_degC in zip(model.limits, limits_degC, strict=True):
                self._set(write, read, self._fixed(limit_degC))
            self._set(*model.alarm_type, self._alarm_type)

    def _set_own_gains(self) -> None:
        """Set the gains that were given: proportional band in its own degrees, repeats per minute, minutes."""
        band_K, integral, derivative = self._own_gains
        if band_K is not None:
            self._set(b"1d", b"51", round(band_K * (1.8 if self._fahrenheit else 1.0) * self._model.per_degC))
        for write, read, gain in ((b"1e", b"52", integral), (b"1f", b"53", derivative)):
            if gain is not None:
                self._set(write, read, round(gain * GAIN_UNITS))

    def own_limits(self) -> OwnLimits:
        """Read low and high alarm (58, 57), if the model is known to have them."""
        if not self._model.limits or self._alarm_type is None:
            return OwnLimits()
        low, high = self.link.sequence(*((read, None) for _, read in self._model.limits))
        return OwnLimits(low_degC=self._degC(low), high_degC=self._degC(high))

    def _send(self, commands: str, value: float, arming: bool) -> None:
        self._set(b"1c", b"50", self._fixed(value))

    def _switch_on(self, commands: str) -> None:
        self._set(self._model.power_write, self._power_read, 1)
        wait_until_on(self.transport.clock, self.status)

    def read_temperature(self) -> Reading:
        """Read the control sensor (01), degC; `time_s` is that of the last of two requests, or the second of three."""
        for _ in range(TRIALS):
            first, second = self.link.sequence(CONTROL_SENSOR, CONTROL_SENSOR)
            time_s = self.link.arrivals_s[-1]
            self._learn_units()
            per_K = self._model.per_degC * (1.8 if self._fahrenheit else 1.0)
            if abs(first - second) <= SAME_K * per_K:
                return self._temperature(second, time_s)
            readings = sorted(self.link.sequence(CONTROL_SENSOR, CONTROL_SENSOR, CONTROL_SENSOR))
            time_s = self.link.arrivals_s[1]
            if min(readings[1] - readings[0], readings[2] - readings[1]) <= AGREEMENT_K * per_K:
                return self._temperature(readings[1], time_s)
        self.link.doubt()
        raise Corrupt(f"three readings one after the other are {readings}")

    def _temperature(self, fixed: int, time_s: float) -> Reading:
        value_degC = self._degC(fixed)
        quality = Quality.OK if LOWEST_DEGC <= value_degC <= HIGHEST_DEGC else Quality.INVALID
        return Reading(value_degC if quality is Quality.OK else nan, time_s, quality)

    def status(self) -> Status:
        """Read the alarms (05, on the TC-48-20 03) and whether power is on (46)."""
        alarms, power = self.link.sequence((self._model.alarms, None), (self._power_read, None))
        on = power == 1
        names = [name for bit, name in enumerate(ALARMS) if alarms >> bit & 1]
        text = ("on" if on else "off") + "".join(f", alarm: {name}" for name in names)
        code = alarms & MAKES_TROUBLE
        if not code:
            return Status(text, False, on)
        troubles = [name for name in names if code & 1 << ALARMS.index(name)]
        what_to_do = [REMEDIES[name] for name in troubles if name in REMEDIES]
        clears = "`peltier check CONFIG --clear` resets what latched"
        if not self._model.reset_latches:
            clears = "what latched is cleared by switching its supply off and on"
        meaning = f"alarm: {', '.join(troubles)}"
        return Status(text, True, on, code, meaning, "; ".join([*what_to_do, clears]))

    def clear_error(self) -> None:
        """Reset the latches (33). Refused if an alarm stays, or if no code for it is known (TC-48-20)."""
        if not self._model.reset_latches:
            super().clear_error()
        self.link.sequence((self._model.reset_latches, 1))
        status = wait_for_status(self.transport.clock, self.status, lambda status: not status.is_error)
        if status.is_error:
            raise Refused(status.code, f"resetting the latches did not clear it: {status.meaning}")

    def off(self) -> bool:
        """Switch power off, again and again; return True if it reads back off twice (46). Never raises.

        The manual knows no emergency stop. A line in doubt has to be drained before an answer proves anything: then it
        takes `drain_s` longer if the instrument answers.
        """
        self._armed = None
        ways = ((self._off_once, STATUS_S), (self._shout_off, OFF_S))
        return confirmed_off(self.transport, ways, self.link.doubt)

    def _off_once(self) -> bool:
        if self.link.in_doubt:
            return self._shout_off()
        return self._reads_off()

    def _shout_off(self) -> bool:
        self.link.shout(self._model.power_write, 0)
        if not self.link.answers():
            raise TimedOut(self.transport.named("no answer to a switch of its output"))
        return self._reads_off()

    def _reads_off(self) -> bool:
        off, read = (self._model.power_write, 0), (self._power_read, None)
        return self.link.sequence(off, read, read, trials=1)[1:] == [0, 0]

    def _set(self, write: bytes, read: bytes, value: int) -> None:
        _, read_back = self.link.sequence((write, value), (read, None))
        if read_back != value:
            raise Refused(
                None, f"{value} was written by code {write.decode()}, and code {read.decode()} reads {read_back}"
            )

    def _learn_units(self) -> None:
        if self._fahrenheit is not None:
            return
        if not self._model.units:
            raise Refused(None, f"a {self._model.name} does not report its working units: the option `units` is needed")
        (units,) = self.link.sequence((self._model.units, None))
        if units not in (0, 1):
            raise Refused(None, f"working units read {units}")
        self._fahrenheit = units == 0

    def _check_after_doubt(self) -> None:
        if self._model.units and not self._given_units:
            self._fahrenheit = None
        super()._check_after_doubt()

    def _is_on(self, _: str) -> bool:
        return self.link.sequence((self._power_read, None)) == [1]

    def _fixed(self, temperature_degC: float) -> int:
        self._learn_units()
        value = temperature_degC * 1.8 + 32.0 if self._fahrenheit else temperature_degC
        return round(value * self._model.per_degC)

    def _degC(self, fixed: int) -> float:
        self._learn_units()
        value = fixed / self._model.per_degC
        return (value - 32.0) / 1.8 if self._fahrenheit else value
