"""What stays until somebody resets it with a reason: a trip with the rows around it, or a STOP."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

ROWS_BEFORE, ROWS_AFTER = 40, 20
STOPPED, TRIPPED = "stopped", "tripped"


@dataclass
class Latch:
    """state: STOPPED or TRIPPED; at_s: Unix seconds; number: of the trip in the history, None until it is written."""

    state: str
    cause: str
    text: str
    at_s: float
    rows: list[dict[str, Any]] = field(default_factory=list)
    number: int | None = None
    cleared_s: float | None = None
    cleared_because: str | None = None
    after: int = 0

    def table(self) -> dict[str, Any]:
        """As `state` shows it."""
        return {"cause": self.cause, "text": self.text, "at_s": self.at_s, "rows": len(self.rows)}

    def document(self) -> dict[str, Any]:
        """As the history keeps it."""
        told = {"rows": self.rows, "cleared_s": self.cleared_s, "cleared_because": self.cleared_because}
        return {**self.table(), **told, "state": self.state}

    def take(self, row: dict[str, Any]) -> bool:
        """A row after the trip; True when the last one that is kept has come."""
        if self.after >= ROWS_AFTER:
            return False
        self.rows.append(row)
        self.after += 1
        return self.after == ROWS_AFTER


def tripped(cause: str, text: str, at_s: float, recent: deque[dict[str, Any]]) -> Latch:
    """A trip with the rows before it."""
    return Latch(TRIPPED, cause, text, at_s, list(recent)[-ROWS_BEFORE:])


def after_restart(document: dict[str, Any], number: int) -> Latch | None:
    """A trip of before that nobody has cleared: a restart does not clear it either."""
    if document.get("cleared_s") is not None:
        return None
    known = {key: document[key] for key in ("state", "cause", "text", "at_s", "rows")}
    return Latch(**known, number=number, after=ROWS_AFTER)
