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

JUMP_S = 5.0  # between two rows: more than a time server's slewing or a busy computer causes
STEADY_S = 3600.0  # without a jump: a clock that was set wrong is noticed by then
CATCH_UP = 10.0  # a bench that runs a tenth of the time keeps up


class AgingClock:
    """The aging clock of the history that is being written; the history keeps it over restarts. aged_s: None in a new
    history before its first row."""

    def __init__(self) -> None:
        self.aged_s: float | None = None
        self._last: tuple[float, float] | None = None  # label and monotonic time of the last row
        self._even_s = 0.0  # since the last jump
        self._last_label_s: float | None = None  # of the row before the history was opened

    def begin(self, aged_s: float | None, last_label_s: float | None) -> None:
        """Take over the aging clock of an opened history, and the label of its last row; None if it has none."""
        self._last_label_s = last_label_s
        begin_s = aged_s if aged_s is not None else last_label_s
        self.aged_s = begin_s if begin_s is not None else self.aged_s

    def row(self, wall_s: float, clock_s: float) -> float:
        """Advance to a row, labelled wall_s and taken at the monotonic clock_s; return by how much the time of day
        jumped before it (s): by how much more it advanced than time passed, or 0 for less than a jump."""
        before, self._last = self._last, (wall_s, clock_s)
        aged_s = wall_s if self.aged_s is None else self.aged_s
        if before is None:
            self.aged_s = aged_s
            back_s = 0.0 if self._last_label_s is None else wall_s - self._last_label_s
            return back_s if back_s < -JUMP_S else 0.0  # forward is no jump: the daemon was not running
        passed_s = max(0.0, clock_s - before[1])
        jumped_s = (wall_s - before[0]) - (clock_s - before[1])
        jumped_s = jumped_s if abs(jumped_s) > JUMP_S else 0.0
        self._even_s = 0.0 if jumped_s else self._even_s + passed_s
        back_s, forth_s = 0.0, passed_s
        if self._even_s >= STEADY_S:
            back_s = forth_s = CATCH_UP * passed_s
        self.aged_s = aged_s + min(max(wall_s - aged_s, -back_s), forth_s)
        return jumped_s
