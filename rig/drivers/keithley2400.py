"""Keithley 2400 SourceMeter as an ohmmeter on its RS-232 port.

Sources: 2400 series manual p. 4-4, 4-14 (auto-ohms, its test currents, the recipe for four wires), 14-14, 18-51
(elements of a reply, and the numbers for overflow and for not measured), 18-61.

It sources its test current through the film as long as its output is on, and 100 mA in its lowest range: only ranges
whose current is allowed are used, and every reply carries the current that was sourced, which has to be the range's.
`output_between_readings`: whether the output stays on from the first reading (and the film's self-heating with it) or
is on during a reading only. `off` and `close` switch it off. If it is found off, switched by hand or by an interlock, a
reading is Refused with the instrument's own error, and the next one switches it on again.

For volts it sources 0 A. A reply has two of the five elements, current and resistance, or the voltage alone.

Set the instrument to RS-232 at 57600 Bd with LF (or CRLF) at its front panel; from the factory it has 9600 Bd, at which
the 90 characters of a reading take 94 ms (option `baud`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar

from rig.core.errors import OutOfStep, TimedOut
from rig.core.reading import Reading
from rig.drivers.meter import OVERFLOW
from rig.drivers.scpi_meter import ScpiMeter, Setting, is_number
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

# full scale, ohm -> test current in auto-ohms, A (p. 4-14)
TEST_CURRENTS_A: Mapping[float, float] = MappingProxyType(
    {20.0: 100e-3, 200.0: 10e-3, 2e3: 1e-3, 2e4: 100e-6, 2e5: 10e-6, 2e6: 1e-6, 2e7: 1e-6, 2e8: 100e-9}
)
CURRENT_TOLERANCE = 0.05  # of the test current, between the table and the reply


class SourceMeter(ScpiMeter):
    """An ohmmeter that sources its test current while its output is on."""

    TEST_CURRENTS_A: ClassVar[Mapping[float, float]] = TEST_CURRENTS_A
    FIRST_RANGE_OHM: ClassVar[float] = 2e5
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.2, 2.0, 20.0, 200.0)
    OVERRANGE: ClassVar[float] = 1.05
    _stays_on = True  # between readings
    _output_is_on = False

    def start_reading(self) -> None:
        """Begin a reading; switch the output on if it has to be."""
        if self._ranges:
            self.link.be_in_step()
            if self._rests:
                self._apply()
            if self._stays_on and not self._output_is_on:
                self.link.command(":OUTP ON")
                self._output_is_on = True
        super().start_reading()

    def finish_reading(self) -> Reading:
        """Return the reading that was begun, ohm. Refused, from the error queue, if there was none."""
        try:
            return super().finish_reading()
        except TimedOut:
            self.link.explain_silence(self._message)
            raise

    def off(self) -> bool:
        """Switch the output off until the next reading; return True only if that reads back. Never raises."""
        self._output_is_on = False
        return super().off()

    def close(self) -> None:
        """Switch the output off, as well as that can be done, and let go of the port. Never raises."""
        self.off()
        super().close()

    def _function_for(self, four_wire: bool) -> str:
        return "RES"

    def _apply(self) -> None:
        self._output_is_on = False
        super()._apply()

    def _rest(self) -> bool:
        return is_number(self.link.ask(":OUTP OFF;:OUTP?"), 0.0)

    def _value(self, text: str) -> float:
        if self._reads_volts:
            return super()._value(text)
        current_text, _, resistance_text = text.partition(",")
        current_A, resistance_ohm = super()._value(current_text), super()._value(resistance_text)
        if resistance_ohm >= OVERFLOW:  # into an open film it cannot source its current
            return resistance_ohm
        expected_A = self.test_current_A
        if abs(current_A - expected_A) > CURRENT_TOLERANCE * expected_A:
            self.link.doubt()
            raise OutOfStep(f"the meter sourced {current_A:g} A, and {expected_A:g} A belong to its range")
        return resistance_ohm


class Keithley2400Meter(SourceMeter):
    """A `rig.drivers.meter.Meter`; options as in `ScpiMeter`, and whether the output stays on between readings."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=57600)
    NAME: ClassVar[str] = "Keithley 2400"
    MODELS: ClassVar[tuple[str, ...]] = ("2400", "2401")
    AVERAGE: ClassVar[str] = ":SENS:AVER"

    def __init__(
        self,
        transport: Transport,
        *,
        output_between_readings: bool = True,
        line: LineSettings | None = None,
        test_currents_A: Mapping[float, float] | None = None,
        first_range_ohm: float | None = None,
        first_token: int | None = None,
    ) -> None:
        super().__init__(
            transport,
            line=line,
            test_currents_A=test_currents_A,
            first_range_ohm=first_range_ohm,
            first_token=first_token,
        )
        self._stays_on = output_between_readings

    def _settings(self, index: int) -> list[list[Setting]]:
        name, elements = self._function, "VOLT" if self._reads_volts else "CURR,RES"
        source = [Setting(":SOUR:FUNC", "CURR", "CURR"), Setting(":SOUR:CURR", "0")] if self._reads_volts else []
        limit = [self._of_function("PROT", f"{1.05 * self._ranges[index]:g}")] if self._reads_volts else []
        mode = [] if self._reads_volts else [self._of_function("MODE", "AUTO", "AUTO")]
        return [
            [Setting("*RST", "")],
            [
                *source,
                # others are measured, too
                Setting(":SENS:FUNC", f'"{name}"', lambda text: f'"{name}' in text.replace("'", '"')),
                *mode,
                self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
                Setting(":SYST:RSEN", "ON" if self._four_wire else "OFF", float(self._four_wire)),
            ],
            [*limit, *self._of_range(index)],
            [
                Setting(":FORM:ELEM", elements, lambda text: text.replace(" ", "") == elements),
                Setting(":SOUR:CLE:AUTO", f"{0 if self._stays_on else 1}", float(not self._stays_on)),
                Setting(":OUTP", None, float(self._output_is_on)),
            ],
        ]
