"""Faults in what the user gave, one line each: file, place, what is expected. They end with exit status 2.

Faults            a list of lines; str() joins them with newlines
"""

from __future__ import annotations

from collections.abc import Iterable


class Faults(Exception):
    """Bad usage, configuration or data: every fault that was found, a line each."""

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = [line for line in lines if line]
        super().__init__("\n".join(self.lines))


def fault(where: object, place: str, expected: str) -> Faults:
    """Return one fault as `Faults`."""
    return Faults([f"{where}: {place}: {expected}" if place else f"{where}: {expected}"])
