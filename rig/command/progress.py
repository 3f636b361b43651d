"""How far `run` and `calibrate` are, in one line: phase, time, total, time to go, temperature, resistance, current."""

from __future__ import annotations

import math

from rig.control.decision import Tick
from rig.core.reading import Reading
from rig.core.terminal_line import PatientLine, TerminalLine
from rig.daemon.status_text import clock, number, resistance
from rig.drivers.controller import OF_FULL_DRIVE
from rig.experiment.expected import Phases, still_to_come


class Progress:
    """An onlooker (`rig.experiment.expected`) that shows in a line how far an experiment is. virtual: in simulated
    time, which passes faster than the user's, and is called so."""

    def __init__(self, line: TerminalLine | PatientLine, virtual: bool = False) -> None:
        self._line, self._about = line, "a simulated" if virtual else "about"
        self._coming: Phases = []
        self._now = ("", 0.0, 0.0)  # the phase that runs: its name, seconds done, seconds in all
        self._before_s = self._run_s = 0.0  # of the runs before this one; of this one
        self._drive_unit, self._quantity = "A", "resistance_ohm"

    def expect(self, phases: Phases, drive_unit: str, quantity: str) -> None:
        """The phases to come. drive_unit: "A", or a heater's; quantity: the meter's column, "" where there is none."""
        self._coming = list(phases)
        self._drive_unit, self._quantity = drive_unit, quantity

    def phase(self, name: str, done_s: float, of_s: float) -> None:
        """A phase goes on; those that were expected before it are over."""
        if done_s == 0.0:
            self._coming = still_to_come(self._coming, name)
        self._now = (name, done_s, of_s)

    def tick(self, tick: Tick) -> None:
        """Show where it is, if that is due."""
        if tick.time_s < self._run_s:
            self._before_s += self._run_s
        self._run_s = tick.time_s
        if self._line.due():
            self._line.show(self.in_words(tick))

    @property
    def elapsed_s(self) -> float:
        """Since the first run began, s."""
        return self._before_s + self._run_s

    @property
    def to_go_s(self) -> float:
        """What is left of this phase, and what is expected after it, s."""
        _, done_s, of_s = self._now
        return max(of_s - done_s, 0.0) + sum(seconds for _, seconds in self._coming)

    def in_words(self, tick: Tick) -> str:
        """The line."""
        total = f"{clock(self.elapsed_s)} of {self._about} {clock(self.elapsed_s + self.to_go_s)}"
        parts = [f"{tick.phase:<9} {total}, {clock(self.to_go_s)} to go", number(_value(tick.temperature), "degC", 2)]
        if self._quantity:
            parts.append(self._film(_value(tick.resistance)))
        digits = 3 if self._drive_unit == OF_FULL_DRIVE else 2
        return "   ".join([*parts, number(tick.current_A, self._drive_unit, digits)])

    def _film(self, value: float) -> str:
        if self._quantity == "resistance_ohm":
            return resistance(value)
        return f"{value:.4g} {self._quantity.partition('_')[2]}" if math.isfinite(value) else "-"


def _value(reading: Reading | None) -> float:
    return reading.value if reading is not None and reading.is_number else math.nan
