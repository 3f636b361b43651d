"""Lake Shore 335 and 336 temperature controllers: a heater output in current mode, and the sensor that goes with it.

Source: Model 335 and 336 user's manuals, chapter 6 (interface commands; status system, section 6.2.5) and chapter 4
(heater outputs); the line is that of their USB ports. Not verified on an instrument: that lines of 80 characters are
taken, that MOUT counts in percent of full power if the output shows power, how soon a setting reads back (it is asked
for until `SETTLE_S` is over), how many decimals TLIMIT keeps.

An output takes a drive and cannot cool: 1 is full power of its range, option `range` ("high", and a tenth and a
hundredth of that power). The heater's resistance and largest current (HTRSET) stay as they are set at the front panel,
unless `max_current_A` is given. For setpoints it uses the instrument's own PID; they are in the sensor's own units
(INTYPE), which are asked for. It has an upper temperature limit of its own (TLIMIT), which switches all outputs off,
and a ramp; no lower one, no current limit in these units, and no dead man.

A line asks its questions and ends in `*ESE?;*ESE m;*ESE?;*ESE n`, as in `rig.drivers.scpi` but with two tokens: the one
that the line before has left, and one of its own. Only the bits of the register that the instrument uses (OPC, QYE,
EXE, CME, PON) are sure to be kept, 31 numbers; the pair counts through 961. There is no error queue and no character
that aborts; `*ESR?` reports what was not understood, and an end of line closes what may lie half-sent. A reading is
asked for twice in one line, a token between and one behind, and counts if both are alike; settings are read back. The
instrument makes ten readings a second, so that one is up to 0.1 s older than its time says.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from itertools import product
from math import isfinite, nan
from typing import Any, ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import (
    CURRENTS,
    OF_FULL_DRIVE,
    OFF_S,
    SETPOINTS,
    OwnField,
    OwnLimits,
    Status,
    TemperatureController,
    check_within,
    confirmed_off,
    wait_until_on,
)
from rig.drivers.in_step import retry_once
from rig.drivers.scpi import ScpiLink
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

BITS = (1, 4, 16, 32, 128)  # of the event status enable register that are used
TOKENS = tuple(sorted(sum(bits) for bits in product(*((0, bit) for bit in BITS)) if any(bits)))
ERRORS = {4: "query error", 8: "device error", 16: "execution error", 32: "command error"}
KELVIN = 273.15  # 0 degC in K
RANGES = {"low": 1, "medium": 2, "high": 3}  # of the heater, as RANGE takes them
MODES = {0: "off", 1: "own regulation", 2: "zones", 3: "open loop", 4: "monitor", 5: "warm-up"}  # of OUTMODE
MODE_FOR = {SETPOINTS: 1, CURRENTS: 3}
KELVIN_UNITS, CELSIUS_UNITS = 1, 2  # of a sensor (INTYPE)
SHOWS_POWER = "2"
HEATER_ERRORS = {1: "heater open", 2: "heater shorted", 3: "heater compliance"}
READING_FAULTS = {1: "invalid", 16: "too cold", 32: "too hot", 64: "sensor at zero", 128: "sensor over range"}
# of MOUT, SETP and TLIMIT: what reads back within this was set
RESOLUTION_PERCENT, RESOLUTION_K, LIMIT_RESOLUTION_K = 0.011, 2e-3, 0.6
NO_OUTPUT_PERCENT = 0.1  # some show 0.005 % with the output off
SETTLE_S, AGAIN_S = 0.6, 0.05
SLOWEST_K_PER_MIN, FASTEST_K_PER_MIN = 0.1, 100.0  # of RAMP, by the manual
NUMBER = re.compile(r"[+-]?\d{1,6}(\.\d{0,6})?([eE][+-]?\d{1,2})?")


class LakeShoreLink(ScpiLink):
    """The line of one instrument; as `ScpiLink`."""

    TERMINATOR: ClassVar[bytes] = b"\r\n"
    END: ClassVar[bytes] = b"\n"
    ABORT: ClassVar[bytes] = b""
    ANSWER_S: ClassVar[float] = 0.3  # it takes commands every 50 ms, and another may be under way
    _left = b""

    def __init__(self, transport: Transport, **options: Any) -> None:
        super().__init__(transport, **options)
        self._count = self._token

    def is_token(self, text: str) -> bool:
        """Return True for the token that the line before has left, if a question asks for it in between."""
        return _is_number(text.strip().encode("latin-1"), self._left)

    def command(self, message: str) -> None:
        self._take_errors(self.ask(f"{message};*ESR?"))
        if self.errors:
            raise Refused(self.errors[0][0], f"{self.errors[0][1]}: {message}")

    def _next_token(self) -> int:
        self._count = (self._count + 1) % len(TOKENS) ** 2
        return TOKENS[self._count % len(TOKENS)]

    def _send(self, message: str, answer_s: float) -> None:
        self._left = b"%d" % self._token
        self._token = TOKENS[self._count // len(TOKENS) % len(TOKENS)]  # this line's own, which the answer ends with
        super()._send(f"{message};*ESE?;*ESE {self._token}", answer_s)

    def _receive_answer(self, deadline_s: float) -> bytes:
        rest, _, own = super()._receive_answer(deadline_s).rpartition(b";")
        answer, _, left = rest.rpartition(b";")
        if not _is_number(left, self._left):
            raise OutOfStep(f"the answer has token {left!r}, and the line before left {self._left!r}")
        return answer + b";" + own

    def _empty_error_queue(self) -> None:
        self._send("*ESR?", self._answer_s)
        self._take_errors(self.finish())

    def _take_errors(self, answer: str) -> None:
        text = answer.strip()
        if not (text.isascii() and text.isdigit()):
            self.doubt()
            raise Corrupt(f"{answer!r} is no event status register")
        self.errors = [(bit, name) for bit, name in ERRORS.items() if int(text) & bit]


def _is_number(text: bytes, expected: bytes) -> bool:
    """Return True if they are the same number; the instrument writes three digits."""
    return text.isascii() and text.isdigit() and int(text) == int(expected)


class LakeShoreController(TemperatureController):
    """See `rig.drivers.controller.TemperatureController`.

    input: of the sensor, "A" or "B" (336: to "D"). output: 1 or 2. range: "low", "medium" or "high". max_current_A: of
    the heater, A; None leaves it as it is set. p, i, d: of its own regulation (PID), as `peltier tune` prints them;
    given together, or left as they are.
    """

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=57600, bytesize=7, parity="O")
    NAME = "a Lake Shore 335 or 336"
    LARGEST_CURRENT: ClassVar[float] = 1.0
    drive_unit: ClassVar[str] = OF_FULL_DRIVE
    cools: ClassVar[bool] = False
    commands_current: ClassVar[bool] = True
    _regulates = True
    has_ramp: ClassVar[bool] = True
    confirms_off_by: ClassVar[str] = "its range read back twice, and the output that it shows"
    link: LakeShoreLink

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        input: str = "A",
        output: int = 1,
        range: str = "high",
        max_current_A: float | None = None,
        p: float | None = None,
        i: float | None = None,
        d: float | None = None,
        first_token: int | None = None,
    ) -> None:
        if input not in ("A", "B", "C", "D"):
            raise ValueError(f"input {input!r}: 'A' to 'D' is expected")
        if output not in (1, 2):
            raise ValueError(f"output {output!r}: 1 or 2 is expected")
        if range not in RANGES:
            raise ValueError(f"range {range!r}: one of {', '.join(RANGES)} is expected")
        if max_current_A is not None and not 0.0 < max_current_A <= 2.0:
            raise ValueError(f"max_current_A {max_current_A}: more than 0 and at most 2 is expected")
        self.transport = transport
        self.link = LakeShoreLink(
            transport, byte_s=line.byte_s, first_token=first_token, after_resynchronisation=self._check_after_doubt
        )
        self._input, self._output, self._range = input, output, RANGES[range]
        self._max_current_A, self._own_gains = max_current_A, [gain for gain in (p, i, d) if gain is not None]
        check_within(p=(p, 0.1, 1000.0), i=(i, 0.0, 1000.0), d=(d, 0.0, 200.0))  # of PID, by the manual
        if len(self._own_gains) in (1, 2):
            raise ValueError("p, i, d: expected all three, or none")
        self._kelvin: bool | None = None

    @staticmethod
    def own_fields(options: Mapping[str, Any], kp: float, ti_s: float, td_s: float, limit: float) -> list[OwnField]:
        p = min(round(100.0 * kp / limit, 1), 1000.0)
        i = min(round(1000.0 / ti_s, 1), 1000.0) if ti_s > 0.0 else 0.0
        d = round(100.0 * td_s, 1)
        command = f"PID {options.get('output', 1)},{p:g},{i:g},{d:g}"
        return [OwnField(name, value, command, "") for name, value in (("p", p), ("i", i), ("d", d))]

    @staticmethod
    def own_pid(limit: float, p: float, i: float, d: float) -> tuple[float, float, float]:
        return p * limit / 100.0, 1000.0 / i if i else 0.0, d / 100.0

    @retry_once
    def identify(self) -> Identity:
        """Ask `*IDN?`. Refused if it is no 335 or 336."""
        found = Identity.of_idn(self.link.ask_alone("*IDN?"))
        model, number = found.model, found.serial_number.partition("/")[0]
        if found.maker != "LSCI" or model not in ("MODEL335", "MODEL336"):
            raise Refused(None, f"{found.maker!r} {model!r} is no Lake Shore 335 or 336")
        return Identity("Lake Shore", model.removeprefix("MODEL"), number, found.firmware)

    @retry_once
    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Set output off, open loop at no drive, upper temperature limit; read back each.

        current_limit_A: the largest drive, at most 1. There is no dead man to be set.
        """
        self._set("RANGE", "0")
        self._configure_output()
        self._choose(CURRENTS)
        self._send(CURRENTS, 0.0, True)
        self._set_number("TLIMIT", self._input, limits_degC[1] + KELVIN, LIMIT_RESOLUTION_K)
        if self._own_gains:
            self._set("PID", ",".join(f"{gain:.1f}" for gain in self._own_gains))
        self._learn_units()

    def own_limits(self) -> OwnLimits:
        """Read TLIMIT and the ramp, each asked for twice."""
        limit_K = self._twice(f"TLIMIT? {self._input}")
        on, rate_K_per_min = (_number(text) for text in self.link.twice(f"RAMP? {self._output}")[0].split(","))
        high_degC = limit_K - KELVIN if limit_K > 0.0 else nan
        return OwnLimits(high_degC=high_degC, ramp_K_per_s=rate_K_per_min / 60.0 if on else 0.0)

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Set RAMP, 0.1 to 100 K/min, 0 for as fast as it can; read back. ValueError for another rate."""
        rate = 60.0 * ramp_K_per_s
        if ramp_K_per_s != 0.0 and not SLOWEST_K_PER_MIN <= rate <= FASTEST_K_PER_MIN:
            raise ValueError(f"a ramp of {ramp_K_per_s} K/s: 0, or {0.1 / 60:.4f} to {100 / 60:.3f} is expected")
        on = int(ramp_K_per_s > 0.0)
        text = f"{rate if on else SLOWEST_K_PER_MIN:.2f}"
        self.link.command(f"RAMP {self._output},{on},{text}")
        found = [_number(part) for part in self.link.twice(f"RAMP? {self._output}")[0].split(",")]
        if len(found) != 2 or found[0] != on or abs(found[1] - float(text)) > 0.06:
            raise Refused(None, f"RAMP was set to {on},{text} and reads {found}")

    def read_temperature(self) -> Reading:
        """Read the sensor (CRDG, RDGST), degC; `time_s` is when the question had arrived."""
        value_degC, fault = (_number(text) for text in self.link.twice(f"CRDG? {self._input}", f"RDGST? {self._input}"))
        good = fault == 0.0 and isfinite(value_degC)
        return Reading(value_degC if good else nan, self.link.arrived_s, Quality.OK if good else Quality.INVALID)

    def read_current(self) -> Reading:
        """Read the drive of the output (HTR), 0 to 1 of full power of the range."""
        value = self._twice(f"HTR? {self._output}") / 100.0
        return Reading(value, self.link.arrived_s, Quality.OK if isfinite(value) else Quality.INVALID)

    def status(self) -> Status:
        """Read range and mode of the output, errors of its heater, and faults of the sensor."""
        output = self._output
        range_text, mode_text, heater_text, sensor_text = self.link.twice(
            f"RANGE? {output}", f"OUTMODE? {output}", f"HTRST? {output}", f"RDGST? {self._input}"
        )
        heater, sensor = int(_whole(heater_text)), int(_whole(sensor_text))
        in_range, mode = int(_whole(range_text)), int(_whole(mode_text.partition(",")[0]))
        words = [next((name for name, code in RANGES.items() if code == in_range), "off"), MODES.get(mode, "?")]
        if heater:
            words.append(f"error: {HEATER_ERRORS.get(heater, heater)}")
        words += [f"sensor: {name}" for bit, name in READING_FAULTS.items() if sensor & bit]
        return Status(", ".join(words), bool(heater or sensor), in_range > 0, heater or sensor)

    def off(self) -> bool:
        """Set RANGE 0, again and again; return True if range and output (HTR) read back off. Never raises."""
        self._armed = None
        return confirmed_off(self.transport, ((self._off_once, OFF_S),), self.link.doubt)

    def _off_once(self) -> bool:
        """Switch off and look, without asking why if no answer comes: time matters."""
        command = f"RANGE {self._output},0"
        if self.link.in_doubt:
            self.link.shout(command)
        self.link.start(f"{command};RANGE? {self._output};RANGE? {self._output};HTR? {self._output}", trials=1)
        first, again, percent = self.link.finish().split(";")
        return first == again and _whole(first) == 0.0 and abs(_number(percent)) <= NO_OUTPUT_PERCENT

    # ---- settings -------------------------------------------------------------------------------

    def _configure_output(self) -> None:
        """Let the output show power; the heater's resistance and largest current stay, or are as the options say."""
        fields = [text.strip() for text in self.link.twice(f"HTRSET? {self._output}")[0].split(",")]
        if len(fields) not in (4, 5):  # the 335 has the output's type in front
            raise Refused(None, f"HTRSET reads {fields}")
        fields[-1] = SHOWS_POWER
        if self._max_current_A is not None:
            fields[-3], fields[-2] = "0", f"{self._max_current_A:.3f}"
        self.link.command(f"HTRSET {self._output},{','.join(fields)}")
        found = self.link.twice(f"HTRSET? {self._output}")[0].split(",")
        if [_number(text) for text in found] != [_number(text) for text in fields]:
            raise Refused(None, f"HTRSET was set to {fields} and reads {found}")

    def _choose(self, commands: str) -> None:
        """Choose open loop, or the instrument's own regulation with the sensor's units."""
        if commands == SETPOINTS:
            self._learn_units()
        self._set("OUTMODE", f"{MODE_FOR[commands]},{'ABCD'.index(self._input) + 1},0")  # 0: off after a power cycle

    def _send(self, commands: str, value: float, arming: bool) -> None:
        """Set MOUT, % of full power of the range, or SETP, read back."""
        if commands == CURRENTS:
            self._set_number("MOUT", str(self._output), 100.0 * value, RESOLUTION_PERCENT)
        else:
            self._set_number("SETP", str(self._output), value + KELVIN if self._kelvin else value, RESOLUTION_K)

    def _switch_on(self, commands: str) -> None:
        self._set("RANGE", str(self._range))
        wait_until_on(self.transport.clock, self.status)

    def _set(self, name: str, value: str) -> None:
        """Set a setting of the output in whole numbers, read back. Refused."""
        wanted = [float(part) for part in value.split(",")]
        self._set_and_wait(
            f"{name} {self._output},{value}",
            f"{name}? {self._output}",
            lambda text: [_number(part) for part in text.split(",")] == wanted,
        )

    def _set_number(self, name: str, of: str, value: float, resolution: float) -> None:
        self._set_and_wait(
            f"{name} {of},{value:.3f}", f"{name}? {of}", lambda text: abs(_number(text) - value) <= resolution
        )

    def _set_and_wait(self, command: str, question: str, is_it: Callable[[str], bool]) -> None:
        """Set and read back in one line, and read back again until it is so. Refused if the time is over."""
        clock = self.transport.clock
        (text,) = self.link.answers(f"{command};{question}", 1)
        give_up_s = clock.now_s() + SETTLE_S
        while not is_it(text):
            if clock.now_s() > give_up_s:
                self.link.command(command)
                raise Refused(None, f"{command} was set, and {question} reads {text}")
            clock.sleep_until_s(clock.now_s() + AGAIN_S)
            (text,) = self.link.answers(question, 1)

    def _learn_units(self) -> None:
        """Ask for the units of the sensor, in which setpoints count. Refused for those that are no temperatures."""
        units = _number(self.link.twice(f"INTYPE? {self._input}")[0].rpartition(",")[2])
        if units not in (KELVIN_UNITS, CELSIUS_UNITS):
            raise Refused(None, f"input {self._input} counts in the sensor's units; kelvin or degC is expected")
        self._kelvin = units == KELVIN_UNITS

    # ---- questions ------------------------------------------------------------------------------

    def _twice(self, question: str) -> float:
        return _number(self.link.twice(question)[0])

    def _is_on(self, commands: str) -> bool:
        in_range, mode = self.link.answers(f"RANGE? {self._output};OUTMODE? {self._output}", 2)
        return _number(in_range) == self._range and _number(mode.partition(",")[0]) == MODE_FOR[commands]


def _number(text: str) -> float:
    """Return the number in a text; nan if it is none."""
    text = text.strip()
    return float(text) if text.isascii() and NUMBER.fullmatch(text) else nan


def _whole(text: str) -> float:
    """Return the whole number in a text. Corrupt if it is none."""
    value = _number(text)
    if not value.is_integer():
        raise Corrupt(f"{text!r} is no whole number")
    return value
