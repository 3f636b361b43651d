"""Keithley 2000 multimeter as an ohmmeter on its RS-232 port.

Source: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63. Test currents are NOT verified on an instrument.

The test current flows as long as a resistance function is chosen; `off` chooses volts. Set the instrument to RS-232 at
19200 Bd with LF (or CRLF) at its front panel; from the factory it listens to GPIB.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from rig.drivers.scpi_meter import ScpiMeter, Setting
from rig.ports.open import LineSettings

# full scale, ohm -> test current, A; not verified on an instrument
TEST_CURRENTS_A: Mapping[float, float] = MappingProxyType(
    {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 1e-5, 1e7: 0.7e-6, 1e8: 0.7e-6}
)


class Keithley2000Meter(ScpiMeter):
    """A `rig.drivers.meter.Meter`; options as in `ScpiMeter`."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=19200)
    NAME: ClassVar[str] = "Keithley 2000"
    MODELS: ClassVar[tuple[str, ...]] = ("2000",)
    AVERAGE: ClassVar[str] = ":SENS:{function}:AVER"
    TEST_CURRENTS_A: ClassVar[Mapping[float, float]] = TEST_CURRENTS_A
    VOLTS: ClassVar[str] = "VOLT:DC"
    QUOTE: ClassVar[str] = "'"

    def _settings(self, index: int) -> list[list[Setting]]:
        function = [
            Setting(f":CONF:{self._function}", ""),
            Setting(":INIT:CONT", "0"),
            Setting(":TRIG:COUN", "1"),
            Setting(":SENS:FUNC", None, self._function),
            self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
        ]
        return [function, self._of_range(index)]
