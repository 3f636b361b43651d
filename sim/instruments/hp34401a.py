"""HP / Agilent 34401A multimeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Sources: 34401A User's Guide, RS-232 section p. 149 to 152 (remote mode, hold-off, ^C, two stop bits); the command set
as PyMeasure uses it. NOT verified on an instrument: test currents, overhead times, the overload's text, error numbers
above 500, and which commands the meter takes before it is in remote mode (here: the common ones, and the error queue).

The meter has one line for both ways of flow control, DTR: it is down as soon as there is an answer to send, or some
100 characters wait. What is sent all the same is lost after 10 more characters. `READ?` gives its readings out without
keeping them; `INITiate` keeps them for `FETCh?`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import ClassVar

from sim.instruments.hp34401a_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.multimeter import OVERFLOW_TEXT, Multimeter
from sim.instruments.ohmmeter import Range
from sim.instruments.scpi import Call, Handler, ScpiError

# test currents: not verified on an instrument
RANGES = (
    Range(100.0, 1e-3),
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


class Hp34401A(Multimeter):
    """The meter; its options are those of `Ohmmeter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    IDENTITY: ClassVar[str] = "HEWLETT-PACKARD,34401A,{},{}"
    SERIAL_NUMBER: ClassVar[str] = "0"
    REVISION: ClassVar[str] = "11-5-2"
    BAUDRATE: ClassVar[float] = 9600.0
    BITS_PER_CHARACTER: ClassVar[float] = 11.0  # start, 7 and parity or 8, and two stop bits
    TERMINATOR: ClassVar[bytes] = b"\r\n"
    FUNCTIONS: ClassVar[Collection[str]] = FUNCTIONS
    FIRST_FUNCTION: ClassVar[str] = "VOLT"
    TRIGGER: ClassVar[tuple[str, ...]] = ("TRIG:", "SAMP:")
    NAN_TEXT: ClassVar[str] = OVERFLOW_TEXT
    ABORTS: ClassVar[tuple[bytes, ...]] = (b"\x03",)
    QUEUE_LENGTH: ClassVar[int] = 20
    QUEUE_OVERFLOW: ClassVar[str] = '-350,"Too many errors"'
    NO_ERROR: ClassVar[str] = '+0,"No error"'

    def _prepare(self) -> None:
        self.remote = False
        self.local_handlers: frozenset[Handler] = frozenset()  # what it does before it is in remote mode
        self.stored: str | None = None
        self._keep = False
        self._unheard = 0
        define_commands(self._tree, self)
        self.reset()

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. What comes while DTR is down is lost after some characters."""
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
            room = HOLD_OFF + TOLERANCE - len(self._partial)
            heard = data if len(data) <= room else data[:room]
            self._unheard = 0
        if len(heard) < len(data):
            self.push_error(str(ScpiError(*OVERRUN)))
        if heard:
            super().receive(heard, time_s)

    def holds_off(self, time_s: float) -> bool:
        """Whether DTR is down: a question has come, and its answer has not been sent to its end."""
        if self._waiting or (self._replies and self._replies[-1][0] > time_s):
            return True
        return any("?" in message for _, message in self._messages)

    # ---- messages -------------------------------------------------------------------------------

    def _run(self, call: Call) -> None:
        if not self.remote and call.handler not in self.local_handlers:
            self.push_error(str(ScpiError(*ONLY_IN_REMOTE)))
            self._calls.clear()
            return
        super()._run(call)

    # ---- measuring ------------------------------------------------------------------------------

    def store(self, count: int) -> None:
        """`INITiate`: begin `count` readings, which are kept for `FETCh?`."""
        self.stored = None
        self.initiate(count)
        self._keep = True

    def read(self, count: int) -> None:
        """`READ?`: begin `count` readings, which are given out and not kept."""
        super().read(count)
        self.stored, self._keep = None, False

    def fetch(self, fresh: bool) -> str | None:
        """`FETCh?`: the readings that are kept, when they are there. Nothing kept is an error."""
        if self.measuring and self._keep:
            self._waiting = True
            return None
        if self.stored is None:
            raise ScpiError(*STALE)
        return self.stored

    def _finished(self) -> None:
        if self._keep:
            self.stored = self._last

    def aperture_s(self) -> float:
        """NPLC line periods; one in the functions that have none."""
        return float(self.settings.get(self.function + ":NPLC", 1.0)) * self._line_period_s

    # ---- settings -------------------------------------------------------------------------------

    def default_settings(self) -> dict[str, float | str]:
        """Every setting at its `*RST` value, NPLC 10 among them."""
        return default_settings()

    def reset(self) -> None:
        """`*RST`; remote mode stays."""
        self.stored = None
        super().reset()

    def configure(self, function: str) -> None:
        """`CONFigure`; what was kept is forgotten."""
        self.stored = None
        super().configure(function)
