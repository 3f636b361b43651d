"""Keithley 2400 SourceMeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Sources: 2400 series manual p. 4-4 and 4-14 (auto-ohms and its test currents, four wires), 14-14, 18-51 (elements and
their two sentinels), 18-61; the command set as PyMeasure uses it. NOT verified on an instrument: overhead times, the
numbers of the errors that have one above 500, the status word (here: 1 overflow, 8 in compliance, 4096 output on).

The output has to be on: `READ?`, `INITiate` and `MEASure?` with the output off give no answer, but an error in the
queue. In auto-ohms mode the range sets the test current; in manual mode the source's settings do. A reply has the
elements of FORMat:ELEMents in their fixed order; what is neither measured nor sourced reads as not a number.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign, inf, isinf, isnan, nan
from typing import ClassVar

from sim.instruments.keithley2400_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.ohmmeter import Ohmmeter, Range
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, ScpiError

RANGES = (  # full scale (ohm) and test current (A): manual, table of resistance ranges
    Range(20.0, 100e-3),
    Range(200.0, 10e-3),
    Range(2e3, 1e-3),
    Range(20e3, 100e-6),
    Range(200e3, 10e-6),
    Range(2e6, 1e-6),
    Range(20e6, 1e-6),
    Range(200e6, 100e-9),
)
OVERFLOW_TEXT, NAN_TEXT = "+9.900000E+37", "+9.910000E+37"
ELEMENTS = ("VOLT", "CURR", "RES", "TIME", "STAT")
OUTPUT_IS_OFF = (803, "Not permitted with OUTPUT off")
STALE = (-230, "Data corrupt or stale")
OVERFLOWED, IN_COMPLIANCE, OUTPUT_ON = 1, 8, 4096  # bits of a reading's status word


class Keithley2400(Ohmmeter):
    """The meter; its options are those of `Ohmmeter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.2, 2.0, 20.0, 200.0)
    IDENTITY: ClassVar[str] = "KEITHLEY INSTRUMENTS INC.,MODEL 2400,{},{}"
    REVISION: ClassVar[str] = "C30   Mar 17 2006 09:29:29/A02  /K/J"
    BAUDRATE: ClassVar[float] = 57600.0
    OVERRANGE: ClassVar[float] = 1.05

    def _prepare(self) -> None:
        self.output_is_on = False
        self.enabled: set[str] = set()
        self.elements: tuple[str, ...] = ELEMENTS
        self._driven_A = 0.0
        define_commands(self._tree, self)
        self.reset()

    # ---- source ---------------------------------------------------------------------------------

    @property
    def measures_resistance(self) -> bool:
        """Whether resistance is among the functions that are measured."""
        return "RES" in self.enabled

    @property
    def _auto_ohms(self) -> bool:
        return self.measures_resistance and self.settings["RES:MODE"] == "AUTO"

    @property
    def _sources_current(self) -> bool:
        return self._auto_ohms or self.settings["SOUR:FUNC"] == "CURR"

    @property
    def test_current_A(self) -> float:
        """What flows through the film now, A: nothing with the output off."""
        if not self.output_is_on:
            return 0.0
        if self._auto_ohms:
            return self._ranges[self._range_index].test_current_A
        return float(self.settings["SOUR:CURR"]) if self._sources_current else self._driven_A

    def switch_output(self, on: bool) -> None:
        """OUTPut."""
        self.output_is_on = on
        self.tell_test_current()

    # ---- measuring ------------------------------------------------------------------------------

    def choose_functions(self, names: set[str], on: bool) -> None:
        """Measure these too, or no longer; without concurrency the last one only."""
        if not names <= FUNCTIONS.keys():
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        if on:
            self.enabled = names if not self.settings["CONC"] else self.enabled | names
        else:
            self.enabled -= names
        self.tell_test_current()

    def initiate(self, count: int = 1) -> None:
        """Begin `count` readings; an error where the output is off."""
        if not self.output_is_on:
            if not self.settings["SOUR:CLE"]:
                raise ScpiError(*OUTPUT_IS_OFF)
            self.switch_output(True)
        super().initiate(count)

    def fetch(self, fresh: bool) -> str | None:
        """The last reading, after those that are on their way. None yet is an error."""
        if not (self.measuring or self._last):
            raise ScpiError(*STALE)
        return super().fetch(fresh)

    def _finished(self) -> None:
        if self.settings["SOUR:CLE"]:
            self.switch_output(False)

    def aperture_s(self) -> float:
        """NPLC line periods; NPLC is one for all functions."""
        return float(self.settings["NPLC"]) * self._line_period_s

    def averaged(self) -> int:
        """As its filter is set, a repeating one; of ohms with a current of its choice, and of volts at its input."""
        return int(self.settings["AVER:COUN"]) if self.settings["AVER"] else 1

    def digitize(self) -> str:
        """The elements that are asked for; empty where autorange has changed the range."""
        voltage_V, current_A, resistance_ohm = self._measured()
        if resistance_ohm is None:
            return ""
        status = OUTPUT_ON if self.output_is_on else 0
        status |= OVERFLOWED if isinf(resistance_ohm if self.measures_resistance else voltage_V) else 0
        status |= IN_COMPLIANCE if not self._auto_ohms and voltage_V == self.settings["VOLT:PROT"] else 0
        volts = "VOLT" in self.enabled or not self._sources_current
        amps = "CURR" in self.enabled or self._sources_current
        values = {
            "VOLT": voltage_V if volts else nan,
            "CURR": current_A if amps else nan,
            "RES": resistance_ohm if self.measures_resistance else nan,
            "TIME": self._now_s,
            "STAT": float(status),
        }
        return ",".join(_text(values[element]) for element in self.elements)

    def _measured(self) -> tuple[float, float, float | None]:
        """Voltage, V, current, A, and resistance, ohm; None where autorange has changed the range."""
        if self._auto_ohms:
            ohm = self.sample_ohm()
            ohm = None if ohm is None else self.filtered(ohm)
            current_A = self.test_current_A
            return (nan if ohm is None else ohm * current_A), current_A, ohm
        current_A = self.test_current_A
        ohm = self._plant.read_resistance_ohm(current_A)
        if self._sources_current:
            limit_V = float(self.settings["VOLT:PROT"])
            if not current_A:  # what is at the input, and not of our making
                return self.filtered(self._voltage_V()), 0.0, inf
            voltage_V = min(limit_V, max(-limit_V, ohm * current_A))
            return voltage_V, voltage_V / ohm if abs(voltage_V) == limit_V else current_A, ohm
        limit_A, voltage_V = float(self.settings["CURR:PROT"]), float(self.settings["SOUR:VOLT"])
        self._driven_A = min(limit_A, max(-limit_A, voltage_V / ohm)) if ohm else limit_A
        self.tell_test_current()
        return self._driven_A * ohm, self._driven_A, ohm if self._driven_A else inf

    def _voltage_V(self) -> float:
        """At the input with no current; +-inf beyond the range that is set."""
        voltage_V = self._plant.read_voltage_V()
        full_V = self.voltage_range_V(abs(float(self.settings["VOLT:RANG"])))
        over = not self.settings["VOLT:RANG:AUTO"] and abs(voltage_V) > self.OVERRANGE * full_V
        return copysign(inf, voltage_V) if over else voltage_V

    # ---- settings -------------------------------------------------------------------------------

    def reset(self) -> None:
        """`*RST`: output off, sources 0 V, measures current, manual ohms, all elements; the error queue stays."""
        self.abort()
        self._last = ""
        self.output_is_on = False
        self.settings = default_settings()
        self.function = "RES"  # whose range and autorange are in use
        self.enabled = {"CURR"}
        self.elements = ELEMENTS
        self._driven_A = 0.0
        self.choose_range(210e3)

    def configure(self, function: str) -> None:
        """`CONFigure`: measure this one, one reading a trigger."""
        self.abort()
        self.settings["TRIG:COUN"] = self.settings["ARM:COUN"] = 1
        self.enabled = {function}
        self.tell_test_current()


def _text(value: float) -> str:
    if isnan(value):
        return NAN_TEXT
    if isinf(value):
        return OVERFLOW_TEXT if value > 0 else "-" + OVERFLOW_TEXT[1:]
    return "%+.6E" % value  # noqa: UP031 - half the time of an f-string
