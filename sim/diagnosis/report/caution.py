"""One warning of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Caution:
    """code, and from when to when (s, as the record's file has it; None: all of it); record: which one of several,
    from 1 on, None: all of them, or the only one."""

    code: str
    text: str
    from_s: float | None = None
    to_s: float | None = None
    record: int | None = None

    def document(self) -> dict[str, Any]:
        """As in the JSON."""
        when = {"record": self.record, "from_s": self.from_s, "to_s": self.to_s}
        return {"code": self.code, **when, "text": self.text}
