"""SRS LDC501, the temperature controller in it; the laser half is not emulated.

Sources: LDC500 series manual, remote chapter p. 4-10 (lines, 64-byte input buffer, TERM), 4-16, 4-37, 4-38 (LCME),
4-47, 4-54; behaviour seen on hardware from PyMeasure's tests of it.

A line acts when its terminator (CR or LF) has arrived; its answers reach the host after the response time and their own
length, each with the terminator that TERM has chosen. Commands are four letters with a value or a question mark. Not
verified, and assumed here: the factory's TERM (CR and LF) and TOKN (numbers); that the answers of one line come one by
one (`joined` gives one line with `;` instead), as in other instruments of this maker; `*ESE`; the numbers of execution
errors; the text of a number (6 digits); TIGN and TDGN (1/s, s); that an open sensor turns the output off; that one
line's questions see one conversion of the sensor; limits other than those of TILM and TVLM.

A limit that is lowered drags the current setpoint along; changing the mode is bumpless; a setpoint outside TMIN and
TMAX is rejected. A negative TPGN regulates, a positive one runs away.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable
from math import copysign, isfinite, isnan, nan

from sim.instruments.instrument import Instrument, Plant, Regulator, Ticking

LONGEST_INPUT, LONGEST_OUTPUT = 64, 256  # bytes of its buffers
TERMINATORS = (b"", b"\r", b"\n", b"\r\n", b"\n\r")
INPUT_ERROR, QUERY_ERROR, EXECUTION_ERROR, COMMAND_ERROR = 2, 4, 16, 32  # bits of the event status register
RESPONSE_S = 0.003  # from a line's end to its first answer
LOAD_OHM = 2.0  # of the element
CURRENT_MODE = 0  # of TMOD
# command errors, LCME (p. 4-38)
ILLEGAL, UNDEFINED, ILLEGAL_QUERY, ILLEGAL_SET, MISSING, EXTRA, NULL, BUFFER_OVERFLOW, BAD_FLOAT = range(1, 10)
BAD_INTEGER, BAD_TOKEN, BAD_TOKEN_VALUE, BAD_HEXADECIMAL, UNKNOWN_TOKEN = range(10, 15)  # the same
OUT_OF_RANGE = 1  # execution error, LEXE: number not verified

SWITCH = ("OFF", "ON")
# mnemonic -> its words, by number
TOKENS: dict[str, tuple[str, ...]] = {
    "TERM": ("NONE", "CR", "LF", "CRLF", "LFCR"),
    "TOKN": SWITCH,
    "TEON": SWITCH,
    "TMOD": ("CC", "CT"),
    "TSNR": ("NTC10UA", "NTC100UA", "NTC1MA", "NTCAUTO", "RTD", "LM335", "AD590"),
}
# mnemonic -> default, limits
NUMBERS: dict[str, tuple[float, float, float]] = {
    "TEMP": (25.0, -273.15, 250.0),
    "TMIN": (-50.0, -273.15, 250.0),
    "TMAX": (150.0, -273.15, 250.0),
    "TCUR": (0.0, -4.5, 4.5),
    "TILM": (4.5, -4.5, 4.5),
    "TVLM": (8.5, -8.5, 8.5),
    "TPGN": (-1.0, -1000.0, 1000.0),
    "TIGN": (0.03, 0.0, 1000.0),
    "TDGN": (0.0, 0.0, 1000.0),
    "TRTH": (10.0, 0.0, 1000.0),
    "TRMN": (0.1, 0.0, 1000.0),
    "TRMX": (300.0, 0.0, 1000.0),
    "*ESE": (0, 0, 255),
}
WHOLE = ("*ESE",)  # numbers without a fraction
PLAIN_COMMANDS = ("*CLS", "*OPC", "*WAI")
UNIT = re.compile(r"(\*[A-Z]{3}|[A-Z]{4})(\?)?(.*)")


class CommandError(Exception):
    """A command error, by its number; LCME asks for it."""

    LOG, BIT = "LCME", COMMAND_ERROR


class ExecutionError(CommandError):
    """An execution error, by its number; LEXE asks for it."""

    LOG, BIT = "LEXE", EXECUTION_ERROR


class SrsLdc500(Instrument, Ticking):
    """One controller.

    baudrate: of the line, 1/s; inf takes no time. error_s: until an error can be asked for. heating_sign: +1 if
    positive current heats as it is wired.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        baudrate: float = 9600.0,
        error_s: float = 0.01,
        joined: bool = False,
        heating_sign: int = 1,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, byte_s=10.0 / baudrate, start_s=start_s)
        self.identity = "Stanford Research Systems,LDC501,s/n098023,ver2.00"
        self.values: dict[str, float] = {name: default for name, (default, _, _) in NUMBERS.items()}
        self.values |= dict.fromkeys(TOKENS, 0.0) | {"TERM": 3.0, "TSNR": 3.0}  # TERM 3: CR and LF
        self._error_s, self._joined, self._heating_sign = error_s, joined, heating_sign
        self._lines: deque[tuple[bytes, float]] = deque()
        self._errors = {"LCME": (0, start_s), "LEXE": (0, start_s)}  # the last one's number, and when it is logged
        self.event_status = 0
        self._regulator = Regulator()
        self.output_A = 0.0
        self._conversion_s, self._conversion_degC = nan, nan
        self._questions: dict[str, Callable[[], str]] = {
            "*IDN": lambda: self.identity,
            "*ESR": self._take_event_status,
            "*OPC": lambda: "1",
            "*STB": lambda: "0",
            "LCME": lambda: self._take_error("LCME"),
            "LEXE": lambda: self._take_error("LEXE"),
            "TTRD": lambda: number_text(self.temperature_degC()),
            "TRAW": lambda: "10",
            "TIRD": lambda: number_text(self.output_A),
            "TVRD": lambda: number_text(self.output_A * LOAD_OHM),
        }
        self._special: dict[str, Callable[[float], None]] = {
            "TMOD": lambda value: self.change_mode(value),
            "TILM": lambda value: self.change_current_limit(value),
            "TEON": lambda value: self.switch(value),
        }
        self._start_ticking(start_s)

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. More than 64 bytes that wait discard all of them."""
        super().receive(data, time_s)
        if len(self._partial) > LONGEST_INPUT:
            self._overflow()
            self._partial = b""

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        if len(line) + 1 > LONGEST_INPUT:
            self._overflow()
        elif line:
            self._lines.append((line, arrival_s))
            self._plant.schedule(arrival_s, self._act)

    def _overflow(self) -> None:
        self.event_status |= INPUT_ERROR
        self._errors["LCME"] = (BUFFER_OVERFLOW, self._now_s)

    def _next_reply_s(self) -> float | None:
        return self._lines[0][1] + RESPONSE_S if self._lines else None

    def _act(self, time_s: float) -> None:
        line = self._lines.popleft()[0]
        self._now_s = time_s
        texts: list[str] = []
        for unit in line.decode("latin-1").split(";"):
            try:
                answer = self._obey("".join(unit.split()).upper())  # white space is ignored
                texts += [] if answer is None else [answer]
            except CommandError as error:
                self._errors[error.LOG] = (error.args[0], time_s + self._error_s)
                self.event_status |= error.BIT
        if not texts:
            return
        end = TERMINATORS[int(self.values["TERM"])]
        data = b"".join(text.encode("latin-1") + end for text in ([";".join(texts)] if self._joined else texts))
        if len(data) > LONGEST_OUTPUT:
            self.event_status |= QUERY_ERROR
            return
        self._send(data, time_s + RESPONSE_S)

    # ---- commands -------------------------------------------------------------------------------

    def _obey(self, text: str) -> str | None:
        """Do one command of a line; return its answer if it is a question."""
        if not text:
            return None
        parsed = UNIT.fullmatch(text)
        if parsed is None:
            raise CommandError(ILLEGAL)
        name, question, rest = parsed.groups()
        if question:
            if name not in self._questions and name not in self.values:
                raise CommandError(ILLEGAL_QUERY if name in PLAIN_COMMANDS else UNDEFINED)
            if rest:
                raise CommandError(EXTRA)
            return self._questions[name]() if name in self._questions else self._value_text(name)
        if name in PLAIN_COMMANDS:
            if rest:
                raise CommandError(EXTRA)
            if name == "*CLS":
                self._clear()
        elif name not in self.values:
            raise CommandError(ILLEGAL_SET if name in self._questions else UNDEFINED)
        else:
            self._set(name, rest)
        return None

    def _value_text(self, name: str) -> str:
        value = self.values[name]
        return TOKENS[name][int(value)] if name in TOKENS and self.values["TOKN"] else number_text(value)

    def _set(self, name: str, text: str) -> None:
        if not text:
            raise CommandError(MISSING)
        if "," in text:
            raise CommandError(EXTRA)
        values = self.values
        if name in TOKENS:
            value = float(_token(text, TOKENS[name]))
        else:
            value = _number(text, int if name in WHOLE else float, *NUMBERS[name][1:])
        if name == "TEMP" and not values["TMIN"] <= value <= values["TMAX"]:
            raise ExecutionError(OUT_OF_RANGE)
        if name == "TCUR" and abs(value) > values["TILM"]:
            raise ExecutionError(OUT_OF_RANGE)
        if name in self._special:
            self._special[name](value)
            return
        values[name] = value
        if name in ("TCUR", "TVLM", "TPGN"):
            self.drive()

    # ---- errors ---------------------------------------------------------------------------------

    def _clear(self) -> None:
        self.event_status = 0
        for name in self._errors:
            self._take_error(name)

    def _take_event_status(self) -> str:
        status, self.event_status = self.event_status, 0
        return str(status)

    def _take_error(self, name: str) -> str:
        """Return the last error that has been logged by now and forget it, as `LCME?` and `LEXE?` do."""
        code, logged_s = self._errors[name]
        if logged_s > self._now_s:
            return "0"
        self._errors[name] = (0, self._now_s)
        return str(code)

    # ---- what is measured -----------------------------------------------------------------------

    def temperature_degC(self) -> float:
        """Return the sensor's temperature, degC; questions of one line see one conversion."""
        if self._conversion_s != self._now_s:
            self._conversion_s, self._conversion_degC = self._now_s, self._plant.read_temperature_degC()
        return self._conversion_degC

    # ---- output ---------------------------------------------------------------------------------

    def change_mode(self, mode: float) -> None:
        """Change TMOD; the setpoint of the new mode is what is measured now."""
        if mode == self.values["TMOD"]:
            return
        if mode == CURRENT_MODE:
            self.values["TCUR"] = self.output_A
        else:
            measured_degC = self.temperature_degC()
            if not isnan(measured_degC):
                self.values["TEMP"] = min(self.values["TMAX"], max(self.values["TMIN"], measured_degC))
            self._regulator.start()
        self.values["TMOD"] = mode
        self.drive()

    def change_current_limit(self, limit_A: float) -> None:
        """Change TILM; the current setpoint is dragged along."""
        self.values["TILM"] = abs(limit_A)
        if abs(self.values["TCUR"]) > abs(limit_A):
            self.values["TCUR"] = copysign(limit_A, self.values["TCUR"])
        self.drive()

    def switch(self, on: float) -> None:
        self.values["TEON"] = on
        self._regulator.start()
        self.drive()

    def drive(self) -> None:
        values, current_A = self.values, 0.0
        limit_A = min(values["TILM"], abs(values["TVLM"]) / LOAD_OHM)
        if values["TEON"]:
            if values["TMOD"] == CURRENT_MODE:
                current_A = values["TCUR"]
            else:
                regulates = 1.0 if values["TPGN"] < 0.0 else -1.0
                current_A = regulates * self._heating_sign * self._regulator.output_percent / 100.0 * values["TILM"]
        current_A = min(limit_A, max(-limit_A, current_A))
        if current_A != self.output_A:
            self.output_A = current_A
            self._plant.set_current_A(self._heating_sign * current_A)

    def _control(self) -> None:
        values = self.values
        if not values["TEON"] or values["TMOD"] == CURRENT_MODE:
            return
        temperature_degC = self.temperature_degC()
        if isnan(temperature_degC):
            self.switch(0)
            return
        self._regulator.step(
            values["TEMP"],
            temperature_degC,
            gain_percent_per_K=100.0 * abs(values["TPGN"]) / max(values["TILM"], 1e-3),
            integral_time_s=1.0 / values["TIGN"] if values["TIGN"] > 0.0 else 0.0,
            derivative_time_s=values["TDGN"],
        )
        self.drive()


def number_text(value: float) -> str:
    """Return a number as the instrument writes it (6 digits: not verified)."""
    return "%.6g" % value  # noqa: UP031 - half the time of an f-string


def _number(text: str, kind: type[int] | type[float], minimum: float, maximum: float) -> float:
    try:
        value = float(kind(text))
    except ValueError:
        value = nan
    if not isfinite(value):
        raise CommandError(BAD_INTEGER if kind is int else BAD_FLOAT)
    if not minimum <= value <= maximum:
        raise ExecutionError(OUT_OF_RANGE)
    return value


def _token(text: str, words: tuple[str, ...]) -> int:
    if text in words:
        return words.index(text)
    if not (text.isascii() and text.isdigit()):
        raise CommandError(UNKNOWN_TOKEN)
    if int(text) >= len(words):
        raise CommandError(BAD_TOKEN_VALUE)
    return int(text)
