"""Keithley 2000 multimeter as an ohmmeter, byte by byte: bytes and times in, bytes and times out.

Sources: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63; the command set as PyMeasure and QCoDeS use it.
NOT verified on an instrument: test currents, overhead times, digits of a reading (all are parameters).

A command acts `command_s` after its terminator (CR, LF or both) has arrived. A reading integrates NPLC line
periods and samples the film in the middle; `overhead_s` later it is there. Commands wait while a query
waits for its reading. With autorange a reading beyond 120 % or below 10 % of the range is thrown away, and
the next range measures again. The test current flows as long as a resistance function is chosen. ^C and ^X
abort, and discard what is pending. Other functions than resistance can be chosen and set, and read 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isinf, isnan

from sim.instruments.instrument import Plant
from sim.instruments.keithley2000_commands import FUNCTIONS, default_settings, define_commands
from sim.instruments.ohmmeter import RESISTANCES, Ohmmeter, Range
from sim.instruments.scpi import ScpiError

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
OVERFLOW_TEXT = "+9.90000000E+37"
NAN_TEXT = "+9.91000000E+37"


class Keithley2000(Ohmmeter):
    """The meter.

    baudrate: of the line, 1/s; inf takes no time. line_frequency_Hz: NPLC counts its periods.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        ranges: Sequence[Range] = RANGES,
        serial_number: str = "1234567",
        revision: str = "A20  /A02",
        baudrate: float = 19200.0,
        terminator: bytes = b"\n",
        command_s: float = 0.002,
        overhead_s: float = 0.004,
        line_frequency_Hz: float = 50.0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(
            plant,
            ranges=ranges,
            byte_s=10.0 / baudrate,
            terminator=terminator,
            command_s=command_s,
            overhead_s=overhead_s,
            line_frequency_Hz=line_frequency_Hz,
            start_s=start_s,
        )
        self.identity = f"KEITHLEY INSTRUMENTS INC.,MODEL 2000,{serial_number},{revision}"
        define_commands(self._tree, self)
        self.reset()

    def choose_function(self, function: str) -> None:
        """Measure something else; the test current flows in the resistance functions only."""
        if function not in FUNCTIONS:
            raise ScpiError(-224, "Illegal parameter value")
        self.function = function
        self.tell_test_current()

    def digitize(self) -> str:
        """The film's resistance as text; empty where autorange has changed the range."""
        if not self.measures_resistance:
            return "+0.00000000E+00"
        value_ohm = self.sample_ohm()
        if value_ohm is None:
            return ""
        if isnan(value_ohm):
            return NAN_TEXT
        if isinf(value_ohm):
            return OVERFLOW_TEXT if value_ohm > 0 else "-" + OVERFLOW_TEXT[1:]
        return "%+.8E" % value_ohm  # noqa: UP031 - half the time of an f-string

    def reset(self) -> None:
        """`*RST`: DC volts, autorange, NPLC 1, one reading a trigger; the error queue stays."""
        self.abort()
        self.settings = default_settings()
        self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function("VOLT:DC")

    def configure(self, function: str) -> None:
        """`CONFigure`: that function's settings at their defaults, and one reading a trigger."""
        self.abort()
        defaults: Mapping[str, float | str] = default_settings()
        for name, value in defaults.items():
            if name.startswith((function + ":", "TRIG:")):
                self.settings[name] = value
        if function in RESISTANCES:
            self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function(function)
