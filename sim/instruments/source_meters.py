"""Keithley 2400 and 2450 SourceMeters as ohmmeters.

Sources: 2400 series manual p. 4-4 and 4-14 (auto-ohms and its test currents, four wires), 14-14, 18-51 (elements and
their two sentinels), 18-61, and chapter 18 (SCPI reference); Model 2450 reference manual 2450-901-01, section 6 (SCPI
commands) and appendix B; as far as our drivers, PyMeasure and QCoDeS use them. NOT verified on an instrument: overhead
times; the 2400's error numbers above 500 and its status word (here: 1 overflow, 8 in compliance, 4096 output on); the
2450's test currents (those of the 2400), and its answer with the output off (here: nothing, and an error).

The output has to be on: otherwise there is no reading, but an error in the queue. In the ohms function (of the 2400: in
auto-ohms mode) the range sets the test current; otherwise the source's settings do.
"""

from __future__ import annotations

from functools import partial
from math import inf, isinf, nan
from typing import ClassVar

from sim.instruments.scpi import (
    ILLEGAL_PARAMETER_VALUE,
    INVALID_CHARACTER_DATA,
    MISSING_PARAMETER,
    ON_OFF,
    REGISTERS,
    Meter,
    Parameters,
    ScpiError,
    Setting,
)

ELEMENTS = {"VOLT": "VOLTAGE", "CURR": "CURRENT", "RES": "RESISTANCE", "TIME": "TIME", "STAT": "STATUS"}
OF_EACH_LAYER = (  # of the trigger model
    Setting(":SOURce", "SOUR", "IMM"),
    Setting(":OUTPut", "OUTP", "NONE"),
    Setting(":ILINe", "ILIN", 1, "%d", 1, 4),
    Setting(":OLINe", "OLIN", 2, "%d", 1, 4),
)
OUTPUT_IS_OFF = (803, "Not permitted with OUTPUT off")
STALE = (-230, "Data corrupt or stale")
OVERFLOWED, IN_COMPLIANCE, OUTPUT_ON = 1, 8, 4096  # bits of a reading's status word
AUTOMATIC_DIGITS = 7  # with :FORMat:ASCii:PRECision 0
ELEMENTS_2450 = {"SOUR": "SOURCE", "READ": "READING", "REL": "RELATIVE", "STAT": "STATUS"}
OF_EACH_2450_FUNCTION = (
    Setting(":NPLCycles", "NPLC", 1.0, "%g", 0.01, 10.0),
    Setting(":RSENse", "RSEN", 0, ON_OFF),
    Setting(":AZERo", "AZER", 1, ON_OFF),
    Setting(":AVERage:COUNt", "AVER:COUN", 10, "%d", 1, 100),
    Setting(":AVERage[:STATe]", "AVER", 0, ON_OFF),
    Setting(":AVERage:TCONtrol", "AVER:TCON", "REP"),
    Setting(":RANGe:AUTO", "RANG:AUTO", 1, ON_OFF),
)


def source_settings(level_text: str) -> tuple[Setting, ...]:
    """Return the rows of the output and the source. level_text: a level's % format."""
    levels = (("CURRent", "SOUR:CURR", 1.05), ("VOLTage", "SOUR:VOLT", 210.0))
    return (
        Setting(":OUTPut#[:STATe]", "OUTP", 0, ON_OFF),
        Setting(":SOURce#:FUNCtion[:MODE]", "SOUR:FUNC", "VOLT", words=("CURRent", "VOLTage")),
        *(
            Setting(f":SOURce#:{word}[:LEVel][:IMMediate][:AMPLitude]", name, 0.0, level_text, -largest, largest)
            for word, name, largest in levels
        ),
    )


class SourceMeter(Meter):
    """A meter that sources its test current as long as its output is on. SOURCES: name and largest level of each."""

    # manual, table of resistance ranges
    RANGES = {20.0: 100e-3, 200.0: 10e-3, 2e3: 1e-3, 20e3: 100e-6, 200e3: 10e-6, 2e6: 1e-6, 20e6: 1e-6, 200e6: 100e-9}
    OVERRANGE = 1.05
    FIRST_RANGE_OHM = 200e3
    FUNCTIONS = {"VOLT": "VOLTage[:DC]", "CURR": "CURRent[:DC]", "RES": "RESistance"}
    NOT_WHEN_OFF: ClassVar[tuple[int, str]]
    elements: tuple[str, ...]  # of a reply

    @property
    def test_current_A(self) -> float:
        """Return the current through the film now, A: nothing with the output off."""
        if not self.settings["OUTP"]:
            return 0.0
        return self.RANGES[self.full_scale_ohm] if self._in_ohms else self._sourced_A

    @property
    def _in_ohms(self) -> bool:
        """Return True if the range sets the test current."""
        return self.measures_resistance

    @property
    def _sourced_A(self) -> float:
        """Return the current that the source's settings make."""
        return float(self.settings["SOUR:CURR"]) if self.settings["SOUR:FUNC"] == "CURR" else 0.0

    def function_text(self, function: str) -> str:
        return function if function == "RES" else function + ":DC"

    def initiate(self, count: int = 1, keep: bool = True) -> None:
        """Begin `count` readings; it is an error if the output is off."""
        if not self.settings["OUTP"]:
            raise ScpiError(*self.NOT_WHEN_OFF)
        super().initiate(count, keep)

    def reset(self) -> None:
        """See `Meter.reset`: output off, sources 0 V, measures current."""
        super().reset()
        self.function = "CURR"
        self.send_test_current()


class Keithley2400(SourceMeter):
    """Keithley 2400; its options are those of `Meter`.

    A reply has the elements of FORMat:ELEMents in their fixed order; what is neither measured nor sourced reads as not
    a number.
    """

    VOLTAGE_RANGES_V = (0.2, 2.0, 20.0, 200.0)
    IDENTITY = "KEITHLEY INSTRUMENTS INC.,MODEL 2400,1234567,C30   Mar 17 2006 09:29:29/A02  /K/J"
    BAUDRATE = 57600.0
    NOT_WHEN_OFF = OUTPUT_IS_OFF
    NO_READING = STALE
    enabled: set[str]  # functions that are measured
    SETTINGS = (
        *REGISTERS,
        *source_settings("%+.6E"),
        Setting(":TRIGger[:SEQuence#]:COUNt", "TRIG:COUN", 1, "%d", 1, 2500),
        Setting(":TRIGger[:SEQuence#]:DELay", "TRIG:DEL", 0.0, "%.4f", 0.0, 999.9999),
        Setting(":ARM[:SEQuence#][:LAYer#]:COUNt", "ARM:COUN", 1, "%d", 1, 2500),
        Setting(":ARM[:SEQuence#][:LAYer#]:TIMer", "ARM:TIM", 0.1, "%.3f", 0.001, 99999.99),
        *(
            one.of(layer, header)
            for layer, header in (("TRIG", ":TRIGger[:SEQuence#]"), ("ARM", ":ARM[:SEQuence#][:LAYer#]"))
            for one in OF_EACH_LAYER
        ),
        Setting("[:SENSe#]:AVERage:COUNt", "AVER:COUN", 10, "%d", 1, 100),
        Setting("[:SENSe#]:AVERage:TCONtrol", "AVER:TCON", "REP"),
        Setting("[:SENSe#]:AVERage[:STATe]", "AVER", 0, ON_OFF),
        Setting("[:SENSe#]:FUNCtion:CONCurrent", "CONC", 1, ON_OFF),
        *(
            Setting(header, name, usual, "%+.6E", -largest, largest)
            for word, usual, largest in (("CURRent", 1.05e-4, 1.05), ("VOLTage", 21.0, 210.0))
            for header, name in (
                (f"[:SENSe#]:{word}[:DC]:RANGe[:UPPer]", f"{word[:4]}:RANG"),
                (f"[:SENSe#]:{word}[:DC]:PROTection[:LEVel]", f"{word[:4]}:PROT"),
                (f":SOURce#:{word}:RANGe", f"SOUR:{word[:4]}:RANG"),
            )
        ),
        Setting("[:SENSe#]:CURRent[:DC]:RANGe:AUTO", "CURR:RANG:AUTO", 1, ON_OFF),
        Setting("[:SENSe#]:VOLTage[:DC]:RANGe:AUTO", "VOLT:RANG:AUTO", 1, ON_OFF),
        Setting("[:SENSe#]:RESistance:RANGe[:UPPer]", "RES:RANG", 2e5, "%+.6E", 0.0, 210e6),
        Setting("[:SENSe#]:RESistance:RANGe:AUTO", "RES:RANG:AUTO", 1, ON_OFF),
        Setting("[:SENSe#]:RESistance:MODE", "RES:MODE", "MAN", words=("AUTO", "MANual")),
        *(
            Setting(f"[:SENSe#]:{of}:NPLCycles", "NPLC", 1.0, "%.2f", 0.01, 10.0)
            for of in SourceMeter.FUNCTIONS.values()
        ),
        Setting(":SOURce#:CURRent:RANGe:AUTO", "SOUR:CURR:AUTO", 1, ON_OFF),
        Setting(":SOURce#:VOLTage:RANGe:AUTO", "SOUR:VOLT:AUTO", 1, ON_OFF),
        Setting(":SOURce#:DELay", "SOUR:DEL", 0.0, "%.5f", 0.0, 999.9999),
        Setting(":SOURce#:DELay:AUTO", "SOUR:DEL:AUTO", 1, ON_OFF),
        Setting(":SOURce#:CLEar:AUTO", "SOUR:CLE", 0, ON_OFF),
        Setting(":TRACe:POINts", "TRAC:POIN", 100, "%d", 1, 2500),
        Setting(":TRACe:FEED", "TRAC:FEED", "SENS"),
        Setting(":TRACe:FEED:CONTrol", "TRAC:CONT", "NEV"),
        Setting(":FORMat[:DATA]", "FORM", "ASC"),
        Setting(":CALCulate3:FORMat", "CALC3:FORM", "MEAN"),
        Setting(":SYSTem:RSENse", "RSEN", 0, ON_OFF),
        Setting(":SYSTem:AZERo[:STATe]", "AZER", 1, ON_OFF),
        Setting(":DISPlay:ENABle", "DISP", 1, ON_OFF),
        Setting(":OUTPut#:SMODe", "SMOD", "NORM"),
        Setting(":ROUTe:TERMinals", "TERM", "FRON"),
    )
    SILENT = (
        ":SYSTem:BEEPer[:IMMediate]",
        ":STATus:PRESet",
        ":TRACe:CLEar",
        ":TRIGger:CLEar",
        "*TRG",
    )

    # ---- commands -------------------------------------------------------------------------------

    def _define_commands(self) -> None:
        define = self._tree.define
        define("[:SENSe#]:FUNCtion[:ON]", set=lambda p: self.choose_functions(self._named(p)), ask=self._enabled)
        self._define("[:SENSe#]:FUNCtion[:ON]:ALL", lambda: self.choose_functions(set(self.FUNCTIONS)))
        for function, header in self.FUNCTIONS.items():
            define(":MEASure:" + header, ask=partial(self._measure, function))
        self._define_measuring(lambda: int(self.settings["TRIG:COUN"]) * int(self.settings["ARM:COUN"]))
        define(":FORMat:ELEMents[:SENSe#]", set=self._choose_elements, ask=lambda _: ",".join(self.elements))
        define(":CALCulate3:DATA", ask=lambda _: "+0.000000E+00,+0.000000E+00,+0.000000E+00")
        define(":STATus:QUEue[:NEXT]", ask=lambda _: self.next_error())
        self._define(":STATus:QUEue:CLEar", self.errors.clear)

    def _named(self, parameters: Parameters) -> set[str]:
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        words = [quoted.strip("\"'") for quoted in parameters]
        if set(words) & set(parameters):
            raise ScpiError(*INVALID_CHARACTER_DATA)
        return {self._function_named(word) for word in words}

    def _enabled(self, _: Parameters) -> str:
        return ",".join(f'"{self.function_text(name)}"' for name in self.FUNCTIONS if name in self.enabled)

    def _choose_elements(self, parameters: Parameters) -> None:
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        wanted = {word.upper() for word in parameters}
        chosen = {short for short, long in ELEMENTS.items() if wanted & {short, long}}
        if not wanted <= {*ELEMENTS, *ELEMENTS.values()}:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        self.elements = tuple(short for short in ELEMENTS if short in chosen)

    def _measure(self, function: str, _: Parameters) -> None:
        self.configure(function)
        self.read(1)

    # ---- source ---------------------------------------------------------------------------------

    @property
    def measures_resistance(self) -> bool:
        """Return True if resistance is among the functions that are measured."""
        return "RES" in self.enabled

    @property
    def _in_ohms(self) -> bool:
        return self.measures_resistance and self.settings["RES:MODE"] == "AUTO"

    @property
    def _sources_current(self) -> bool:
        return self._in_ohms or self.settings["SOUR:FUNC"] == "CURR"

    @property
    def _sourced_A(self) -> float:
        return super()._sourced_A if self._sources_current else self._driven_A

    # ---- measuring ------------------------------------------------------------------------------

    def choose_functions(self, names: set[str]) -> None:
        """Measure these too; without concurrency these only."""
        if not names <= self.FUNCTIONS.keys():
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        self.enabled = self.enabled | names if self.settings["CONC"] else names
        self.send_test_current()

    def initiate(self, count: int = 1, keep: bool = True) -> None:
        """See `SourceMeter.initiate`; with automatic clear the output is switched on for the readings."""
        self._clear(on=True)
        super().initiate(count, keep)

    def _finish(self) -> None:
        self._clear(on=False)

    def _clear(self, on: bool) -> None:
        if self.settings["SOUR:CLE"]:
            self.settings["OUTP"] = int(on)
            self.send_test_current()

    def digitize(self) -> str:
        voltage_V, current_A, resistance_ohm = self._measured()
        if resistance_ohm is None:
            return ""
        status = OUTPUT_ON if self.settings["OUTP"] else 0
        status |= OVERFLOWED if isinf(resistance_ohm if self.measures_resistance else voltage_V) else 0
        status |= IN_COMPLIANCE if not self._in_ohms and voltage_V == self.settings["VOLT:PROT"] else 0
        volts = "VOLT" in self.enabled or not self._sources_current
        amps = "CURR" in self.enabled or self._sources_current
        values = {
            "VOLT": voltage_V if volts else nan,
            "CURR": current_A if amps else nan,
            "RES": resistance_ohm if self.measures_resistance else nan,
            "TIME": self._now_s,
            "STAT": float(status),
        }
        return ",".join("%+.6E" % self.shown(values[element]) for element in self.elements)  # noqa: UP031 - in half the time

    def _measured(self) -> tuple[float, float, float | None]:
        """Return voltage, V, current, A, and resistance, ohm; None if autorange has changed the range."""
        current_A = self.test_current_A
        if self._in_ohms:
            ohm = self.sample_ohm()
            ohm = None if ohm is None else self.filtered(ohm)
            current_A = self.test_current_A
            return (nan if ohm is None else ohm * current_A), current_A, ohm
        ohm = self._plant.read_resistance_ohm(current_A)
        if self._sources_current:
            limit_V = float(self.settings["VOLT:PROT"])
            if not current_A:  # the voltage at the input is not of this meter's making
                return self.filtered(self.within_voltage_range(self._plant.read_voltage_V(), "VOLT")), 0.0, inf
            voltage_V = min(limit_V, max(-limit_V, ohm * current_A))
            return voltage_V, voltage_V / ohm if abs(voltage_V) == limit_V else current_A, ohm
        limit_A, voltage_V = float(self.settings["CURR:PROT"]), float(self.settings["SOUR:VOLT"])
        self._driven_A = min(limit_A, max(-limit_A, voltage_V / ohm)) if ohm else limit_A
        self.send_test_current()
        return self._driven_A * ohm, self._driven_A, ohm if self._driven_A else inf

    # ---- settings -------------------------------------------------------------------------------

    def reset(self) -> None:
        """See `SourceMeter.reset`: manual ohms, all elements."""
        self.enabled = {"CURR"}
        self.elements = tuple(ELEMENTS)
        self._driven_A = 0.0
        super().reset()
        self.function = "RES"  # whose range and autorange are in use

    def configure(self, function: str) -> None:
        """Measure this function alone, one reading a trigger, as CONFigure does."""
        self.abort()
        self.settings["TRIG:COUN"] = self.settings["ARM:COUN"] = 1
        self.enabled = {function}
        self.send_test_current()


class Keithley2450(SourceMeter):
    """Keithley 2450; its options are those of `Meter`.

    One function is measured at a time. A reading's elements are named in the question; a number has as many digits as
    `:FORMat:ASCii:PRECision` says. Errors have a kind and a date behind their text, with semicolons between.
    """

    VOLTAGE_RANGES_V = (0.02, 0.2, 2.0, 20.0, 200.0)
    IDENTITY = "KEITHLEY INSTRUMENTS,MODEL 2450,04096331,1.7.0e"
    BAUDRATE = 115200.0
    ABORTS = ()
    NO_ERROR = '0,"No error;0;0 0"'
    NOT_WHEN_OFF = (-221, "Settings conflict")
    SETTINGS = (
        *REGISTERS[:2],
        *source_settings("%.6E"),
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
            for one in OF_EACH_2450_FUNCTION
        ),
        Setting("[:SENSe#]:RESistance:RANGe[:UPPer]", "RES:RANG", 2e5, "%g", 0.0, 200e6),
        Setting("[:SENSe#]:VOLTage[:DC]:RANGe[:UPPer]", "VOLT:RANG", 20.0, "%g", 0.0, 200.0),
        Setting("[:SENSe#]:CURRent[:DC]:RANGe[:UPPer]", "CURR:RANG", 1e-4, "%g", 0.0, 1.0),
    )
    _values: dict[str, float]  # of the last reading, by element
    SILENT = (":ABORt", "*LANG", ":TRACe:CLEar", ":SYSTem:CLEar")

    def _define_commands(self) -> None:
        self._define_choice("[:SENSe#]:FUNCtion[:ON]")
        define = self._tree.define
        for function, header in self.FUNCTIONS.items():
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
        short = {long: short for short, long in ELEMENTS_2450.items()}
        self.elements = tuple(short.get(word, word) for word in words) or ("READ",)
        if not set(self.elements) <= ELEMENTS_2450.keys():
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
        return self.within_voltage_range(voltage_V, "VOLT")

    def _text(self) -> str:
        digits = int(self.settings["PREC"]) or AUTOMATIC_DIGITS
        return ", ".join(f"{self.shown(self._values[element]):.{digits - 1}E}" for element in self.elements)

    def push_error(self, text: str) -> None:
        """See `ScpiInstrument.push_error`; an event has a kind and a date."""
        super().push_error(text.removesuffix('"') + ';1;2026/01/01 00:00:00.000"')

    def reset(self) -> None:
        self.elements = ("READ",)
        self._values = {}
        super().reset()
