"""Keithley 2450 SourceMeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Source: Model 2450 reference manual 2450-901-01, section 6 (SCPI commands) and appendix B; the command set as PyMeasure
and QCoDeS use it. NOT verified on an instrument: overhead times, test currents (those of the 2400), its answer with
the output off (here: nothing, and an error).

One function is measured at a time. In the ohms function the range sets the test current; otherwise the source does. A
reading's elements are named in the question; a number has as many digits as `:FORMat:ASCii:PRECision` says. Errors have
a kind and a date behind their text, with semicolons between.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, inf, isinf, isnan
from typing import ClassVar

from sim.instruments.keithley2400 import RANGES
from sim.instruments.keithley2450_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.ohmmeter import Ohmmeter, Range
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, ScpiError

OUTPUT_IS_OFF = (-221, "Settings conflict")
OVERFLOW, NOT_A_NUMBER = 9.9e37, 9.91e37  # SCPI's numbers for both
AUTOMATIC_DIGITS = 7  # shown with :FORMat:ASCii:PRECision 0


class Keithley2450(Ohmmeter):
    """The meter; its options are those of `Ohmmeter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.02, 0.2, 2.0, 20.0, 200.0)
    IDENTITY: ClassVar[str] = "KEITHLEY INSTRUMENTS,MODEL 2450,{},{}"
    SERIAL_NUMBER: ClassVar[str] = "04096331"
    REVISION: ClassVar[str] = "1.7.0e"
    BAUDRATE: ClassVar[float] = 115200.0
    OVERRANGE: ClassVar[float] = 1.05
    ABORTS: ClassVar[tuple[bytes, ...]] = ()
    NO_ERROR: ClassVar[str] = '0,"No error;0;0 0"'

    def _prepare(self) -> None:
        self.output_is_on = False
        self.elements: tuple[str, ...] = ("READ",)
        self._values: dict[str, float] = {}
        define_commands(self._tree, self)
        self.reset()

    @property
    def test_current_A(self) -> float:
        """What flows through the film now, A: nothing with the output off."""
        if not self.output_is_on:
            return 0.0
        if self.function == "RES":
            return self._ranges[self._range_index].test_current_A
        return float(self.settings["SOUR:CURR"]) if self.settings["SOUR:FUNC"] == "CURR" else 0.0

    def switch_output(self, on: bool) -> None:
        """OUTPut."""
        self.output_is_on = on
        self.tell_test_current()

    def choose_function(self, function: str) -> None:
        """Measure something else."""
        if function not in FUNCTIONS:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        self.function = function
        self.tell_test_current()

    # ---- measuring ------------------------------------------------------------------------------

    def initiate(self, count: int = 1) -> None:
        """Begin `count` readings; an error where the output is off."""
        if not self.output_is_on:
            raise ScpiError(*OUTPUT_IS_OFF)
        super().initiate(count)

    def ask_reading(self, elements: tuple[str, ...]) -> None:
        """`READ?` and `MEASure?`: a new reading."""
        self.elements = elements
        self.read(1)

    def ask_again(self, elements: tuple[str, ...]) -> str | None:
        """`FETCh?`: the last reading, after one that is on its way."""
        self.elements = elements
        answer = self.fetch(fresh=False)
        return None if answer is None else self._text()

    def averaged(self) -> int:
        """As the filter of its function is set, a repeating one."""
        return int(self.settings[self.function + ":AVER:COUN"]) if self.settings[self.function + ":AVER"] else 1

    def trigger_delay_s(self) -> float:
        """None."""
        return 0.0

    def digitize(self) -> str:
        """The elements that are asked for; empty where autorange has changed the range."""
        if self.function == "RES":
            value = self.sample_ohm()
            if value is None:
                return ""
        elif self.function == "VOLT":
            value = self._voltage_V()
        else:
            value = self.test_current_A
        value = self.filtered(value)
        self._values = {"SOUR": self.test_current_A, "READ": value, "REL": self._now_s, "STAT": float(isinf(value))}
        return self._text()

    def _voltage_V(self) -> float:
        """At the input; beyond the range where that is fixed +-inf. What the source drives through the film counts."""
        current_A = self.test_current_A
        plant = self._plant
        voltage_V = current_A * plant.read_resistance_ohm(current_A) if current_A else plant.read_voltage_V()
        full_V = float(self.settings["VOLT:RANG"])
        over = not self.settings["VOLT:RANG:AUTO"] and abs(voltage_V) > self.OVERRANGE * full_V
        return copysign(inf, voltage_V) if over else voltage_V

    def _text(self) -> str:
        digits = int(self.settings["PREC"]) or AUTOMATIC_DIGITS
        return ", ".join(f"{_number(self._values[element]):.{digits - 1}E}" for element in self.elements)

    # ---- errors and settings --------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        """Into the event log, with a kind and a date."""
        super().push_error(text.removesuffix('"') + ';1;2026/01/01 00:00:00.000"')

    def reset(self) -> None:
        """`*RST`: output off, sources 0 V, measures current."""
        self.abort()
        self._last = ""
        self.output_is_on = False
        self.settings = default_settings()
        self.function = "CURR"
        self.choose_range(210e3)
        self.tell_test_current()


def _number(value: float) -> float:
    if isnan(value):
        return NOT_A_NUMBER
    return copysign(OVERFLOW, value) if isinf(value) else value
