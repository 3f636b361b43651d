"""Keithley 2000 multimeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Sources: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63; the command set as PyMeasure and QCoDeS use it.
NOT verified on an instrument: test currents, overhead times, digits of a reading (all are parameters).

A command acts `command_s` after its terminator (CR, LF or both) has arrived. A reading integrates NPLC line
periods and samples the film in the middle; `overhead_s` later it is there. Commands wait while a query
waits for its reading. With autorange a reading beyond 120 % or below 10 % of the range is thrown away, and
the next range measures again. The test current flows as long as a resistance function is chosen. ^C and ^X
abort, and discard what is pending. Functions other than resistance and DC voltage can be chosen and set, and read 0.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import ClassVar

from sim.instruments.keithley2000_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.multimeter import Multimeter
from sim.instruments.ohmmeter import Range

# not verified on an instrument
RANGES = (
    Range(100.0, 1e-3),
    Range(1e3, 1e-3),
    Range(1e4, 1e-4),
    Range(1e5, 1e-5),
    Range(1e6, 1e-5),
    Range(1e7, 0.7e-6),
    Range(1e8, 0.7e-6),
)


class Keithley2000(Multimeter):
    """The meter; its options are those of `Ohmmeter`."""

    RANGES: ClassVar[Sequence[Range]] = RANGES
    IDENTITY: ClassVar[str] = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,{},{}"
    REVISION: ClassVar[str] = "A20  /A02"
    BAUDRATE: ClassVar[float] = 19200.0
    FUNCTIONS: ClassVar[Collection[str]] = FUNCTIONS
    FIRST_FUNCTION: ClassVar[str] = "VOLT:DC"
    TRIGGER: ClassVar[tuple[str, ...]] = ("TRIG:",)
    NAN_TEXT: ClassVar[str] = "+9.91000000E+37"

    def averaged(self) -> int:
        """As its filter is set, a repeating one."""
        of_function = self.function + ":"
        return int(self.settings[of_function + "AVER:COUN"]) if self.settings[of_function + "AVER:STAT"] else 1

    def _prepare(self) -> None:
        define_commands(self._tree, self)
        self.reset()

    def default_settings(self) -> dict[str, float | str]:
        """Every setting at its `*RST` value, NPLC 1 among them."""
        return default_settings()
