"""Resistance ranges of a SCPI meter: each has its test current, and autorange goes from one to the next.

With autorange a reading beyond `OVERRANGE` or below `UNDERRANGE` of the range's full scale is thrown away, and the
next range measures again. The plant is told of every change of the test current.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan
from typing import ClassVar

from sim.instruments.instrument import Plant
from sim.instruments.triggered import TriggeredInstrument

RESISTANCES = ("RES", "FRES")


@dataclass(frozen=True, slots=True)
class Range:
    """A resistance range: full scale, ohm, and its fixed test current, A."""

    full_scale_ohm: float
    test_current_A: float


class Ohmmeter(TriggeredInstrument):
    """A meter with `settings` by short name, one `function` at a time. line_frequency_Hz: NPLC counts its periods."""

    OVERRANGE: ClassVar[float] = 1.2
    UNDERRANGE: ClassVar[float] = 0.1

    def __init__(
        self,
        plant: Plant,
        *,
        ranges: Sequence[Range],
        byte_s: float,
        terminator: bytes,
        command_s: float,
        overhead_s: float,
        line_frequency_Hz: float,
        start_s: float,
    ) -> None:
        super().__init__(
            plant, byte_s=byte_s, terminator=terminator, command_s=command_s, overhead_s=overhead_s, start_s=start_s
        )
        self._ranges = ranges
        self._range_index = min(1, len(ranges) - 1)
        self._line_period_s = 1.0 / line_frequency_Hz
        self.settings: dict[str, float | str] = {}
        self.function = ""

    @property
    def measures_resistance(self) -> bool:
        """Whether a resistance function is chosen."""
        return self.function in RESISTANCES

    @property
    def full_scale_ohm(self) -> float:
        """Full scale of the resistance range in use."""
        return self._ranges[self._range_index].full_scale_ohm

    @property
    def test_current_A(self) -> float:
        """What flows through the film now, A; it flows as long as a resistance function is chosen."""
        return self._ranges[self._range_index].test_current_A if self.measures_resistance else 0.0

    def aperture_s(self) -> float:
        """NPLC line periods."""
        return float(self.settings[self.function + ":NPLC"]) * self._line_period_s

    def trigger_delay_s(self) -> float:
        """As set."""
        return float(self.settings["TRIG:DEL"])

    def choose_range(self, resistance_ohm: float) -> None:
        """The lowest range that still shows `resistance_ohm`; the plant is told the test current."""
        for index, candidate in enumerate(self._ranges):
            if resistance_ohm <= self.OVERRANGE * candidate.full_scale_ohm:
                self._use_range(index)
                return
        self._use_range(len(self._ranges) - 1)

    def _use_range(self, index: int) -> None:
        self._range_index = index
        self.tell_test_current()

    def tell_test_current(self) -> None:
        """Let the plant know what flows through the film from now on."""
        self._plant.set_test_current_A(self.test_current_A)

    def sample_ohm(self) -> float | None:
        """The film's resistance, ohm; +-inf beyond the range, nan where there is none; None: another range now."""
        now = self._ranges[self._range_index]
        value_ohm = self._plant.read_resistance_ohm(now.test_current_A)
        if isnan(value_ohm):
            return value_ohm
        over = abs(value_ohm) > self.OVERRANGE * now.full_scale_ohm
        if self.settings[self.function + ":RANG:AUTO"]:
            if over and value_ohm > 0.0 and self._range_index + 1 < len(self._ranges):
                self._use_range(self._range_index + 1)
                return None
            if abs(value_ohm) < self.UNDERRANGE * now.full_scale_ohm and self._range_index > 0:
                self._use_range(self._range_index - 1)
                return None
        if over:
            return inf if value_ohm > 0.0 else -inf
        return value_ohm
