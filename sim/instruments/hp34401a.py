"""HP / Agilent 34401A multimeter as an ohmmeter, on its RS-232 port.

Sources: 34401A User's Guide, RS-232 section p. 149 to 152 (remote mode, hold-off, ^C, two stop bits); the command set
as our driver, PyMeasure and QCoDeS use it. NOT verified on an instrument: test currents, overhead times, the overload's
text, error numbers above 500, and which commands the meter takes before it is in remote mode (here: the common ones,
and the error queue).

The meter has one line for both ways of flow control, DTR: it is down as soon as there is an answer to send, or some
100 characters wait. What is sent all the same is lost after 10 more characters. `READ?` gives its readings out without
keeping them; `INITiate` keeps them for `FETCh?`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

from sim.instruments.meter import ON_OFF, OVERFLOW, RESISTANCES, Multimeter, Range, Setting
from sim.instruments.scpi import Call, Handler, Parameters, ScpiError, number

# test currents: not verified on an instrument
RANGES = (
    Range(1e2, 1e-3),
    Range(1e3, 1e-3),
    Range(1e4, 1e-4),
    Range(1e5, 1e-5),
    Range(1e6, 5e-6),
    Range(1e7, 5e-7),
    Range(1e8, 5e-7),
)
HOLD_OFF, TOLERANCE = 100, 10  # characters
OVERRUN = (512, "RS-232 overrun error")
ONLY_IN_REMOTE = (550, "Command not allowed in local")
STALE = (-230, "Data corrupt or stale")
INTEGRATING = ("VOLT", "CURR", "RES", "FRES")
NPLCS = (0.02, 0.2, 1.0, 10.0, 100.0)  # that it has
FREQUENCIES = ("FREQ", "PER")


class Hp34401A(Multimeter):
    """The meter; its options are those of `Meter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    IDENTITY: ClassVar[str] = "HEWLETT-PACKARD,34401A,{},{}"
    SERIAL_NUMBER: ClassVar[str] = "0"
    REVISION: ClassVar[str] = "11-5-2"
    BAUDRATE: ClassVar[float] = 9600.0
    BITS_PER_CHARACTER: ClassVar[float] = 11.0  # start, 7 and parity or 8, and two stop bits
    TERMINATOR: ClassVar[bytes] = b"\r\n"
    TRIGGER: ClassVar[tuple[str, ...]] = ("TRIG:", "SAMP:")
    NOT_A_NUMBER: ClassVar[float] = OVERFLOW
    ABORTS: ClassVar[tuple[bytes, ...]] = (b"\x03",)
    QUEUE_LENGTH: ClassVar[int] = 20
    QUEUE_OVERFLOW: ClassVar[str] = '-350,"Too many errors"'
    NO_ERROR: ClassVar[str] = '+0,"No error"'
    SIGN: ClassVar[str] = "+"
    FUNCTIONS: ClassVar[Mapping[str, str]] = {
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
    SETTINGS: ClassVar[Sequence[Setting]] = (
        Setting(":TRIGger:COUNt", "TRIG:COUN", 1, "%+.8E", 1, 50000),
        Setting(":TRIGger:DELay", "TRIG:DEL", 0.0, "%+.8E", 0.0, 3600.0),
        Setting(":TRIGger:DELay:AUTO", "TRIG:AUTO", 1, ON_OFF),
        Setting(":TRIGger:SOURce", "TRIG:SOUR", "IMM"),
        Setting(":SAMPle:COUNt", "SAMP:COUN", 1, "%+d", 1, 50000),
        Setting("[:SENSe]:DETector:BANDwidth", "DET:BAND", 20, "%+.8E", 3, 200),
        Setting(":SYSTem:BEEPer:STATe", "BEEP", 1, ON_OFF),
        Setting(":DISPlay[:WINDow#][:STATe]", "DISP", 1, ON_OFF),
        Setting(":DISPlay[:WINDow#]:TEXT[:DATA]", "TEXT", '""'),
        Setting(":INPut:IMPedance:AUTO", "IMP", 0, ON_OFF),
        Setting("*ESE", "*ESE", 0, "%+d", 0, 255),
    )
    SILENT: ClassVar[Sequence[str]] = (":SYSTem:BEEPer[:IMMediate]",)

    def _define_commands(self) -> None:
        self.remote = False
        self.stored: str | None = None  # readings that can be fetched
        self._keep = False
        self._unheard = 0  # characters that came while DTR was down

        def enter_remote(_: Parameters) -> None:
            self.remote = True

        def leave_remote(_: Parameters) -> None:
            self.remote = False

        define = self._tree.define
        define(":SYSTem:REMote", set=enter_remote)
        define(":SYSTem:RWLock", set=enter_remote)
        define(":SYSTem:LOCal", set=leave_remote)
        self._in_local: frozenset[Handler] = self._define_common() | {enter_remote, leave_remote}
        self._define_choice("[:SENSe#]:FUNCtion")
        for function, header in self.FUNCTIONS.items():
            self._define_function(function, header)
        self._define_measuring(lambda: int(self.settings["TRIG:COUN"]) * int(self.settings["SAMP:COUN"]))
        self._define_autozero("[:SENSe]:ZERO:AUTO")
        define(":DATA:POINts", ask=lambda _: "+0" if self.stored is None else f"{self.stored.count(',') + 1:+d}")
        define(":SYSTem:VERSion", ask=lambda _: "1991.0")
        define(":ROUTe:TERMinals", ask=lambda _: "FRON")

    def _define_function(self, function: str, header: str) -> None:
        sense = "[:SENSe]:" + header + (":VOLTage" if function in FREQUENCIES else "")
        self._define_setting(Setting(sense + ":RANGe:AUTO", f"{function}:RANG:AUTO", 1, ON_OFF))
        aperture = f"[:SENSe]:{header}:APERture"
        self._define_setting(Setting(aperture, f"{function}:APER", 0.1, "%+.8E", 0.01, 1.0))
        self._define_range(function, sense, 1000.0, "%+.8E")
        self._tree.define(":CONFigure:" + header, set=self._configuring(function, False))
        self._tree.define(":MEASure:" + header, ask=self._configuring(function, True))

        def change_nplc(parameters: Parameters) -> None:
            value = number(parameters, NPLCS[0], NPLCS[-1], 10.0)
            self.settings[f"{function}:NPLC"] = next(nplc for nplc in NPLCS if value <= nplc)

        if function in INTEGRATING:
            nplc = f"{function}:NPLC"
            self._tree.define(sense + ":NPLCycles", set=change_nplc, ask=lambda _: f"{float(self.settings[nplc]):+.8E}")

    def _configuring(self, function: str, then_read: bool) -> Callable[[Parameters], None]:
        """CONFigure and MEASure: the first parameter is a range, the second a resolution, which is not kept."""

        def act(parameters: Parameters) -> None:
            self.configure(function)
            if parameters and parameters[0].upper() not in ("DEF", "DEFAULT", "AUTO") and function in RESISTANCES:
                value = number(parameters[:1], 0.0, 120e6, 1000.0)
                self.settings[f"{function}:RANG:AUTO"] = 0
                self.choose_range(value)
            if then_read:
                self.read(1)

        return act

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

    # ---- measuring ------------------------------------------------------------------------------

    def store(self, count: int) -> None:
        """Begin `count` readings, which are kept for `FETCh?`."""
        self.stored = None
        self.initiate(count)
        self._keep = True

    def read(self, count: int) -> None:
        """Begin `count` readings, which are given out and not kept."""
        super().read(count)
        self.stored, self._keep = None, False

    def fetch(self, fresh: bool = False) -> str | None:
        """Return the readings that are kept, when they are there; it is an error if none are."""
        if self.measuring and self._keep:
            self._waiting = True
            return None
        if self.stored is None:
            raise ScpiError(*STALE)
        return self.stored

    def _finish(self) -> None:
        if self._keep:
            self.stored = self._last

    def aperture_s(self) -> float:
        """See `Meter.aperture_s`; one line period in the functions that have no NPLC."""
        return float(self.settings.get(self.function + ":NPLC", 1.0)) * self._line_period_s

    # ---- settings -------------------------------------------------------------------------------

    def default_settings(self) -> dict[str, float | str]:
        settings = super().default_settings() | {"AZER": 1}
        for function in self.FUNCTIONS:
            values = {"RANG:AUTO": 1, "RANG": 1000.0, "APER": 0.1}
            settings |= {f"{function}:{name}": value for name, value in values.items()}
        return settings | {f"{function}:NPLC": 10.0 for function in INTEGRATING}

    def reset(self) -> None:
        self.stored = None
        super().reset()

    def configure(self, function: str) -> None:
        self.stored = None
        super().configure(function)
