"""What stays until somebody resets it with a reason: a trip with the rows around it, or a STOP."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

# of a trip, kept with it: at one to ten rows a second what led to it, and what became of it
ROWS_BEFORE, ROWS_AFTER = 40, 20
CLEAR, STOPPED, TRIPPED = "clear", "stopped", "tripped"
UNKNOWN = "what was latched is not known: look at the bench before you reset it"


@dataclass(frozen=True)
class Kept:
    """What the latch's file says. state: CLEAR, STOPPED or TRIPPED; text: why, also why it is clear; at_s: Unix s."""

    state: str
    cause: str
    text: str
    at_s: float


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

    def kept(self) -> Kept:
        """As the latch's file keeps it: without the rows."""
        return Kept(self.state, self.cause, self.text, self.at_s)

    def take(self, row: dict[str, Any]) -> bool:
        """A row after the trip; True when the last one that is kept has come."""
        if self.after >= ROWS_AFTER:
            return False
        self.rows.append(row)
        self.after += 1
        return self.after == ROWS_AFTER

    def recall(self, number: int, document: dict[str, Any]) -> None:
        """The rows of this trip, which the history has under a number."""
        self.number, self.rows, self.after = number, list(document.get("rows", [])), ROWS_AFTER


def tripped(cause: str, text: str, at_s: float, recent: deque[dict[str, Any]]) -> Latch:
    """A trip with the rows before it."""
    return Latch(TRIPPED, cause, text, at_s, list(recent)[-ROWS_BEFORE:])


def not_known(why: str, at_s: float) -> Latch:
    """A trip because what was latched cannot be found out. at_s: when that was noticed."""
    return Latch(TRIPPED, "latch", f"{why}; {UNKNOWN}", at_s)


def after_restart(kept: Kept) -> Latch | None:
    """What was latched before and nobody has cleared: a restart does not clear it either."""
    return None if kept.state == CLEAR else Latch(kept.state, kept.cause, kept.text, kept.at_s, after=ROWS_AFTER)


def of_history(number: int, document: dict[str, Any]) -> Latch | None:
    """The last trip of a history from before the latch had a file, where nobody has cleared it."""
    if document.get("cleared_s") is not None:
        return None
    latch = Latch(TRIPPED, *(document[key] for key in ("cause", "text", "at_s")))
    latch.recall(number, document)
    return latch
