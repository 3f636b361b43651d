"""Keithley 2450 SourceMeter as an ohmmeter, on its network socket, on USB or on GPIB.

Sources: Model 2450 reference manual 2450-901-01, section 6 (:READ? p. 6-6, :FORMat p. 6-28, :SENSe p. 6-50 on, :OUTPut)
and appendix B (*ESE). Port: `socket://HOST:5025`, or `visa://USB0::...::INSTR` and `visa://GPIB0::18::INSTR` with the
extra `visa`. Its command set has to be SCPI (from the factory), not that of the 2400; that one is `keithley2400`'s.

As the 2400 it sources its test current through the film as long as its output is on (`rig.drivers.keithley2400`): the
driver chooses ranges by their test current, every reply carries the current that was sourced, which has to be the
range's, and `off` and `close` switch the output off. Not verified on an instrument: the test currents (those of the
2400; one that differs is an error, not a reading), the error that tells of an output that is off.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from rig.drivers.keithley2400 import Keithley2400Meter
from rig.drivers.scpi_meter import is_number
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

DIGITS = 8  # significant ones of a number
ELEMENTS = '"defbuffer1",SOUR,READ'


class Keithley2450Meter(Keithley2400Meter):
    """See `rig.drivers.meter.Meter`; options as in `ScpiMeter`. The output stays on between readings."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=115200)  # no line of its own has a baud rate
    LINK: ClassVar[Mapping[str, Any]] = MappingProxyType({"end": b"\n", "abort": b""})
    NAME: ClassVar[str] = "Keithley 2450"
    AVERAGE: ClassVar[str] = ":SENS:{function}:AVER"
    READ: ClassVar[str] = f":READ? {ELEMENTS};:FETC? {ELEMENTS}"
    NUMBER: ClassVar[re.Pattern[str]] = re.compile(r"[+-]?\d\.\d{4,10}E[+-]\d\d")

    def __init__(
        self,
        transport: Transport,
        *,
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

    def _is_mine(self, maker: str, model: str) -> bool:
        return "KEITHLEY" in maker and "2450" in model

    def _setting_messages(self) -> list[str]:
        self._output_is_on = False
        sense = f":SENS:{self._function}"
        messages = [
            "*RST",
            f':SENS:FUNC "{self._function}";{sense}:NPLC {self._nplc:g};{sense}:RSEN {int(self._four_wire)}',
            f"{sense}:RANG:AUTO 0;{sense}:RANG {self._range_text(self._chosen)};:FORM:ASC:PREC {DIGITS}",
        ]
        if self._reads_volts:
            limit_V = 1.05 * self._ranges[self._chosen]
            messages.insert(1, f":SOUR:FUNC CURR;:SOUR:CURR 0;:SOUR:CURR:VLIM {limit_V:g}")
        return messages

    def _settings_message(self) -> str:
        sense = f":SENS:{self._function}"
        of_function = f"{sense}:NPLC?;{sense}:RSEN?;{sense}:RANG:AUTO?;{sense}:RANG?"
        return f":SENS:FUNC?;{of_function};:FORM:ASC:PREC?;:SOUR:FUNC?;:OUTP?"

    def _as_configured(self, settings: list[str]) -> bool:
        if len(settings) != 8:
            return False
        function, nplc, wires, automatic, full_scale, digits, source, output = settings
        return (
            function.strip("\"'").partition(":")[0] == self._function
            and is_number(nplc, self._nplc)
            and is_number(wires, float(self._four_wire))
            and is_number(automatic, 0.0)
            and is_number(full_scale, self._ranges[self._index])
            and is_number(digits, DIGITS)
            and (source == "CURR" or not self._reads_volts)
            and is_number(output, float(self._output_is_on))
        )

    def _value(self, text: str) -> float:
        source, comma, reading = (part.strip() for part in text.partition(","))
        if self._reads_volts and comma:
            return super()._value(reading)
        return super()._value(f"{source}{comma}{reading}")
