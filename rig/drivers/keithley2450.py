"""Keithley 2450 SourceMeter as an ohmmeter, on its network socket, on USB or on GPIB.

Sources: Model 2450 reference manual 2450-901-01, section 6 (:READ? p. 6-6, :FORMat p. 6-28, :SENSe p. 6-50 on, :OUTPut)
and appendix B (*ESE). Port: `socket://HOST:5025`, or `visa://USB0::...::INSTR` and `visa://GPIB0::18::INSTR` with the
extra `visa`. Its command set has to be SCPI (from the factory), not that of the 2400, which `keithley2400` speaks.

As the 2400 it sources its test current through the film as long as its output is on (`rig.drivers.keithley2400`). Not
verified on an instrument: the test currents (those of the 2400; one that differs is an error, not a reading), the error
of an output that is off.
"""

from __future__ import annotations

import re
from typing import ClassVar

from rig.drivers.keithley2400 import SourceMeter
from rig.drivers.scpi import ScpiLink
from rig.drivers.scpi_meter import Setting
from rig.ports.open import LineSettings

DIGITS = 8  # significant ones of a number
ELEMENTS = '"defbuffer1",SOUR,READ'


class Keithley2450Link(ScpiLink):
    """The line of the meter."""

    END: ClassVar[bytes] = b"\n"
    ABORT: ClassVar[bytes] = b""


class Keithley2450Meter(SourceMeter):
    """A `rig.drivers.meter.Meter`; options as in `ScpiMeter`. The output stays on between readings."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=115200)  # no line of its own has a baud rate
    LINK: ClassVar[type[ScpiLink]] = Keithley2450Link
    NAME: ClassVar[str] = "Keithley 2450"
    MODELS: ClassVar[tuple[str, ...]] = ("2450",)
    AVERAGE: ClassVar[str] = ":SENS:{function}:AVER"
    READ: ClassVar[str] = f":READ? {ELEMENTS};:FETC? {ELEMENTS}"
    NUMBER: ClassVar[re.Pattern[str]] = re.compile(r"[+-]?\d\.\d{4,10}E[+-]\d\d")

    def _settings(self, index: int) -> list[list[Setting]]:
        name, limit_V = self._function, f"{1.05 * self._ranges[index]:g}"
        source = [
            Setting(":SOUR:FUNC", "CURR", "CURR"),
            Setting(":SOUR:CURR", "0"),
            Setting(":SOUR:CURR:VLIM", limit_V),
        ]
        return [
            [Setting("*RST", "")],
            *([source] if self._reads_volts else []),
            [
                Setting(":SENS:FUNC", f'"{name}"', lambda text: text.strip("\"'").partition(":")[0] == name),
                self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
                self._of_function("RSEN", f"{int(self._four_wire)}", float(self._four_wire)),
            ],
            [
                *self._of_range(index),
                Setting(":FORM:ASC:PREC", f"{DIGITS}", DIGITS),
                Setting(":OUTP", None, float(self._output_is_on)),
            ],
        ]

    def _value(self, text: str) -> float:
        source, comma, reading = (part.strip() for part in text.partition(","))
        if self._reads_volts and comma:
            return super()._value(reading)
        return super()._value(f"{source}{comma}{reading}")
