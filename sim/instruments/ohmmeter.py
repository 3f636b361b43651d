"""Resistance and voltage ranges of a SCPI meter.

Each resistance range has its test current, and autorange goes from one to the next: a reading beyond `OVERRANGE` or
below `UNDERRANGE` of the range's full scale is thrown away, and the next range measures again. The plant is told of
every change of the test current. A voltage range is only a limit on what is shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, inf, isnan
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
    """A meter with `settings` by short name, one `function` at a time.

    ranges: of resistance. baudrate: of the line, 1/s; inf takes no time. overhead_s: from the end of an integration
    until its reading is there. line_frequency_Hz: NPLC counts its periods. What is None is as the class says.
    """

    RANGES: ClassVar[Sequence[Range]]
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.1, 1.0, 10.0, 100.0, 1000.0)
    IDENTITY: ClassVar[str]
    SERIAL_NUMBER: ClassVar[str] = "1234567"
    REVISION: ClassVar[str]
    BAUDRATE: ClassVar[float]
    BITS_PER_CHARACTER: ClassVar[float] = 10.0
    TERMINATOR: ClassVar[bytes] = b"\n"
    OVERRANGE: ClassVar[float] = 1.2
    UNDERRANGE: ClassVar[float] = 0.1

    def __init__(
        self,
        plant: Plant,
        *,
        ranges: Sequence[Range] | None = None,
        serial_number: str | None = None,
        revision: str | None = None,
        baudrate: float | None = None,
        terminator: bytes | None = None,
        command_s: float = 0.002,
        overhead_s: float = 0.004,
        line_frequency_Hz: float = 50.0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(
            plant,
            byte_s=self.BITS_PER_CHARACTER / (self.BAUDRATE if baudrate is None else baudrate),
            terminator=self.TERMINATOR if terminator is None else terminator,
            command_s=command_s,
            overhead_s=overhead_s,
            start_s=start_s,
        )
        self._ranges = self.RANGES if ranges is None else ranges
        self._range_index = min(1, len(self._ranges) - 1)
        self._line_period_s = 1.0 / line_frequency_Hz
        self.settings: dict[str, float | str] = {}
        self.function = ""
        number = self.SERIAL_NUMBER if serial_number is None else serial_number
        self.identity = self.IDENTITY.format(number, self.REVISION if revision is None else revision)
        self._prepare()

    def _prepare(self) -> None:
        """Commands, and the state after power on."""
        raise NotImplementedError

    def reset(self) -> None:
        """`*RST`."""
        raise NotImplementedError

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

    def voltage_range_V(self, voltage_V: float) -> float:
        """The lowest voltage range that still shows `voltage_V`."""
        return next((full for full in self.VOLTAGE_RANGES_V if voltage_V <= full), self.VOLTAGE_RANGES_V[-1])

    def sample_V(self) -> float:
        """The voltage at the input, V; +-inf beyond the range."""
        voltage_V = self._plant.read_voltage_V()
        automatic = self.settings[self.function + ":RANG:AUTO"]
        full_V = self.VOLTAGE_RANGES_V[-1] if automatic else float(self.settings[self.function + ":RANG"])
        return copysign(inf, voltage_V) if abs(voltage_V) > self.OVERRANGE * full_V else voltage_V
