"""Keithley 2000 multimeter as an ohmmeter on its RS-232 port.

Source: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63. Test currents are NOT verified on an instrument.

Ranges, the reading that is given twice and its residual are in `rig.drivers.scpi_ohmmeter`. The test current flows as
long as a resistance function is chosen; `off` chooses volts.

Set the instrument to RS-232 at 19200 Bd with LF (or CRLF) at its front panel; from the factory it listens
to GPIB.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar

from rig.drivers.scpi import ScpiLink
from rig.drivers.scpi_ohmmeter import ScpiOhmmeter, is_number
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

# full scale, ohm -> test current, A; not verified on an instrument
TEST_CURRENTS_A: Mapping[float, float] = MappingProxyType(
    {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 1e-5, 1e7: 0.7e-6, 1e8: 0.7e-6}
)


class Keithley2000Meter(ScpiOhmmeter):
    """See `rig.drivers.meter.ResistanceMeter`. line: settings that the port was opened with."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=19200)
    NAME: ClassVar[str] = "Keithley 2000"

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        test_currents_A: Mapping[float, float] = TEST_CURRENTS_A,
        first_range_ohm: float = 1e5,
        first_token: int | None = None,
    ) -> None:
        link = ScpiLink(
            transport,
            byte_s=line.byte_s,
            first_token=first_token,
            after_resynchronisation=self._look_after_doubt,
        )
        super().__init__(transport, link, test_currents_A=test_currents_A, first_range_ohm=first_range_ohm)

    def _is_mine(self, maker: str, model: str) -> bool:
        return "KEITHLEY" in maker and "2000" in model

    def _setting_messages(self) -> list[str]:
        sense = f":SENS:{self._function}"
        return [
            f":CONF:{self._function};:INIT:CONT 0;:TRIG:COUN 1;{sense}:NPLC {self._nplc:g}",
            f"{sense}:RANG:AUTO 0;{sense}:RANG {self._ranges[self._chosen]:.0f}",
        ]

    def _settings_message(self) -> str:
        sense = f":SENS:{self._function}"
        return f":SENS:FUNC?;{sense}:NPLC?;{sense}:RANG:AUTO?;{sense}:RANG?"

    def _as_configured(self, settings: list[str]) -> bool:
        if len(settings) != 4:
            return False
        function, nplc, automatic, full_scale_ohm = settings
        return (
            function.strip("\"'") == self._function
            and is_number(nplc, self._nplc)
            and is_number(automatic, 0.0)
            and is_number(full_scale_ohm, self._ranges[self._index])
        )

    def _rest(self) -> bool:
        return self.link.ask(":SENS:FUNC 'VOLT:DC';:SENS:FUNC?").strip("\"'").startswith("VOLT")
