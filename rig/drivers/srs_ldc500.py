"""SRS LDC501, the temperature controller in it, on its RS-232 port.

Sources: LDC500 series manual, remote chapter p. 4-10 (lines, 64-byte input buffer, TERM), 4-16, 4-37, 4-38 (LCME,
LEXE), 4-47, 4-54. Not verified on an instrument: the sign of the current that heats (`heating_sign`: check with a small
pulse), `*ESE`, how a number is written, TIGN and TDGN (their names, and that TIGN is 1/s of the proportional gain).

A line asks its questions and ends in `*ESE?;*ESE n`, as in `rig.drivers.scpi`, within 64 bytes. Answers may come one by
one or joined with `;`, and with any terminator: as many are awaited as there are questions, the token the last. An
instrument with no terminator, or CR alone, is set to CR and LF (only if it does not answer otherwise, as it keeps
TERM). A line end closes what may lie half-sent in the buffer. Errors are asked for after a pause, because the
instrument takes some milliseconds to log them.

A reading is asked for twice in one line, with a token between and one behind, and counts if both are alike; a setting
is read back in the line that sets it. One garbled on its way acts until the read-back has shown it, some 50 ms at 9600
Bd; the instrument's own limits (TILM, TMIN, TMAX) hold meanwhile. It has no dead man. At 9600 Bd a temperature takes 63
ms and a current 58 ms: with both, a period of 0.2 s is right.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping
from math import isfinite, nan
from typing import Any, ClassVar

from rig.core.errors import Corrupt, InstrumentError, Refused
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import (
    CURRENTS,
    OFF_S,
    SETPOINTS,
    STATUS_S,
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

LONGEST_LINE = 64  # bytes of its input buffer
LOGGED_S = 0.02  # until an error can be asked for
COMMAND_ERRORS = {
    1: "illegal command",
    2: "undefined command",
    3: "illegal query",
    4: "illegal set",
    5: "missing parameter",
    6: "extra parameter",
    7: "null parameter",
    8: "input buffer overflow",
    9: "bad number",
    10: "bad integer",
    11: "bad token",
    12: "bad token value",
    13: "bad hexadecimal",
    14: "unknown token",
}
MODES = {CURRENTS: 0, SETPOINTS: 1}  # of TMOD: constant current, constant temperature
WORDS = {"OFF": 0, "ON": 1, "CC": 0, "CT": 1}
RESOLUTION_A, RESOLUTION_K = 2e-3, 2e-3  # a setting that reads back within this is the one that was set
NO_OUTPUT_A = 0.05  # a current-measurement offset is no output
OFF_ANSWER_S = 0.1  # until an answer to "off" begins, beyond the time on the wire
NUMBER = re.compile(r"[+-]?\d{1,6}(\.\d{0,9})?([eE][+-]?\d{1,2})?")


class SrsLink(ScpiLink):
    """The line of one instrument; as `ScpiLink`."""

    END: ClassVar[bytes] = b"\n"
    ABORT: ClassVar[bytes] = b""
    ANSWER_S: ClassVar[float] = 0.3  # it takes commands one by one, some 10 ms each
    _questions = 1

    def command(self, message: str) -> None:
        self.ask(message)
        self.check(message)

    def check(self, message: str) -> None:
        """Ask for errors, when they have been logged, and raise Refused for `message`."""
        clock = self.transport.clock
        clock.sleep_until_s(clock.now_s() + LOGGED_S)
        execution, _, command = self.ask("LEXE?;LCME?").partition(";")
        try:
            execution_code, command_code = int(execution), int(command)
        except ValueError:
            self.doubt()
            raise Corrupt(f"{execution!r} and {command!r} are no error numbers") from None
        if command_code:
            raise Refused(command_code, f"{COMMAND_ERRORS.get(command_code, 'command error')}: {message}")
        if execution_code:
            raise Refused(execution_code, f"execution error: {message}")

    def _empty_error_queue(self) -> None:
        self._send("LEXE?;LCME?", self._answer_s)
        self.finish()

    def _send(self, message: str, answer_s: float) -> None:
        if len(message) + len(";*ESE?;*ESE 255\n") > LONGEST_LINE:
            raise ValueError(f"{message!r} does not fit into the instrument's {LONGEST_LINE} bytes")
        self._questions = message.count("?") + 1
        super()._send(message, answer_s)

    def _receive_answer(self, deadline_s: float) -> bytes:
        answers = b""
        while True:
            line = self.transport.receive_line(b"\n", deadline_s).strip()
            if line:
                answers = answers + b";" + line if answers else line
                if answers.count(b";") + 1 >= self._questions:
                    return answers

    def _has_unasked(self) -> bool:
        return self.transport.has_more and bool(self.transport.drain().strip())

    def _prove(self, attempt: int) -> None:
        self.WAKE = b"TERM 3" if attempt else b""
        super()._prove(attempt)


class SrsLdc500Controller(TemperatureController):
    """See `rig.drivers.controller.TemperatureController`.

    line: settings that the port was opened with. heating_sign: +1 if positive current heats as the element is wired,
    -1 if it cools. p_A_per_K, i_per_s, d_s: of its own regulation (TPGN, TIGN, TDGN), as `peltier tune` prints them;
    None leaves them as they are.
    """

    NAME = "an LDC500 series controller"
    LINE: ClassVar[LineSettings] = LineSettings(baudrate=9600)
    LARGEST_CURRENT: ClassVar[float] = 4.5
    commands_current: ClassVar[bool] = True
    _regulates = True
    confirms_off_by: ClassVar[str] = "its switch read back twice, and the current that it measures"
    link: SrsLink

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        heating_sign: int = 1,
        p_A_per_K: float | None = None,
        i_per_s: float | None = None,
        d_s: float | None = None,
        first_token: int | None = None,
    ) -> None:
        if heating_sign not in (1, -1):
            raise ValueError(f"heating sign {heating_sign}: 1 or -1 is expected")
        self.transport = transport
        self.link = SrsLink(
            transport, byte_s=line.byte_s, first_token=first_token, after_resynchronisation=self._check_after_doubt
        )
        self._heating_sign = heating_sign
        check_within(p_A_per_K=(p_A_per_K, -1e3, 1e3), i_per_s=(i_per_s, 0.0, 1e3), d_s=(d_s, 0.0, 1e3))
        self._own_gains = {"TPGN": p_A_per_K, "TIGN": i_per_s, "TDGN": d_s}

    @staticmethod
    def own_fields(_: Mapping[str, Any], kp_A_per_K: float, ti_s: float, td_s: float, __: float) -> list[OwnField]:
        values = (
            ("p_A_per_K", -round(kp_A_per_K, 4), "TPGN", "A/K"),  # negative regulates, as the manual says
            ("i_per_s", round(1.0 / ti_s, 4) if ti_s > 0.0 else 0.0, "TIGN", "1/s"),
            ("d_s", round(td_s, 4), "TDGN", "s"),
        )
        return [OwnField(name, value, f"{command} {value:g}", unit) for name, value, command, unit in values]

    @staticmethod
    def own_pid(_: float, p_A_per_K: float, i_per_s: float, d_s: float) -> tuple[float, float, float]:
        return abs(p_A_per_K), 1.0 / i_per_s if i_per_s else 0.0, d_s

    @retry_once
    def identify(self) -> Identity:
        """Ask `*IDN?`. Refused if it is no LDC501 (or 500, 502, which have the same temperature controller)."""
        found = Identity.of_idn(self.link.ask_alone("*IDN?"))
        if "STANFORD" not in found.maker.upper() or not found.model.startswith("LDC50"):
            raise Refused(None, f"{found.maker!r} {found.model!r} is no LDC500 series controller")
        number, firmware = found.serial_number.removeprefix("s/n"), found.firmware.removeprefix("ver")
        return Identity("SRS", found.model, number, firmware)

    @retry_once
    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Set output off, current mode at 0 A, TILM, TMIN, TMAX; read back each. There is no dead man to be set."""
        self._set("TEON", 0)
        self._set("TMOD", MODES[CURRENTS])
        self._set("TCUR", 0.0)
        self._set("TILM", current_limit_A, RESOLUTION_A)
        self._set("TMIN", limits_degC[0], RESOLUTION_K)
        self._set("TMAX", limits_degC[1], RESOLUTION_K)
        for name, gain in self._own_gains.items():
            if gain is not None:
                self._set(name, gain, 1e-3 * max(abs(gain), 1.0))

    def own_limits(self) -> OwnLimits:
        """Read TILM, TMIN and TMAX, each asked for twice."""
        return OwnLimits(*(self._read_twice(name) for name in ("TILM", "TMIN", "TMAX")))

    def read_temperature(self) -> Reading:
        """Read the temperature (TTRD), degC; `time_s` is when the question had arrived."""
        value_degC = self._read_twice("TTRD")
        quality = Quality.OK if -273.15 <= value_degC <= 1000.0 else Quality.INVALID
        return Reading(value_degC, self.link.arrived_s, quality)

    def read_current(self) -> Reading:
        """Read the current that flows (TIRD), A, positive heats by `heating_sign`."""
        value_A = self._heating_sign * self._read_twice("TIRD")
        return Reading(value_A, self.link.arrived_s, Quality.OK if isfinite(value_A) else Quality.INVALID)

    def status(self) -> Status:
        """Read output and mode (TEON, TMOD), and errors since they were last asked for (LEXE, LCME)."""
        on_text, mode_text, execution, command = self.link.answers("TEON?;TMOD?;LEXE?;LCME?", 4)
        on, mode = _number(on_text), _number(mode_text)
        if not all(text.isascii() and text.strip().isdigit() for text in (execution, command)):
            self.link.doubt()
            raise Corrupt(f"{execution!r} and {command!r} are no error numbers")
        codes = [code for code in (int(execution), int(command)) if code]
        words = f"{'on' if on else 'off'}, {'own regulation' if mode == MODES[SETPOINTS] else 'current'}"
        if not codes:
            return Status(words, False, on == 1)
        meaning = COMMAND_ERRORS.get(int(command), "command error") if int(command) else "execution error"
        remedy = "the instrument forgot it when it was read; if it comes again, another program speaks on the line"
        return Status(f"{words}, error {codes[0]}: {meaning}", True, on == 1, codes[0], meaning, remedy)

    def clear_error(self) -> None:
        """Read the error (LEXE, LCME), which the instrument forgets then. Refused if there is a new one."""
        self.status()
        status = self.status()
        if status.is_error:
            raise Refused(status.code, f"reading it did not clear it: {status.meaning}")

    def off(self) -> bool:
        """Set TEON 0; then TEON 0 and 0 A (TMOD CC, TCUR 0). Never raises. The manual knows no emergency stop.

        Return True if TEON and the current that flows read back off.
        """
        self._armed = None
        ways = ((self._plainly_off, STATUS_S), (self._off_and_zero, OFF_S))
        return confirmed_off(self.transport, ways, self.link.doubt)

    def _plainly_off(self) -> bool:
        if self.link.in_doubt:
            with contextlib.suppress(InstrumentError):
                self.link.shout("TEON 0")
        return self._reads_off()

    def _off_and_zero(self) -> bool:
        with contextlib.suppress(InstrumentError):
            self.link.shout("TEON 0;TMOD 0;TCUR 0")
            self.link.shout("TERM 3")  # it may have been set to end its answers otherwise
        return self._reads_off()

    def _reads_off(self) -> bool:
        self.link.start("TEON 0;TEON?;TEON?;TIRD?", OFF_ANSWER_S, trials=1)
        on, again, current_A = self.link.finish().split(";")
        return on == again and _number(on) == 0.0 and abs(_number(current_A)) <= NO_OUTPUT_A

    def _choose(self, commands: str) -> None:
        self._set("TMOD", MODES[commands])

    def _send(self, commands: str, value: float, arming: bool) -> None:
        name, resolution = ("TCUR", RESOLUTION_A) if commands == CURRENTS else ("TEMP", RESOLUTION_K)
        value = self._heating_sign * value if commands == CURRENTS else value
        (self._set if arming else self._set_fast)(name, value, resolution)

    def _switch_on(self, commands: str) -> None:
        self._set("TEON", 1)
        wait_until_on(self.transport.clock, self.status)

    def _set(self, name: str, value: float, resolution: float = 0.0) -> None:
        self._set_fast(name, value, resolution)
        self.link.check(f"{name} {value:g}")

    def _set_fast(self, name: str, value: float, resolution: float = 0.0) -> None:
        """Set and read back in one line; ask for errors only if it reads back wrong."""
        text = f"{value:.4f}" if resolution else f"{value:g}"
        (read_back,) = self.link.answers(f"{name} {text};{name}?", 1)
        if not abs(_number(read_back) - value) <= resolution:
            self.link.check(f"{name} {text}")
            raise Refused(None, f"{name} was set to {text} and reads {read_back}")

    def _read_twice(self, name: str) -> float:
        return _number(self.link.twice(f"{name}?")[0])

    def _is_on(self, commands: str) -> bool:
        on, mode = (_number(text) for text in self.link.answers("TEON?;TMOD?", 2))
        return on == 1 and mode == MODES[commands]


def _number(text: str) -> float:
    """Return a number, or a token's word as a number; nan if it is neither."""
    text = text.strip()
    if text in WORDS:
        return float(WORDS[text])
    return float(text) if NUMBER.fullmatch(text) else nan
