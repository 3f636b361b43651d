"""SCPI on the instrument's side: messages taken apart into calls, answers put on the line, an error queue; and a meter
with its table of commands, its ranges, and readings that integrate.

Sources: IEEE 488.2-1992 chapters 7, 8 and 10, SCPI-1999 volume 1 (syntax and style) and volume 2, 21 (SYSTem, error
queue) and 24 (trigger model, one layer of it). What differs from meter to meter stands in each meter's own file.

Keywords come in their long or short form and in any case, some are optional. `;` separates the units of a message; a
unit with a leading colon counts from the root, another from where the unit before it ended, and if it is not found
there, from the root, as lenient instruments do. `*` commands belong to no path.

A pattern is written as in the manuals: "[:SENSe#]:FRESistance:RANGe[:UPPer]"; capitals are the short form, brackets
enclose optional keywords, `#` allows the suffix 1.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import copysign, inf, isfinite, isinf, isnan
from typing import ClassVar

from sim.instruments.instrument import Instrument, Plant

SET, ASK = "", "?"
OUTSIDE_QUOTES = """(?=(?:[^"']|"[^"]*"|'[^']*')*$)"""  # what follows a separator that no quotes enclose


class ScpiError(Exception):
    """An entry of an instrument's error queue: a number and its text."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f'{code},"{text}"')
        self.code = code
        self.text = text


UNDEFINED_HEADER = (-113, "Undefined header")
MISSING_PARAMETER = (-109, "Missing parameter")
DATA_OUT_OF_RANGE = (-222, "Parameter data out of range")
INVALID_CHARACTER_DATA = (-141, "Invalid character data")
NUMERIC_DATA_ERROR = (-120, "Numeric data error")
ILLEGAL_PARAMETER_VALUE = (-224, "Illegal parameter value")

Parameters = tuple[str, ...]
Handler = Callable[[Parameters], str | None]
Call = partial[str | None]  # a unit of a message: its command's handler with the parameters


def _undefined(_: Parameters) -> str | None:
    raise ScpiError(*UNDEFINED_HEADER)


class CommandTree:
    """All commands of an instrument."""

    def __init__(self) -> None:
        self._handlers: dict[tuple[tuple[str, ...], str], Handler] = {}
        self._short: dict[str, str] = {}
        self._parsed: dict[str, tuple[Call, ...]] = {}

    def define(self, pattern: str, *, set: Handler | None = None, ask: Handler | None = None) -> None:
        """Add a command in its two forms, `HEADER parameters` and `HEADER?`."""
        for path in self._paths(pattern):
            for form, handler in ((SET, set), (ASK, ask)):
                if handler is not None:
                    self._handlers[path, form] = handler

    def _paths(self, pattern: str) -> list[tuple[str, ...]]:
        choices: list[list[tuple[str, ...]]] = []
        for piece in pattern.replace("[", " [").replace("]", "] ").split():
            optional = piece.startswith("[")
            nodes = tuple(self._node(node) for node in piece.strip("[]").split(":") if node)
            choices.append([nodes, ()] if optional else [nodes])
        return [tuple(node for nodes in combination for node in nodes) for combination in product(*choices)]

    def _node(self, node: str) -> str:
        word = node.rstrip("#")
        long = word.upper()
        short = "".join(character for character in word if not character.islower())
        for suffix in ("", "1") if node.endswith("#") else ("",):
            self._short[short + suffix] = self._short[long + suffix] = short
        return short

    def spells(self, text: str, pattern: str) -> bool:
        """Return True if `text` is a way to write the keywords of `pattern`, which has been defined before."""
        words = tuple(self._short.get(word, word) for word in text.strip().upper().strip(":").split(":"))
        return words in self._paths(pattern)

    def parse(self, message: str) -> tuple[Call, ...]:
        """Return the units of a message without its terminator; cache them."""
        calls = self._parsed.get(message)
        if calls is None:
            if len(self._parsed) > 2048:
                self._parsed.clear()
            calls = self._parsed[message] = tuple(self._calls(message))
        return calls

    def _calls(self, message: str) -> list[Call]:
        calls: list[Call] = []
        path: tuple[str, ...] = ()
        for unit in split_outside_quotes(message, ";"):
            unit = unit.strip()
            if not unit:
                continue
            header, _, rest = unit.partition(" ")
            parameters = tuple(part.strip() for part in split_outside_quotes(rest, ",")) if rest.strip() else ()
            form = ASK if header.endswith("?") else SET
            header = header.rstrip("?").upper()
            if header.lstrip(":").startswith("*"):
                calls.append(partial(self._handlers.get(((header.lstrip(":"),), form), _undefined), parameters))
                continue
            words = tuple(self._short.get(word, word) for word in header.lstrip(":").split(":"))
            relative = words if header.startswith(":") else (*path, *words)
            where = relative if (relative, form) in self._handlers else words
            path = where[:-1]
            calls.append(partial(self._handlers.get((where, form), _undefined), parameters))
        return calls


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """Split `text` at each separator outside double and single quotes."""
    return re.split(separator + OUTSIDE_QUOTES, text) if '"' in text or "'" in text else text.split(separator)


def number(parameters: Parameters, minimum: float, maximum: float, default: float) -> float:
    """Return the one numeric parameter, within its limits; MINimum, MAXimum and DEFault are words for numbers."""
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    try:
        value = float(parameters[0])
    except ValueError:
        words = {"MIN": minimum, "MAX": maximum, "DEF": default}
        words |= {"MINIMUM": minimum, "MAXIMUM": maximum, "DEFAULT": default}
        word = parameters[0].upper()
        if word not in words:
            raise ScpiError(*NUMERIC_DATA_ERROR) from None
        value = words[word]
    if not minimum <= value <= maximum:
        raise ScpiError(*DATA_OUT_OF_RANGE)
    return value


def boolean(parameters: Parameters) -> bool:
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0].upper()
    return word == "ON" if word in ("ON", "OFF") else number(parameters, -1e9, 1e9, 0.0) != 0.0


def unquoted(parameters: Parameters) -> str:
    """Return the first parameter, a word within double or single quotes."""
    if not parameters:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0]
    if len(word) < 2 or word[0] not in "\"'" or word[-1] != word[0]:
        raise ScpiError(*INVALID_CHARACTER_DATA)
    return word[1:-1]


class ScpiInstrument(Instrument):
    """An instrument that takes messages in turn; its commands are in `_tree`.

    A message acts `command_s` after its terminator has arrived; messages wait while one of them waits for a
    measurement. The class attributes say which characters abort, how the error queue speaks, and whether an error drops
    the rest of its message.
    """

    ABORTS: ClassVar[tuple[bytes, ...]] = (b"\x03", b"\x18")
    QUEUE_LENGTH: ClassVar[int] = 10
    QUEUE_OVERFLOW: ClassVar[str] = '350,"Queue Overflow"'
    NO_ERROR: ClassVar[str] = '0,"No error"'
    DROPS_REST: ClassVar[bool] = True

    def __init__(self, plant: Plant, *, byte_s: float, terminator: bytes, command_s: float, start_s: float) -> None:
        super().__init__(plant, byte_s=byte_s, start_s=start_s)
        self._terminator = terminator
        self._command_s = command_s
        self._messages: deque[tuple[float, str]] = deque()
        self._calls: deque[Call] = deque()  # of the message at work
        self._answers: list[str] = []
        self._waiting = False  # for a measurement
        self._free_s = start_s
        self._ready_s = start_s
        self._tree = CommandTree()
        self.errors: deque[str] = deque()

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. A character that aborts discards all that is under way."""
        for character in self.ABORTS:
            if character in data:
                self._clear_device()
                data = data[data.rfind(character) + 1 :]
        super().receive(data, time_s)

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        if line:
            self._messages.append((arrival_s + self._command_s, line.decode("latin-1")))
            self._plant.schedule(arrival_s + self._command_s, self._work)

    def _next_reply_s(self) -> float | None:
        if self._waiting:
            return self._ready_s
        if self._calls:
            return self._free_s
        return self._messages[0][0] if self._messages else None

    def _clear_device(self) -> None:
        self._partial = b""
        for waiting in (self._messages, self._replies, self._calls, self._answers):
            waiting.clear()
        self.abort()
        self._free_s = self._sending_until_s = self._receiving_until_s = -inf

    def abort(self) -> None:
        """Return to idle, without a reading."""
        self._waiting = False

    # ---- messages -------------------------------------------------------------------------------

    def _work(self, time_s: float) -> None:
        """Go on with what has arrived, as far as it can be done at `time_s`."""
        self._now_s = time_s
        while not self._waiting:
            if time_s < self._free_s:
                if self._calls or self._messages:
                    self._plant.schedule(self._free_s, self._work)
                return
            if self._calls:
                self._run(self._calls.popleft())
            elif self._messages and self._messages[0][0] <= time_s:
                self._calls.extend(self._tree.parse(self._messages.popleft()[1]))
            else:
                return
            if not (self._calls or self._waiting):
                self._reply(time_s)

    def _run(self, call: Call) -> None:
        try:
            answer = call()
        except ScpiError as error:
            self.push_error(str(error))
            if self.DROPS_REST:
                self._calls.clear()
            return
        if answer is not None:
            self._answers.append(answer)

    def _reply(self, time_s: float) -> None:
        if self._answers:
            self._send(";".join(self._answers).encode("latin-1") + self._terminator, time_s)
            self._answers.clear()

    # ---- errors ---------------------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        """Append to the error queue; an entry that no longer fits turns the last one into an overflow."""
        if len(self.errors) < self.QUEUE_LENGTH:
            self.errors.append(text)
        else:
            self.errors[-1] = self.QUEUE_OVERFLOW

    def next_error(self) -> str:
        """Return the oldest entry of the error queue and remove it."""
        return self.errors.popleft() if self.errors else self.NO_ERROR


# ---- meters -----------------------------------------------------------------------------------------

LINE_PERIOD_S = 1.0 / 50.0  # NPLC counts these
RESISTANCES, VOLTAGES = ("RES", "FRES"), ("VOLT", "VOLT:DC")  # functions that measure something of the plant
OVERFLOW, NOT_A_NUMBER = 9.9e37, 9.91e37  # SCPI's numbers for what is none
ON_OFF = "%.0f"  # text of a switch, 0 or 1


@dataclass(frozen=True, slots=True)
class Setting:
    """A row of a meter's command table: a value that is set, kept and answered.

    name: its key in `Meter.settings`; one that begins with `*` survives `*RST`. text: a number's % format; `ON_OFF` of
    a switch, which ONCE leaves off; "%s" of a word, one of `words` if there are any (capitals are the short form).
    """

    header: str
    name: str
    default: float | str
    text: str = "%s"
    minimum: float = -inf
    maximum: float = inf
    words: tuple[str, ...] = ()

    def of(self, function: str, header: str) -> Setting:
        """Return the same setting of a measuring function, whose header stands in front."""
        return replace(self, header=header + self.header, name=f"{function}:{self.name}")

    def value(self, parameters: Parameters) -> float | str:
        if self.text == ON_OFF:
            return 0 if parameters == ("ONCE",) else int(boolean(parameters))
        if not isinstance(self.default, str):
            return number(parameters, self.minimum, self.maximum, self.default)
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        given = ",".join(parameters).upper()
        short = {spelled: _short(word) for word in self.words for spelled in (_short(word), word.upper())}
        if short and given not in short:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        return short.get(given, given)


def _short(word: str) -> str:
    return "".join(character for character in word if not character.islower())


REGISTERS = (  # of the status system
    Setting("*ESE", "*ESE", 0, "%d", 0, 255),
    Setting("*SRE", "*SRE", 0, "%d", 0, 255),
    Setting(":STATus:MEASurement:ENABle", "*MEAS", 0, "%d", 0, 65535),
)


class Meter(ScpiInstrument):
    """A meter with `settings` by name, one `function` at a time.

    A reading integrates for its aperture and samples the film in the middle; `overhead_s` later it is there. With a
    repeating filter it is the mean of several integrations, one after the other. With autorange a sample beyond
    `OVERRANGE` or below `UNDERRANGE` of a resistance range is thrown away, and the next range measures again. Each
    resistance range has its test current, of which the plant learns with every change. A voltage range only limits what
    is shown.

    baudrate: of the line, 1/s, None: the meter's own; inf takes no time. command_s: from a message's end until it acts.
    overhead_s: from the end of an integration until its reading is there.

    RANGES: full scale, ohm -> test current, A, in rising order. FUNCTIONS: header of each by its name. SETTINGS: the
    command table. SILENT: commands that do nothing here. NO_READING: the error of FETCh without a reading; None if one
    is then made.
    """

    RANGES: ClassVar[Mapping[float, float]]
    FIRST_RANGE_OHM: ClassVar[float] = 1e3  # after power on
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.1, 1.0, 10.0, 100.0, 1000.0)
    FUNCTIONS: ClassVar[Mapping[str, str]]
    SETTINGS: ClassVar[Sequence[Setting]]
    SILENT: ClassVar[Sequence[str]]
    IDENTITY: ClassVar[str]
    BAUDRATE: ClassVar[float]
    BITS_PER_CHARACTER: ClassVar[float] = 10.0
    TERMINATOR: ClassVar[bytes] = b"\n"
    OVERRANGE: ClassVar[float] = 1.2
    UNDERRANGE: ClassVar[float] = 0.1
    SIGN: ClassVar[str] = ""  # before the number of a status register
    NOT_A_NUMBER: ClassVar[float] = NOT_A_NUMBER
    NO_READING: ClassVar[tuple[int, str] | None] = None

    def __init__(
        self,
        plant: Plant,
        *,
        baudrate: float | None = None,
        command_s: float = 0.002,
        overhead_s: float = 0.004,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(
            plant,
            byte_s=self.BITS_PER_CHARACTER / (self.BAUDRATE if baudrate is None else baudrate),
            terminator=self.TERMINATOR,
            command_s=command_s,
            start_s=start_s,
        )
        self._overhead_s = overhead_s
        self._sample_s = inf
        self._remaining = 0  # readings that are still to be made
        self._wanted: list[str] = []
        self._stack: list[float] = []  # of the filter: the integrations of this reading
        self._last, self._fresh = "", False
        self._keep = True  # this reading is kept for FETCh
        self._full_scales = list(self.RANGES)
        self._range_index = 0
        self.settings: dict[str, float | str] = {}
        self.function = ""
        self.identity = self.IDENTITY
        for setting in self.SETTINGS:
            self._define_setting(setting)
        self._define_common()
        self._define_commands()
        self.reset()

    # ---- settings -------------------------------------------------------------------------------

    def reset(self) -> None:
        """Set everything to its value after power on; the error queue stays."""
        self.abort()
        self._last = ""
        self.settings = {setting.name: setting.default for setting in self.SETTINGS}
        self._range_index = self._full_scales.index(self.FIRST_RANGE_OHM)

    def changed(self, name: str) -> None:
        """Act on a setting that was changed. A range is fixed, to the next one up that the meter has."""
        function, _, what = name.rpartition(":")
        if what == "RANG" and function in self.FUNCTIONS:
            self.settings[name + ":AUTO"] = 0
            if function in VOLTAGES:
                self.settings[name] = self.voltage_range_V(float(self.settings[name]))
            elif function in RESISTANCES:
                self.choose_range(float(self.settings[name]))
        self.send_test_current()

    def of_function(self, name: str, otherwise: float) -> float:
        """Return a setting that the measuring function has, or the meter has for all."""
        return float(self.settings.get(f"{self.function}:{name}", self.settings.get(name, otherwise)))

    def choose_function(self, function: str) -> None:
        """Measure something else; the test current flows in the resistance functions only."""
        if function not in self.FUNCTIONS:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        self.function = function
        self.send_test_current()

    def _define(self, header: str, act: Callable[[], object]) -> None:
        """Define a command that takes no parameter and gives no answer."""

        def do(_: Parameters) -> None:
            act()

        self._tree.define(header, set=do)

    def _define_setting(self, setting: Setting) -> None:
        def change(parameters: Parameters) -> None:
            self.settings[setting.name] = setting.value(parameters)
            self.changed(setting.name)

        self._tree.define(setting.header, set=change, ask=lambda _: setting.text % self.settings[setting.name])

    def _function_named(self, name: str) -> str:
        """Return the function that a name spells; the name itself if there is none."""
        spelled = (function for function, header in self.FUNCTIONS.items() if self._tree.spells(name, header))
        return next(spelled, name)

    def _define_measuring(self, count: Callable[[], int], keep: bool = True) -> None:
        """Define READ, FETCh, INITiate and ABORt. count: of the readings that a trigger makes; keep: of READ's, too."""
        self._tree.define(":READ", ask=lambda _: self.read(count(), keep))
        self._tree.define(":FETCh", ask=lambda _: self.fetch())
        self._define(":INITiate[:IMMediate]", lambda: self.initiate(count()))
        self._define(":ABORt", self.abort)

    def _define_choice(self, header: str) -> None:
        def choose(parameters: Parameters) -> None:
            self.choose_function(self._function_named(unquoted(parameters)))

        self._tree.define(header, set=choose, ask=lambda _: f'"{self.function_text(self.function)}"')

    def function_text(self, function: str) -> str:
        return function

    def _define_common(self) -> None:
        """Define the `*` commands, and the error queue."""

        def reset() -> None:
            registers = {name: value for name, value in self.settings.items() if name.startswith("*")}
            self.reset()
            self.settings |= registers

        define, sign = self._tree.define, self.SIGN
        for header in (*self.SILENT, "*OPC", "*WAI"):
            define(header, set=lambda _: None)
        self._define("*RST", reset)
        self._define("*CLS", self.errors.clear)
        define("*IDN", ask=lambda _: self.identity)
        define("*OPC", ask=lambda _: "1")
        define("*ESR", ask=lambda _: sign + "0")
        define("*TST", ask=lambda _: sign + "0")
        define("*STB", ask=lambda _: sign + ("4" if self.errors else "0"))
        define(":SYSTem:ERRor[:NEXT]", ask=lambda _: self.next_error())

    def _define_commands(self) -> None:
        """Define the commands that only this meter has."""
        raise NotImplementedError

    # ---- ranges ---------------------------------------------------------------------------------

    @property
    def measures_resistance(self) -> bool:
        """Return True if a resistance function is chosen."""
        return self.function in RESISTANCES

    @property
    def full_scale_ohm(self) -> float:
        return self._full_scales[self._range_index]

    @property
    def test_current_A(self) -> float:
        """Return the current through the film now, A; it flows as long as a resistance function is chosen."""
        return self.RANGES[self.full_scale_ohm] if self.measures_resistance else 0.0

    def send_test_current(self) -> None:
        """Let the plant know what flows through the film from now on."""
        self._plant.set_test_current_A(self.test_current_A)

    def choose_range(self, resistance_ohm: float) -> None:
        """Take the lowest range that still shows `resistance_ohm`."""
        shows = (k for k, full_ohm in enumerate(self._full_scales) if resistance_ohm <= self.OVERRANGE * full_ohm)
        self._use_range(next(shows, len(self._full_scales) - 1))

    def _use_range(self, index: int) -> None:
        self._range_index = index
        self.settings |= {f"{function}:RANG": self.full_scale_ohm for function in RESISTANCES}
        self.send_test_current()

    def voltage_range_V(self, voltage_V: float) -> float:
        """Return the lowest voltage range that still shows `voltage_V`."""
        return next((full for full in self.VOLTAGE_RANGES_V if abs(voltage_V) <= full), self.VOLTAGE_RANGES_V[-1])

    def sample_ohm(self) -> float | None:
        """Return the film's resistance, ohm; +-inf beyond the range, nan for none; None if the range has changed."""
        full_ohm = self.full_scale_ohm
        value_ohm = self._plant.read_resistance_ohm(self.RANGES[full_ohm])
        if isnan(value_ohm):
            return value_ohm
        over = abs(value_ohm) > self.OVERRANGE * full_ohm
        if self.settings[self.function + ":RANG:AUTO"]:
            if over and value_ohm > 0.0 and self._range_index + 1 < len(self._full_scales):
                self._use_range(self._range_index + 1)
                return None
            if abs(value_ohm) < self.UNDERRANGE * full_ohm and self._range_index > 0:
                self._use_range(self._range_index - 1)
                return None
        return copysign(inf, value_ohm) if over else value_ohm

    def within_voltage_range(self, voltage_V: float, function: str) -> float:
        """Return the voltage, or +-inf if the function's range, the largest with autorange, does not show it."""
        automatic = self.settings[function + ":RANG:AUTO"]
        full_V = self.VOLTAGE_RANGES_V[-1] if automatic else float(self.settings[function + ":RANG"])
        return copysign(inf, voltage_V) if abs(voltage_V) > self.OVERRANGE * full_V else voltage_V

    # ---- measuring ------------------------------------------------------------------------------

    def shown(self, value: float) -> float:
        """Return a value as a number: beyond the range, and none, are numbers of SCPI's."""
        if isnan(value):
            return self.NOT_A_NUMBER
        return copysign(OVERFLOW, value) if isinf(value) else value

    def digitize(self) -> str:
        """Measure now and return the text; empty if the range has changed and it has to measure again."""
        raise NotImplementedError

    def filtered(self, value: float) -> float:
        """Return the mean of this reading's integrations so far, this one included; beyond the range if one was."""
        self._stack.append(value)
        return next((each for each in self._stack if not isfinite(each)), sum(self._stack) / len(self._stack))

    @property
    def measuring(self) -> bool:
        return self._remaining > 0

    def initiate(self, count: int = 1, keep: bool = True) -> None:
        """Begin `count` readings. keep: FETCh gets them."""
        self.abort()
        self._last, self._keep = "", keep
        self._remaining = count
        self._wanted = []
        self._integrate(self._now_s + float(self.settings.get("TRIG:DEL", 0.0)))

    def read(self, count: int, keep: bool = True) -> None:
        """Begin `count` readings and let the message wait for them, as `READ?` does."""
        self.initiate(count, keep)
        self._waiting = True

    def fetch(self, fresh: bool = False) -> str | None:
        """Return the last reading, after those under way; fresh: one that was not given out before."""
        if not (self.measuring or self._last) and self.NO_READING is not None:
            raise ScpiError(*self.NO_READING)
        if self.measuring or (fresh and not self._fresh) or not self._last:
            if not self.measuring:
                self.initiate()
            self._waiting = True
            return None
        self._fresh = False
        return self._last

    def abort(self) -> None:
        """Return to idle, without a reading."""
        super().abort()
        self._remaining = 0
        self._sample_s = inf

    def _integrate(self, begin_s: float) -> None:
        self._stack = []
        self._integrate_once(begin_s)

    def _integrate_once(self, begin_s: float) -> None:
        aperture_s = self.of_function("NPLC", 1.0) * LINE_PERIOD_S
        self._sample_s = begin_s + 0.5 * aperture_s
        self._ready_s = begin_s + aperture_s + self._overhead_s
        self._plant.schedule(self._sample_s, self._sample)

    def _sample(self, time_s: float) -> None:
        if time_s < self._sample_s:  # of a measurement that was aborted
            return
        self._sample_s = inf
        text = self.digitize()
        if not text:
            self._integrate(self._ready_s)
            return
        if 0 < len(self._stack) < (self.of_function("AVER:COUN", 1) if self.of_function("AVER", 0) else 1):
            self._integrate_once(self._ready_s)
            return
        self._wanted.append(text)
        self._remaining -= 1
        if self._remaining:
            self._integrate(self._ready_s + float(self.settings.get("TRIG:DEL", 0.0)))
            return
        self._last, self._fresh = ",".join(self._wanted), True
        self._free_s = self._ready_s
        self._finish()
        if self._waiting:
            self._waiting = self._fresh = False
            self._answers.append(self._last)
            if not self._calls:
                self._reply(self._ready_s)
        if not self._keep:
            self._last = ""
        self._work(time_s)

    def _finish(self) -> None:
        """Act on the end of all readings."""
