"""How far many cases are, in a line: how many, since when, how long still."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from rig.core.terminal_line import TerminalLine
from rig.daemon.status_text import clock


class ManyProgress:
    """A line on stderr for the time of a context."""

    def __enter__(self) -> ManyProgress:
        self._line = TerminalLine(sys.stderr)
        self._began_s = time.monotonic()
        self._first: int | None = None  # done when the first was told: those of an earlier time took none of this one
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.clear()

    def show(self, done: int, of: int) -> None:
        """So many of so many have ended."""
        if self._first is None:
            self._first = done - 1
        since_s = time.monotonic() - self._began_s
        if self._line.due() or done == of:
            to_go_s = since_s * (of - done) / max(done - self._first, 1)
            self._line.show(f"{done} of {of} cases   {clock(since_s)}, {clock(to_go_s)} to go")

    def clear(self) -> None:
        """Nothing is shown any more; what is printed next begins a line of its own."""
        self._line.clear()

    def say(self, text: str) -> None:
        """A line that stays."""
        self.clear()
        print(text, file=sys.stderr, flush=True)
