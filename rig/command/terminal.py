"""The output of a verb: lines for people, JSON with --json, and a line of progress."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.control.decision import Onlooker, Phases, Tick
from rig.core.file_writing import write_text
from rig.core.streams import PatientLine, TerminalLine
from rig.daemon.status_text import clock, number, phase_line, resistance, shown_drive

if TYPE_CHECKING:
    from rig.core.reading import Reading


class Terminal:
    """Prints lines for people, on stderr if stdout belongs to --json."""

    def __init__(self, json_target: str | None) -> None:
        self._json = json_target
        self._stream = sys.stderr if json_target == "-" else sys.stdout
        self._line: PatientLine | None = None

    def print(self, text: str) -> None:
        if self._line is not None:
            self._line.clear()
        print(text, file=self._stream, flush=True)

    def write_json(self, value: Any) -> None:
        from rig.records.run_folder import plain_json  # with numpy, which a process behind its guard does without

        if self._json == "-":
            print(plain_json(value), flush=True)
        elif self._json is not None:
            write_text(Path(self._json), plain_json(value) + "\n")

    @contextmanager
    def progress(self, virtual: bool = False) -> Iterator[Progress | None]:
        """Show a line with the progress of an experiment; none if time is simulated and stderr is no terminal."""
        if virtual and not sys.stderr.isatty():
            yield None
            return
        self._line = PatientLine(TerminalLine(sys.stderr))
        try:
            yield Progress(self._line, virtual)
        finally:
            self._line.clear()
            self._line = None


def to_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class Progress(Onlooker):
    """Shows the progress of an experiment in a line. virtual: True if its time is simulated, which the line then
    says."""

    def __init__(self, line: TerminalLine | PatientLine, virtual: bool = False) -> None:
        self._line, self._about = line, "a simulated" if virtual else "about"
        self._coming: Phases = []
        self._now = ("", 0.0, 0.0)  # the phase that runs: its name, seconds done, seconds in all
        self._before_s = self._run_s = 0.0  # of the runs before this one; of this one
        self._drive_unit, self._quantity = "A", "resistance_ohm"

    def expect(self, phases: Phases, drive_unit: str, quantity: str) -> None:
        self._coming = list(phases)
        self._drive_unit, self._quantity = drive_unit, quantity

    def phase(self, name: str, done_s: float, of_s: float) -> None:
        """Take how far a phase is; those that were expected before it are over."""
        from rig.experiment.feasibility import still_to_come  # loaded by the experiment that calls

        if done_s == 0.0:
            self._coming = still_to_come(self._coming, name)
        self._now = (name, done_s, of_s)

    def tick(self, tick: Tick) -> None:
        if tick.time_s < self._run_s:
            self._before_s += self._run_s
        self._run_s = tick.time_s
        if self._line.due():
            self._line.show(self.in_words(tick))

    @property
    def elapsed_s(self) -> float:
        return self._before_s + self._run_s

    @property
    def to_go_s(self) -> float:
        """Time left of this phase, and expected after it, s."""
        _, done_s, of_s = self._now
        return max(of_s - done_s, 0.0) + sum(seconds for _, seconds in self._coming)

    def in_words(self, tick: Tick) -> str:
        film = [self._film(_value(tick.resistance))] if self._quantity else []
        readings = number(_value(tick.temperature), "degC", 2), *film, shown_drive(tick.current_A, self._drive_unit)
        return phase_line(tick.phase, self.elapsed_s, self.to_go_s, readings, self._about)

    def _film(self, value: float) -> str:
        if self._quantity == "resistance_ohm":
            return resistance(value)
        return f"{value:.4g} {self._quantity.partition('_')[2]}" if math.isfinite(value) else "-"


def _value(reading: Reading | None) -> float:
    return reading.value if reading is not None and reading.is_number else math.nan


class CaseProgress:
    """Context with a line on stderr: how many of many cases are done."""

    def __enter__(self) -> CaseProgress:
        self._line = TerminalLine(sys.stderr)
        self._began_s = time.monotonic()
        self._first: int | None = None  # done before the first one ended: those took no time of this command
        return self

    def __exit__(self, *_: object) -> None:
        self._line.clear()

    def show(self, done: int, of: int) -> None:
        if self._first is None:
            self._first = done - 1
        since_s = time.monotonic() - self._began_s
        if self._line.due() or done == of:
            to_go_s = since_s * (of - done) / max(done - self._first, 1)
            self._line.show(f"{done} of {of} cases   {clock(since_s)}, {clock(to_go_s)} to go")

    def clear(self) -> None:
        """Clear the line, so that what is printed next begins a line of its own."""
        self._line.clear()

    def print(self, text: str) -> None:
        self.clear()
        print(text, file=sys.stderr, flush=True)
