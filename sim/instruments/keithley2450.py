"""Keithley 2450 SourceMeter as an ohmmeter.

Source: Model 2450 reference manual 2450-901-01, section 6 (SCPI commands) and appendix B, as far as our driver,
PyMeasure and QCoDeS use it. NOT verified on an instrument: overhead times, test currents (those of the 2400), its
answer with the output off (here: nothing, and an error).

One function is measured at a time. In the ohms function the range sets the test current; otherwise the source does. A
reading's elements are named in the question; a number has as many digits as `:FORMat:ASCii:PRECision` says. Errors have
a kind and a date behind their text, with semicolons between.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isinf
from typing import ClassVar

from sim.instruments.keithley2400 import SourceMeter
from sim.instruments.meter import ON_OFF, REGISTERS, Setting
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, Parameters, ScpiError

AUTOMATIC_DIGITS = 7  # with :FORMat:ASCii:PRECision 0
ELEMENTS = {"SOUR": "SOURCE", "READ": "READING", "REL": "RELATIVE", "STAT": "STATUS"}
LARGEST = {"RES": 200e6, "VOLT": 200.0, "CURR": 1.0}  # range of each function
OF_EACH_FUNCTION = (
    Setting(":NPLCycles", "NPLC", 1.0, "%g", 0.01, 10.0),
    Setting(":RSENse", "RSEN", 0, ON_OFF),
    Setting(":AZERo", "AZER", 1, ON_OFF),
    Setting(":AVERage:COUNt", "AVER:COUN", 10, "%d", 1, 100),
    Setting(":AVERage[:STATe]", "AVER", 0, ON_OFF),
    Setting(":AVERage:TCONtrol", "AVER:TCON", "REP"),
    Setting(":RANGe:AUTO", "RANG:AUTO", 1, ON_OFF),
)


class Keithley2450(SourceMeter):
    """The meter; its options are those of `Meter`."""

    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.02, 0.2, 2.0, 20.0, 200.0)
    IDENTITY: ClassVar[str] = "KEITHLEY INSTRUMENTS,MODEL 2450,{},{}"
    SERIAL_NUMBER: ClassVar[str] = "04096331"
    REVISION: ClassVar[str] = "1.7.0e"
    BAUDRATE: ClassVar[float] = 115200.0
    ABORTS: ClassVar[tuple[bytes, ...]] = ()
    NO_ERROR: ClassVar[str] = '0,"No error;0;0 0"'
    LEVEL_TEXT: ClassVar[str] = "%.6E"
    NOT_WHEN_OFF: ClassVar[tuple[int, str]] = (-221, "Settings conflict")
    SETTINGS: ClassVar[Sequence[Setting]] = (
        *REGISTERS[:2],
        Setting(":FORMat:ASCii:PRECision", "PREC", 0, "%d", 0, 16),
        Setting(":FORMat[:DATA]", "FORM", "ASC"),
        Setting("[:SENSe#]:COUNt", "COUN", 1, "%d", 1, 300000),
        Setting(":ROUTe:TERMinals", "TERM", "FRON"),
        Setting(":SOURce#:CURRent:VLIMit[:LEVel]", "SOUR:CURR:LIM", 0.0, "%.6E", 0.0, 210.0),
        Setting(":SOURce#:CURRent:RANGe", "SOUR:CURR:RANG", 0.0, "%.6E", -1.05, 1.05),
        Setting(":SOURce#:CURRent:RANGe:AUTO", "SOUR:CURR:AUTO", 1, ON_OFF),
        Setting(":SOURce#:VOLTage:ILIMit[:LEVel]", "SOUR:VOLT:LIM", 0.0, "%.6E", 0.0, 1.05),
        Setting(":SOURce#:VOLTage:RANGe", "SOUR:VOLT:RANG", 0.0, "%.6E", -210.0, 210.0),
        Setting(":SOURce#:VOLTage:RANGe:AUTO", "SOUR:VOLT:AUTO", 1, ON_OFF),
        *(
            one.of(name, "[:SENSe#]:" + header)
            for name, header in SourceMeter.FUNCTIONS.items()
            for one in OF_EACH_FUNCTION
        ),
    )
    _values: dict[str, float]  # of the last reading, by element
    SILENT: ClassVar[Sequence[str]] = (":ABORt", "*LANG", ":TRACe:CLEar", ":SYSTem:CLEar")

    def _define_commands(self) -> None:
        self._define_common()
        self._define_source()
        self._define_choice("[:SENSe#]:FUNCtion[:ON]")
        define = self._tree.define
        for function, header in self.FUNCTIONS.items():
            self._define_range(function, "[:SENSe#]:" + header, LARGEST[function], "%g", LARGEST[function])
            define(":MEASure:" + header, ask=partial(self._measure, function))
        define(":READ", ask=self._read_elements)
        define(":MEASure", ask=self._read_elements)
        define(":FETCh", ask=self._fetch_elements)
        define("*LANG", ask=lambda _: "SCPI")
        define(":SYSTem:LFRequency", ask=lambda _: "50")
        define(":TRACe:POINts", set=lambda _: None, ask=lambda _: "100000")

    def _choose_elements(self, parameters: Parameters) -> None:
        """Take the elements behind the buffer's name; the reading alone if there are none."""
        words = [word.upper() for word in parameters[1:]]
        short = {long: short for short, long in ELEMENTS.items()}
        self.elements = tuple(short.get(word, word) for word in words) or ("READ",)
        if not set(self.elements) <= ELEMENTS.keys():
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)

    def _read_elements(self, parameters: Parameters) -> None:
        self._choose_elements(parameters)
        self.read(1)

    def _fetch_elements(self, parameters: Parameters) -> str | None:
        self._choose_elements(parameters)
        return None if self.fetch() is None else self._text()

    def _measure(self, function: str, parameters: Parameters) -> None:
        self.choose_function(function)
        self._read_elements(parameters)

    @property
    def test_current_A(self) -> float:
        """Return the current through the film now, A: nothing with the output off."""
        if not self.output_is_on:
            return 0.0
        if self.measures_resistance:
            return self._ranges[self._range_index].test_current_A
        return float(self.settings["SOUR:CURR"]) if self.settings["SOUR:FUNC"] == "CURR" else 0.0

    def averaged(self) -> int:
        return int(self.settings[self.function + ":AVER:COUN"]) if self.settings[self.function + ":AVER"] else 1

    def digitize(self) -> str:
        value: float | None = self.test_current_A
        if self.measures_resistance:
            value = self.sample_ohm()
        elif self.function == "VOLT":
            value = self._voltage_V()
        if value is None:
            return ""
        value = self.filtered(value)
        self._values = {"SOUR": self.test_current_A, "READ": value, "REL": self._now_s, "STAT": float(isinf(value))}
        return self._text()

    def _voltage_V(self) -> float:
        """Return the voltage at the input, that which the source drives through the film included."""
        current_A = self.test_current_A
        plant = self._plant
        voltage_V = current_A * plant.read_resistance_ohm(current_A) if current_A else plant.read_voltage_V()
        return self.within_voltage_range(voltage_V, float(self.settings["VOLT:RANG"]), "VOLT")

    def _text(self) -> str:
        digits = int(self.settings["PREC"]) or AUTOMATIC_DIGITS
        return ", ".join(f"{self.shown(self._values[element]):.{digits - 1}E}" for element in self.elements)

    def push_error(self, text: str) -> None:
        """See `ScpiInstrument.push_error`; an event has a kind and a date."""
        super().push_error(text.removesuffix('"') + ';1;2026/01/01 00:00:00.000"')

    def default_settings(self) -> dict[str, float | str]:
        return super().default_settings() | {"VOLT:RANG": 20.0, "CURR:RANG": 1e-4, "RES:RANG": 0.0}

    def reset(self) -> None:
        """See `Meter.reset`: output off, sources 0 V, measures current."""
        super().reset()
        self.elements = ("READ",)
        self._values = {}
        self.function = "CURR"
        self.choose_range(210e3)
        self.send_test_current()
