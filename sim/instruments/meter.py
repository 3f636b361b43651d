"""A SCPI meter on the instrument's side: settings, ranges, and readings that integrate.

Sources: IEEE 488.2-1992 chapter 10 (common commands), SCPI-1999 volume 2, 21 (SYSTem) and 24 (trigger model, one layer
of it). What differs from meter to meter (headers, defaults, ranges, texts of numbers) is in each meter's own file.

A reading integrates for its aperture and samples the film in the middle; `overhead_s` later it is there. With a
repeating filter it is the mean of several integrations, one after the other. With autorange a sample beyond `OVERRANGE`
or below `UNDERRANGE` of a resistance range is thrown away, and the next range measures again. Each resistance range has
its test current, of which the plant learns with every change. A voltage range only limits what is shown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import copysign, inf, isfinite, isinf, isnan
from typing import ClassVar, NamedTuple

from sim.instruments.instrument import Plant
from sim.instruments.scpi import (
    ILLEGAL_PARAMETER_VALUE,
    MISSING_PARAMETER,
    Handler,
    Parameters,
    ScpiError,
    ScpiInstrument,
    boolean,
    number,
    unquoted,
)

LINE_PERIOD_S = 1.0 / 50.0  # NPLC counts these
RESISTANCES, VOLTAGES = ("RES", "FRES"), ("VOLT", "VOLT:DC")  # functions that measure something of the plant
OVERFLOW, NOT_A_NUMBER = 9.9e37, 9.91e37  # SCPI's numbers for what is none


class Range(NamedTuple):
    """A resistance range: full scale, ohm, and its fixed test current, A."""

    full_scale_ohm: float
    test_current_A: float


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting that is only kept and answered: a number within its limits (text: its % format), or, with text "%s", a
    word. name: its key in `Meter.settings`; one that begins with `*` survives `*RST`."""

    header: str
    name: str
    default: float | str
    text: str = "%s"
    minimum: float = -inf
    maximum: float = inf

    def of(self, function: str, header: str) -> Setting:
        """Return the same setting of a measuring function, whose header stands in front."""
        return replace(self, header=header + self.header, name=f"{function}:{self.name}")

    def value(self, parameters: Parameters) -> float | str:
        if isinstance(self.default, str):
            if not parameters:
                raise ScpiError(*MISSING_PARAMETER)
            return ",".join(parameters).upper()
        if self.text == ON_OFF:
            return int(boolean(parameters))
        return number(parameters, self.minimum, self.maximum, self.default)


ON_OFF = "%.0f"  # text of a switch, 0 or 1
REGISTERS = (  # of the status system
    Setting("*ESE", "*ESE", 0, "%d", 0, 255),
    Setting("*SRE", "*SRE", 0, "%d", 0, 255),
    Setting(":STATus:MEASurement:ENABle", "*MEAS", 0, "%d", 0, 65535),
)


class Meter(ScpiInstrument):
    """A meter with `settings` by name, one `function` at a time.

    baudrate: of the line, 1/s, None: the meter's own; inf takes no time. command_s: from a message's end until it acts.
    overhead_s: from the end of an integration until its reading is there.

    RANGES: full scale, ohm -> test current, A, in rising order. FUNCTIONS: header of each by its name. SILENT: commands
    that do nothing here.
    """

    RANGES: ClassVar[Mapping[float, float]]
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
        self._ranges = [Range(*one) for one in self.RANGES.items()]
        self._range_index = min(1, len(self._ranges) - 1)
        self.settings: dict[str, float | str] = {}
        self.function = ""
        self.identity = self.IDENTITY
        for setting in self.SETTINGS:
            self._define_setting(setting)
        self._define_common()
        self._define_commands()
        self.reset()

    # ---- settings -------------------------------------------------------------------------------

    def default_settings(self) -> dict[str, float | str]:
        return {setting.name: setting.default for setting in self.SETTINGS}

    def reset(self) -> None:
        """Set everything to its value after power on; the error queue stays."""
        self.abort()
        self.settings = self.default_settings()
        self._range_index = min(1, len(self._ranges) - 1)

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

        self._tree.define(setting.header, set=change, ask=lambda _: setting.text % self.settings[setting.name])

    def _define_range(self, function: str, header: str, default: float, text: str, largest: float = 120e6) -> None:
        """RANGe of a function: of resistance and of voltage the meter takes the next range up; others are kept."""

        def change(parameters: Parameters) -> None:
            value = number(parameters, 0.0, largest, default)
            self.settings[f"{function}:RANG:AUTO"] = 0
            self.settings[f"{function}:RANG"] = self.voltage_range_V(value) if function in VOLTAGES else value
            if function in RESISTANCES:
                self.choose_range(value)

        def answer(_: Parameters) -> str:
            return text % (self.full_scale_ohm if function in RESISTANCES else self.settings[f"{function}:RANG"])

        self._tree.define(header + ":RANGe[:UPPer]", set=change, ask=answer)

    def _define_autozero(self, header: str) -> None:
        """Autozero: on, off, or ONCE, after which it is off."""

        def change(parameters: Parameters) -> None:
            once = len(parameters) == 1 and parameters[0].upper() == "ONCE"
            self.settings["AZER"] = 0 if once else int(boolean(parameters))

        self._tree.define(header, set=change, ask=lambda _: str(self.settings["AZER"]))

    def _function_named(self, name: str) -> str:
        """Return the function that a name spells; the name itself if there is none."""
        spelled = (function for function, header in self.FUNCTIONS.items() if self._tree.spells(name, header))
        return next(spelled, name)

    def _define_choice(self, header: str) -> None:

        def choose(parameters: Parameters) -> None:
            self.choose_function(self._function_named(unquoted(parameters)))

        self._tree.define(header, set=choose, ask=lambda _: f'"{self.function_text(self.function)}"')

    def function_text(self, function: str) -> str:
        return function

    def _define_common(self) -> frozenset[Handler]:
        """`*` commands, and the error queue. Return those that an instrument takes in any mode."""

        def reset(_: Parameters) -> None:
            registers = {name: value for name, value in self.settings.items() if name.startswith("*")}
            self.reset()
            self.settings |= registers

        def identity(_: Parameters) -> str:
            return self.identity

        def error(_: Parameters) -> str:
            return self.next_error()

        def clear(_: Parameters) -> None:
            self.errors.clear()

        define, sign = self._tree.define, self.SIGN
        for header in (*self.SILENT, "*OPC", "*WAI"):
            define(header, set=lambda _: None)
        define("*RST", set=reset)
        define("*IDN", ask=identity)
        define("*CLS", set=clear)
        define("*OPC", ask=lambda _: "1")
        define("*ESR", ask=lambda _: sign + "0")
        define("*TST", ask=lambda _: sign + "0")
        define("*STB", ask=lambda _: sign + ("4" if self.errors else "0"))
        define(":SYSTem:ERRor[:NEXT]", ask=error)
        return frozenset({identity, error, clear})

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
        return self._ranges[self._range_index].full_scale_ohm

    @property
    def test_current_A(self) -> float:
        """Return the current through the film now, A; it flows as long as a resistance function is chosen."""
        return self._ranges[self._range_index].test_current_A if self.measures_resistance else 0.0

    def send_test_current(self) -> None:
        """Let the plant know what flows through the film from now on."""
        self._plant.set_test_current_A(self.test_current_A)

    def choose_range(self, resistance_ohm: float) -> None:
        """Take the lowest range that still shows `resistance_ohm`."""
        shows = (
            index for index, one in enumerate(self._ranges) if resistance_ohm <= self.OVERRANGE * one.full_scale_ohm
        )
        self._use_range(next(shows, len(self._ranges) - 1))

    def _use_range(self, index: int) -> None:
        self._range_index = index
        self.send_test_current()

    def voltage_range_V(self, voltage_V: float) -> float:
        """Return the lowest voltage range that still shows `voltage_V`."""
        return next((full for full in self.VOLTAGE_RANGES_V if voltage_V <= full), self.VOLTAGE_RANGES_V[-1])

    def sample_ohm(self) -> float | None:
        """Return the film's resistance, ohm; +-inf beyond the range, nan for none; None if the range has changed."""
        now = self._ranges[self._range_index]
        value_ohm = self._plant.read_resistance_ohm(now.test_current_A)
        if isnan(value_ohm):
            return value_ohm
        over = abs(value_ohm) > self.OVERRANGE * now.full_scale_ohm
        if self.settings[self.function + ":RANG:AUTO"]:
            if over and value_ohm > 0.0 and self._range_index + 1 < len(self._ranges):
                self._use_range(self._range_index + 1)
                return None
            if abs(value_ohm) < self.UNDERRANGE * now.full_scale_ohm and self._range_index > 0:
                self._use_range(self._range_index - 1)
                return None
        return copysign(inf, value_ohm) if over else value_ohm

    def within_voltage_range(self, voltage_V: float, full_V: float, function: str) -> float:
        """Return the voltage, or +-inf if the function's range is fixed to `full_V` and does not show it."""
        over = not self.settings[function + ":RANG:AUTO"] and abs(voltage_V) > self.OVERRANGE * full_V
        return copysign(inf, voltage_V) if over else voltage_V

    # ---- measuring ------------------------------------------------------------------------------

    def shown(self, value: float) -> float:
        """Return a value as a number: beyond the range, and none, are numbers of SCPI's."""
        if isnan(value):
            return self.NOT_A_NUMBER
        return copysign(OVERFLOW, value) if isinf(value) else value

    def aperture_s(self) -> float:
        """Return how long a reading integrates, s: NPLC line periods."""
        return float(self.settings[self.function + ":NPLC"]) * LINE_PERIOD_S

    def averaged(self) -> int:
        """Return of how many integrations a reading is the mean."""
        return 1

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

    def initiate(self, count: int = 1) -> None:
        self.abort()
        self._remaining = count
        self._wanted = []
        self._integrate(self._now_s + float(self.settings.get("TRIG:DEL", 0.0)))

    def read(self, count: int) -> None:
        """Begin `count` readings and let the message wait for them, as `READ?` does."""
        self.initiate(count)
        self._waiting = True

    def fetch(self, fresh: bool = False) -> str | None:
        """Return the last reading, after those under way; fresh: one that was not given out before."""
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
        aperture_s = self.aperture_s()
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
        if 0 < len(self._stack) < self.averaged():
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
        self._work(time_s)

    def _finish(self) -> None:
        """Act on the end of all readings."""
