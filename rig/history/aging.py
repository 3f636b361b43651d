"""The clock by which the history grows old: it follows the time of day, but not where that jumps.

Rows are labelled with the time of day, which somebody may set, or a time server, or a flat battery. What is deleted is
gone, so age is not taken from the labels alone:

- the aged clock advances by the time that has really passed, as the monotonic clock counts it;
- where the time of day is elsewhere (the computer was off, or its clock is wrong) the aged clock goes after it, but
  only once the time of day has run evenly for STEADY_S, and CATCH_UP times as fast as time passes.

A clock that is wrong by years for a minute therefore deletes nothing. One that is wrong for a day ages the history by
ten. After 30 days in a drawer a bench is up to date again after three days and a half of running.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

JUMP_S = 5.0  # between two rows: more than a time server's slewing or a busy computer brings about
STEADY_S = 3600.0  # of an even course: somebody who has set the clock wrong, or a server that is, is noticed by then
CATCH_UP = 10.0  # a bench that is on a tenth of the time keeps up


@dataclass(frozen=True)
class Age:
    """aged_s: the aged clock; wall_s, clock_s: the last row's label and monotonic time; even_s: since the last jump."""

    aged_s: float
    wall_s: float
    clock_s: float
    even_s: float = 0.0


def jump_s(age: Age, wall_s: float, clock_s: float) -> float:
    """By how much the time of day advanced more than time passed; 0 where that is no jump."""
    found = (wall_s - age.wall_s) - (clock_s - age.clock_s)
    return found if abs(found) > JUMP_S else 0.0


def followed(age: Age, wall_s: float, clock_s: float) -> Age:
    """The clock at the next row, labelled wall_s and taken at clock_s."""
    passed_s = max(0.0, clock_s - age.clock_s)
    even_s = 0.0 if jump_s(age, wall_s, clock_s) else age.even_s + passed_s
    trusted = even_s >= STEADY_S
    forth_s = CATCH_UP * passed_s if trusted else passed_s
    back_s = CATCH_UP * passed_s if trusted else 0.0
    step_s = min(max(wall_s - age.aged_s, -back_s), forth_s)
    return replace(age, aged_s=age.aged_s + step_s, wall_s=wall_s, clock_s=clock_s, even_s=even_s)


class AgedClock:
    """The aged clock of a history that is being written, over restarts: what it said last is in the history."""

    def __init__(self) -> None:
        self._age: Age | None = None  # at the last row
        self._begin_s: float | None = None
        self._last_label_s: float | None = None

    def begin(self, aged_s: float | None, last_label_s: float | None) -> None:
        """A history was opened: where its aged clock was, and the label of its last row; None where it has none."""
        self._begin_s = aged_s if aged_s is not None else last_label_s
        self._last_label_s = last_label_s
        if self._age is not None and self._begin_s is not None:
            self._age = replace(self._age, aged_s=self._begin_s)

    def row(self, wall_s: float, clock_s: float) -> float:
        """A row, labelled wall_s and taken at clock_s: by how much the time of day jumped before it, else 0."""
        if self._age is None:
            self._age = Age(wall_s if self._begin_s is None else self._begin_s, wall_s, clock_s)
            back_s = 0.0 if self._last_label_s is None else wall_s - self._last_label_s
            return back_s if back_s < -JUMP_S else 0.0  # forward: the daemon was not there for a while
        jumped_s = jump_s(self._age, wall_s, clock_s)
        self._age = followed(self._age, wall_s, clock_s)
        return jumped_s

    def aged_s(self) -> float | None:
        """What it says; None before the first row."""
        return self._age.aged_s if self._age is not None else None
