"""A bench multimeter: one function at a time, of which resistance and DC voltage are measured; the others read 0.

The two that are emulated differ in their commands, their texts for beyond the range, and how they keep readings.
"""

from __future__ import annotations

from collections.abc import Collection
from math import isinf, isnan
from typing import ClassVar

from sim.instruments.ohmmeter import RESISTANCES, Ohmmeter
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, ScpiError

VOLTAGES = ("VOLT", "VOLT:DC")
OVERFLOW_TEXT, ZERO_TEXT = "+9.90000000E+37", "+0.00000000E+00"


class Multimeter(Ohmmeter):
    """FUNCTIONS: as the meter names them, the first being that of `*RST`. TRIGGER: settings that CONFigure resets.

    NAN_TEXT: what it says where there is no number.
    """

    FUNCTIONS: ClassVar[Collection[str]]
    FIRST_FUNCTION: ClassVar[str]
    TRIGGER: ClassVar[tuple[str, ...]]
    NAN_TEXT: ClassVar[str]

    def default_settings(self) -> dict[str, float | str]:
        """Every setting at its `*RST` value, by short name."""
        raise NotImplementedError

    def choose_function(self, function: str) -> None:
        """Measure something else; the test current flows in the resistance functions only."""
        if function not in self.FUNCTIONS:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        self.function = function
        self.tell_test_current()

    def digitize(self) -> str:
        """What is measured now, as text; empty where autorange has changed the range."""
        if self.measures_resistance:
            value = self.sample_ohm()
            if value is None:
                return ""
        elif self.function in VOLTAGES:
            value = self.sample_V()
        else:
            return ZERO_TEXT
        value = self.filtered(value)
        if isnan(value):
            return self.NAN_TEXT
        if isinf(value):
            return OVERFLOW_TEXT if value > 0 else "-" + OVERFLOW_TEXT[1:]
        return "%+.8E" % value  # noqa: UP031 - half the time of an f-string

    def reset(self) -> None:
        """`*RST`: DC volts, autorange, one reading a trigger; the error queue stays."""
        self.abort()
        self.settings = self.default_settings()
        self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function(self.FIRST_FUNCTION)

    def configure(self, function: str) -> None:
        """`CONFigure`: that function's settings at their defaults, and one reading a trigger."""
        self.abort()
        for name, value in self.default_settings().items():
            if name.startswith((function + ":", *self.TRIGGER)):
                self.settings[name] = value
        if function in RESISTANCES:
            self._range_index = min(1, len(self._ranges) - 1)
        self.choose_function(function)
