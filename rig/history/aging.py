"""The clock by which the history ages: it follows the time of day without its jumps.

Rows are labelled with the time of day, which a person, a time server or a flat battery may set. Deleted rows are lost,
so the age of a row is not taken from its label alone:

- the aging clock advances with the monotonic clock;
- if it differs from the time of day (the computer was off, or its clock is wrong), it approaches the time of day, but
  only once that has run evenly for STEADY_S, and CATCH_UP times as fast as time passes.

A clock that is wrong by years for a minute therefore deletes nothing; one that is wrong for a day ages the history by
ten. After 30 days in a drawer the clock is up to date again after 3.5 days of running.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

JUMP_S = 5.0  # between two rows: more than a time server's slewing or a busy computer causes
STEADY_S = 3600.0  # without a jump: a clock that was set wrong is noticed by then
CATCH_UP = 10.0  # a bench that runs a tenth of the time keeps up


@dataclass(frozen=True)
class Age:
    """State: aging clock, the last row's label and monotonic time, time since the last jump (s)."""

    aged_s: float
    wall_s: float
    clock_s: float
    even_s: float = 0.0


def jump_s(age: Age, wall_s: float, clock_s: float) -> float:
    """Return by how much more the time of day advanced than time passed (s); 0 for less than a jump."""
    found = (wall_s - age.wall_s) - (clock_s - age.clock_s)
    return found if abs(found) > JUMP_S else 0.0


def followed(age: Age, wall_s: float, clock_s: float) -> Age:
    """Return the state at the next row, labelled wall_s and taken at the monotonic clock_s."""
    passed_s = max(0.0, clock_s - age.clock_s)
    even_s = 0.0 if jump_s(age, wall_s, clock_s) else age.even_s + passed_s
    trusted = even_s >= STEADY_S
    forth_s = CATCH_UP * passed_s if trusted else passed_s
    back_s = CATCH_UP * passed_s if trusted else 0.0
    step_s = min(max(wall_s - age.aged_s, -back_s), forth_s)
    return replace(age, aged_s=age.aged_s + step_s, wall_s=wall_s, clock_s=clock_s, even_s=even_s)


class AgingClock:
    """The aging clock of the history that is being written; the history keeps it over restarts."""

    def __init__(self) -> None:
        self._age: Age | None = None  # at the last row
        self._begin_s: float | None = None
        self._last_label_s: float | None = None

    def begin(self, aged_s: float | None, last_label_s: float | None) -> None:
        """Take over the aging clock of an opened history, and the label of its last row; None if it has none."""
        self._begin_s = aged_s if aged_s is not None else last_label_s
        self._last_label_s = last_label_s
        if self._age is not None and self._begin_s is not None:
            self._age = replace(self._age, aged_s=self._begin_s)

    def row(self, wall_s: float, clock_s: float) -> float:
        """Advance to a row; return by how much the time of day jumped before it (s), or 0."""
        if self._age is None:
            self._age = Age(wall_s if self._begin_s is None else self._begin_s, wall_s, clock_s)
            back_s = 0.0 if self._last_label_s is None else wall_s - self._last_label_s
            return back_s if back_s < -JUMP_S else 0.0  # forward is no jump: the daemon was not running
        jumped_s = jump_s(self._age, wall_s, clock_s)
        self._age = followed(self._age, wall_s, clock_s)
        return jumped_s

    def aged_s(self) -> float | None:
        """Return the aging clock; None before the first row."""
        return self._age.aged_s if self._age is not None else None
