"""HP / Agilent 34401A multimeter as an ohmmeter on its RS-232 port.

Source: 34401A User's Guide, RS-232 section p. 149 to 152. NOT verified on an instrument: test currents, and its framing
as shipped (7 bits, even parity); two stop bits are fixed.

The meter holds its sender off by DTR, of which a serial port on Linux takes no notice. So there is one outstanding
question at any time, no message is longer than 100 characters, and after ^C there is a pause. It wants to be in remote
mode first (SYSTem:REMote), and forgets that when it is switched off. `READ?` does not keep its readings: here they are
initiated, and fetched twice. The test current flows as long as a resistance function is chosen; `off` chooses volts.

At 9600 Bd with two stop bits the 70 characters of a reading take 80 ms: with NPLC 1 a period of 0.2 s is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from rig.drivers.scpi import ScpiLink
from rig.drivers.scpi_meter import ScpiMeter, Setting
from rig.ports.open import LineSettings

# full scale, ohm -> test current, A; not verified on an instrument
TEST_CURRENTS_A: Mapping[float, float] = MappingProxyType(
    {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 5e-6, 1e7: 5e-7, 1e8: 5e-7}
)
NPLCS = (0.02, 0.2, 1.0, 10.0, 100.0)  # that it has


class Hp34401ALink(ScpiLink):
    """The line of the meter."""

    END: ClassVar[bytes] = b"\n"
    ABORT: ClassVar[bytes] = b"\x03"
    CLEAR_S: ClassVar[float] = 0.05
    WAKE: bytes = b"SYST:REM"


class Hp34401AMeter(ScpiMeter):
    """A `rig.drivers.meter.Meter`; options as in `ScpiMeter`."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=9600, bytesize=7, parity="E", stopbits=2)
    LINK: ClassVar[type[ScpiLink]] = Hp34401ALink
    NAME: ClassVar[str] = "HP 34401A"
    MAKERS: ClassVar[tuple[str, ...]] = ("HEWLETT", "AGILENT", "KEYSIGHT")
    MODELS: ClassVar[tuple[str, ...]] = ("34401",)
    TEST_CURRENTS_A: ClassVar[Mapping[float, float]] = TEST_CURRENTS_A
    READ: ClassVar[str] = "INIT;FETC?;FETC?"
    SENSE: ClassVar[str] = ":"

    def _check_nplc(self, nplc: float) -> None:
        if nplc not in NPLCS:
            raise ValueError(f"{nplc} power line cycles: one of {', '.join(f'{one:g}' for one in NPLCS)} is expected")

    def _settings(self, index: int) -> list[list[Setting]]:
        function = [
            Setting(f":CONF:{self._function}", ""),
            Setting(":TRIG:COUN", "1"),
            Setting(":SAMP:COUN", "1"),
            Setting(":FUNC", None, self._function),
            self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
        ]
        automatic, in_range = self._of_range(index)
        return [function, [automatic._replace(value=None), in_range]]  # a range ends the automatic one here
