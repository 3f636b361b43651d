"""Stretches of time in which nobody read the instruments: counted, so that a record says what it does not hold."""

from __future__ import annotations

from typing import Any


class Gaps:
    """Gaps between completed control cycles since `begin_s`, by a clock that does not jump."""

    def __init__(self, begin_s: float) -> None:
        self._last_s = begin_s
        self._count = 0
        self._longest_s = self._total_s = 0.0

    def cycle(self, now_s: float, longest_s: float) -> None:
        """A control cycle was completed; more than longest_s since the one before is a gap."""
        between_s, self._last_s = now_s - self._last_s, now_s
        if between_s > longest_s:
            self._count += 1
            self._total_s += between_s
            self._longest_s = max(self._longest_s, between_s)

    def table(self) -> dict[str, Any]:
        """As `state` shows it."""
        return {"count": self._count, "longest_s": self._longest_s, "total_s": self._total_s}
