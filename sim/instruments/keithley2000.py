"""Keithley 2000 multimeter as an ohmmeter, on its RS-232 port.

Sources: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63 and chapter 5 (SCPI reference), as far as our driver,
PyMeasure and QCoDeS use it. NOT verified on an instrument: test currents, overhead times, digits of a reading (all are
parameters).

The test current flows as long as a resistance function is chosen. ^C and ^X abort, and discard what is pending.
Functions other than resistance and DC voltage can be chosen and set, and read 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import ClassVar

from sim.instruments.meter import ON_OFF, REGISTERS, Multimeter, Range, Setting

# test currents: not verified on an instrument
RANGES = (
    Range(1e2, 1e-3),
    Range(1e3, 1e-3),
    Range(1e4, 1e-4),
    Range(1e5, 1e-5),
    Range(1e6, 1e-5),
    Range(1e7, 0.7e-6),
    Range(1e8, 0.7e-6),
)
OF_EACH_FUNCTION = (
    Setting(":NPLCycles", "NPLC", 1.0, "%.2f", 0.01, 10.0),
    Setting(":DIGits", "DIG", 7, "%d", 4, 7),
    Setting(":REFerence", "REF", 0.0, "%+.8E", -1e9, 1e9),
    Setting(":REFerence:STATe", "REF:STAT", 0, ON_OFF),
    Setting(":AVERage:COUNt", "AVER:COUN", 10, "%d", 1, 100),
    Setting(":AVERage[:STATe]", "AVER:STAT", 0, ON_OFF),
    Setting(":AVERage:TCONtrol", "TCON", "REP"),
    Setting(":APERture", "APER", 0.1, "%.3f", 0.01, 1.0),
    Setting(":DETector:BANDwidth", "DET:BAND", 30, "%+.8E", 3, 3e5),
    Setting(":THReshold:VOLTage:RANGe", "THR", 10, "%+.8E", 0, 1010),
    Setting(":RANGe:AUTO", "RANG:AUTO", 1, ON_OFF),
)


class Keithley2000(Multimeter):
    """The meter; its options are those of `Meter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    IDENTITY: ClassVar[str] = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,{},{}"
    REVISION: ClassVar[str] = "A20  /A02"
    BAUDRATE: ClassVar[float] = 19200.0
    TRIGGER: ClassVar[tuple[str, ...]] = ("TRIG:",)
    FUNCTIONS: ClassVar[Mapping[str, str]] = {
        "VOLT:DC": "VOLTage[:DC]",
        "VOLT:AC": "VOLTage:AC",
        "CURR:DC": "CURRent[:DC]",
        "CURR:AC": "CURRent:AC",
        "RES": "RESistance",
        "FRES": "FRESistance",
        "PER": "PERiod",
        "FREQ": "FREQuency",
        "TEMP": "TEMPerature",
        "DIOD": "DIODe",
        "CONT": "CONTinuity",
    }
    SETTINGS: ClassVar[Sequence[Setting]] = (
        *REGISTERS,
        Setting(":TRIGger[:SEQuence#]:COUNt", "TRIG:COUN", 1, "%d", 1, 9999),
        Setting(":TRIGger[:SEQuence#]:DELay", "TRIG:DEL", 0.0, "%.3f", 0.0, 999999.999),
        Setting(":TRIGger[:SEQuence#]:SOURce", "TRIG:SOUR", "IMM"),
        Setting(":INITiate:CONTinuous", "TRIG:CONT", 0, ON_OFF),
        Setting(":TRACe:POINts", "TRAC:POIN", 100, "%d", 2, 1024),
        Setting(":TRACe:FEED", "TRAC:FEED", "SENS"),
        Setting(":TRACe:FEED:CONTrol", "TRAC:CONT", "NEV"),
        Setting(":FORMat[:DATA]", "FORM", "ASC"),
        Setting(":FORMat:ELEMents", "ELEM", "READ"),
        Setting(":SYSTem:BEEPer:STATe", "BEEP", 1, ON_OFF),
        Setting(":DISPlay:ENABle", "DISP", 1, ON_OFF),
        *(one.of(name, "[:SENSe#]:" + header) for name, header in FUNCTIONS.items() for one in OF_EACH_FUNCTION),
    )
    SILENT: ClassVar[Sequence[str]] = (
        ":SYSTem:LOCal",
        ":SYSTem:REMote",
        ":SYSTem:RWLock",
        ":SYSTem:BEEPer[:IMMediate]",
        ":STATus:PRESet",
        ":TRACe:CLEar",
    )

    def averaged(self) -> int:
        of_function = self.function + ":"
        return int(self.settings[of_function + "AVER:COUN"]) if self.settings[of_function + "AVER:STAT"] else 1

    def default_settings(self) -> dict[str, float | str]:
        return super().default_settings() | {f"{function}:RANG": 1000.0 for function in self.FUNCTIONS}

    def _define_commands(self) -> None:
        self._define_common()
        self._define_choice("[:SENSe#]:FUNCtion")
        self._define_measuring(lambda: int(self.settings["TRIG:COUN"]))
        define = self._tree.define
        self._define(":STATus:QUEue:CLEar", self.errors.clear)
        define(":CONFigure", ask=lambda _: f'"{self.function}"')
        for function, header in self.FUNCTIONS.items():
            self._define_range(function, "[:SENSe#]:" + header, 120e6, "%+.8E")
            self._define(":CONFigure:" + header, partial(self.configure, function))
            define(f"[:SENSe#]:{header}:REFerence:ACQuire", set=lambda _: None)
        define("[:SENSe#]:DATA:FRESh", ask=lambda _: self.fetch(fresh=True))
