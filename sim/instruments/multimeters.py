"""Keithley 2000 and HP / Agilent 34401A multimeters as ohmmeters, on their RS-232 ports.

Sources: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63 and chapter 5 (SCPI reference); 34401A User's Guide, RS-232
section p. 149 to 152 (remote mode, hold-off, ^C, two stop bits); as far as our drivers, PyMeasure and QCoDeS use them.
NOT verified on an instrument: test currents, overhead times, digits of a reading of the 2000; the 34401A's overload
text, its error numbers above 500, and which commands it takes before it is in remote mode (here: the common ones, and
the error queue).

The test current flows as long as a resistance function is chosen. Functions other than resistance and DC voltage can be
chosen and set, and read 0.
"""

from __future__ import annotations

from functools import partial
from typing import ClassVar

from sim.instruments.scpi import (
    ON_OFF,
    OVERFLOW,
    REGISTERS,
    RESISTANCES,
    VOLTAGES,
    Call,
    Meter,
    Parameters,
    ScpiError,
    Setting,
    number,
)

OF_EACH_2000_FUNCTION = (
    Setting(":NPLCycles", "NPLC", 1.0, "%.2f", 0.01, 10.0),
    Setting(":DIGits", "DIG", 7, "%d", 4, 7),
    Setting(":REFerence", "REF", 0.0, "%+.8E", -1e9, 1e9),
    Setting(":REFerence:STATe", "REF:STAT", 0, ON_OFF),
    Setting(":AVERage:COUNt", "AVER:COUN", 10, "%d", 1, 100),
    Setting(":AVERage[:STATe]", "AVER", 0, ON_OFF),
    Setting(":AVERage:TCONtrol", "TCON", "REP"),
    Setting(":APERture", "APER", 0.1, "%.3f", 0.01, 1.0),
    Setting(":DETector:BANDwidth", "DET:BAND", 30, "%+.8E", 3, 3e5),
    Setting(":THReshold:VOLTage:RANGe", "THR", 10, "%+.8E", 0, 1010),
    Setting(":RANGe[:UPPer]", "RANG", 1000.0, "%+.8E", 0.0, 120e6),
    Setting(":RANGe:AUTO", "RANG:AUTO", 1, ON_OFF),
)
HOLD_OFF, TOLERANCE = 100, 10  # characters
OVERRUN = (512, "RS-232 overrun error")
ONLY_IN_REMOTE = (550, "Command not allowed in local")
IN_LOCAL = "*IDN?;*CLS;SYST:ERR?;SYST:REM;SYST:RWL;SYST:LOC"  # what it takes before it is in remote mode
STALE = (-230, "Data corrupt or stale")
INTEGRATING = ("VOLT", "CURR", "RES", "FRES")
NPLCS = (0.02, 0.2, 1.0, 10.0, 100.0)  # that it has
FREQUENCIES = ("FREQ", "PER")
OF_EACH_34401A_FUNCTION = (
    Setting(":APERture", "APER", 0.1, "%+.8E", 0.01, 1.0),
    Setting(":NPLCycles", "NPLC", 10.0, "%+.8E", NPLCS[0], NPLCS[-1]),
    Setting(":RANGe[:UPPer]", "RANG", 1000.0, "%+.8E", 0.0, 120e6),
    Setting(":RANGe:AUTO", "RANG:AUTO", 1, ON_OFF),
)


class Multimeter(Meter):
    """A bench multimeter: resistance and DC voltage are measured, its other functions read 0.

    TRIGGER: settings that CONFigure resets.
    """

    TRIGGER: ClassVar[tuple[str, ...]]

    def digitize(self) -> str:
        value: float | None = 0.0
        if self.measures_resistance:
            value = self.sample_ohm()
        elif self.function in VOLTAGES:
            value = self.within_voltage_range(self._plant.read_voltage_V(), self.function)
        if value is None:
            return ""
        return "%+.8E" % self.shown(self.filtered(value))  # noqa: UP031 - half the time of an f-string

    def reset(self) -> None:
        """See `Meter.reset`: DC volts, autorange, one reading a trigger."""
        super().reset()
        self.choose_function(next(iter(self.FUNCTIONS)))

    def configure(self, function: str) -> None:
        """Set a function's settings and the trigger to their defaults and choose it, as CONFigure does."""
        self.abort()
        self._last = ""
        for setting in self.SETTINGS:
            if setting.name.startswith((function + ":", *self.TRIGGER)):
                self.settings[setting.name] = setting.default
        self.function = function
        if self.measures_resistance:
            self.choose_range(self.FIRST_RANGE_OHM)
        self.send_test_current()


class Keithley2000(Multimeter):
    """Keithley 2000; its options are those of `Meter`. ^C and ^X abort, and discard what is pending."""

    # test currents: not verified on an instrument
    RANGES = {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 1e-5, 1e7: 0.7e-6, 1e8: 0.7e-6}
    IDENTITY = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1234567,A20  /A02"
    BAUDRATE = 19200.0
    TRIGGER = ("TRIG:",)
    FUNCTIONS = {
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
    SETTINGS = (
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
        *(one.of(name, "[:SENSe#]:" + header) for name, header in FUNCTIONS.items() for one in OF_EACH_2000_FUNCTION),
    )
    SILENT = (
        ":SYSTem:LOCal",
        ":SYSTem:REMote",
        ":SYSTem:RWLock",
        ":SYSTem:BEEPer[:IMMediate]",
        ":STATus:PRESet",
        ":TRACe:CLEar",
        *(f"[:SENSe#]:{header}:REFerence:ACQuire" for header in FUNCTIONS.values()),
    )

    def _define_commands(self) -> None:
        self._define_choice("[:SENSe#]:FUNCtion")
        self._define_measuring(lambda: int(self.settings["TRIG:COUN"]))
        self._define(":STATus:QUEue:CLEar", self.errors.clear)
        self._tree.define(":CONFigure", ask=lambda _: f'"{self.function}"')
        for function, header in self.FUNCTIONS.items():
            self._define(":CONFigure:" + header, partial(self.configure, function))
        self._tree.define("[:SENSe#]:DATA:FRESh", ask=lambda _: self.fetch(fresh=True))


class Hp34401A(Multimeter):
    """HP / Agilent 34401A; its options are those of `Meter`.

    It has one line for both ways of flow control, DTR: it is down as soon as there is an answer to send, or some 100
    characters wait. What is sent all the same is lost after 10 more characters. `READ?` gives its readings out without
    keeping them; `INITiate` keeps them for `FETCh?`.
    """

    # test currents: not verified on an instrument
    RANGES = {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 5e-6, 1e7: 5e-7, 1e8: 5e-7}
    IDENTITY = "HEWLETT-PACKARD,34401A,0,11-5-2"
    BAUDRATE = 9600.0
    BITS_PER_CHARACTER = 11.0  # start, 7 and parity or 8, and two stop bits
    TERMINATOR = b"\r\n"
    TRIGGER = ("TRIG:", "SAMP:")
    NOT_A_NUMBER = OVERFLOW
    NO_READING = STALE
    ABORTS = (b"\x03",)
    QUEUE_LENGTH = 20
    QUEUE_OVERFLOW = '-350,"Too many errors"'
    NO_ERROR = '+0,"No error"'
    SIGN = "+"
    FUNCTIONS = {
        "VOLT": "VOLTage[:DC]",
        "VOLT:RAT": "VOLTage[:DC]:RATio",
        "VOLT:AC": "VOLTage:AC",
        "CURR": "CURRent[:DC]",
        "CURR:AC": "CURRent:AC",
        "RES": "RESistance",
        "FRES": "FRESistance",
        "FREQ": "FREQuency",
        "PER": "PERiod",
        "CONT": "CONTinuity",
        "DIOD": "DIODe",
    }
    SETTINGS = (
        Setting(":TRIGger:COUNt", "TRIG:COUN", 1, "%+.8E", 1, 50000),
        Setting(":TRIGger:DELay", "TRIG:DEL", 0.0, "%+.8E", 0.0, 3600.0),
        Setting(":TRIGger:DELay:AUTO", "TRIG:AUTO", 1, ON_OFF),
        Setting(":TRIGger:SOURce", "TRIG:SOUR", "IMM"),
        Setting(":SAMPle:COUNt", "SAMP:COUN", 1, "%+d", 1, 50000),
        Setting("[:SENSe]:DETector:BANDwidth", "DET:BAND", 20, "%+.8E", 3, 200),
        Setting("[:SENSe]:ZERO:AUTO", "AZER", 1, ON_OFF),
        Setting(":SYSTem:BEEPer:STATe", "BEEP", 1, ON_OFF),
        Setting(":DISPlay[:WINDow#][:STATe]", "DISP", 1, ON_OFF),
        Setting(":DISPlay[:WINDow#]:TEXT[:DATA]", "TEXT", '""'),
        Setting(":INPut:IMPedance:AUTO", "IMP", 0, ON_OFF),
        Setting("*ESE", "*ESE", 0, "%+d", 0, 255),
        *(
            one.of(name, f"[:SENSe]:{header}" + (":VOLTage" * (name in FREQUENCIES and one.name.startswith("RANG"))))
            for name, header in FUNCTIONS.items()
            for one in OF_EACH_34401A_FUNCTION
            if one.name != "NPLC" or name in INTEGRATING
        ),
    )
    SILENT = (":SYSTem:BEEPer[:IMMediate]",)

    def _define_commands(self) -> None:
        self.remote = False
        self._unheard = 0  # characters that came while DTR was down
        for word in ("REMote", "RWLock", "LOCal"):
            self._define(":SYSTem:" + word, partial(setattr, self, "remote", word != "LOCal"))
        self._in_local = {call.func for call in self._tree.parse(IN_LOCAL)}
        self._define_choice("[:SENSe#]:FUNCtion")
        self._define_measuring(lambda: int(self.settings["TRIG:COUN"]) * int(self.settings["SAMP:COUN"]), keep=False)
        define = self._tree.define
        for function, header in self.FUNCTIONS.items():
            define(":CONFigure:" + header, set=partial(self._configure, function))
            define(":MEASure:" + header, ask=partial(self._measure, function))
        define(":DATA:POINts", ask=lambda _: f"{len(self._last.split(',')) if self._last else 0:+d}")
        define(":SYSTem:VERSion", ask=lambda _: "1991.0")
        define(":ROUTe:TERMinals", ask=lambda _: "FRON")

    def _configure(self, function: str, parameters: Parameters) -> None:
        """CONFigure: the first parameter is a range, the second a resolution, which is not kept."""
        self.configure(function)
        if parameters and parameters[0].upper() not in ("DEF", "DEFAULT", "AUTO") and function in RESISTANCES:
            self.settings[f"{function}:RANG"] = number(parameters[:1], 0.0, 120e6, 1000.0)
            self.changed(f"{function}:RANG")

    def _measure(self, function: str, parameters: Parameters) -> None:
        self._configure(function, parameters)
        self.read(1, keep=False)

    def changed(self, name: str) -> None:
        """See `Meter.changed`. An integration time is the next one up that it has."""
        super().changed(name)
        if name.endswith(":NPLC"):
            self.settings[name] = next(nplc for nplc in NPLCS if float(self.settings[name]) <= nplc)

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. While DTR is down all but some characters are lost."""
        clear = data.rfind(b"\x03")
        if clear >= 0:
            super().receive(data[: clear + 1], time_s)
            self._unheard = 0
            data = data[clear + 1 :]
        if not data:
            return
        if self.holds_off(time_s):
            heard = data[: max(0, TOLERANCE - self._unheard)]
            self._unheard += len(data)
        else:
            heard = data[: HOLD_OFF + TOLERANCE - len(self._partial)]
            self._unheard = 0
        if len(heard) < len(data):
            self.push_error(str(ScpiError(*OVERRUN)))
        if heard:
            super().receive(heard, time_s)

    def holds_off(self, time_s: float) -> bool:
        """Return True if DTR is down: a question has come, and its answer has not been sent to its end."""
        if self._waiting or (self._replies and self._replies[-1][0] > time_s):
            return True
        return any("?" in message for _, message in self._messages)

    def _run(self, call: Call) -> None:
        if not self.remote and call.func not in self._in_local:
            self.push_error(str(ScpiError(*ONLY_IN_REMOTE)))
            self._calls.clear()
            return
        super()._run(call)
