"""How long a diagnosis may take: begun in time is whatever a part of it does next, and nothing is cut off in between.

The search may take the first part of the time, the judging of what it found the next; figures and limits take the rest.
A single fit is not interrupted: with 50,000 rows it may take some seconds beyond.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeVar

SEARCHING: Final = 0.6  # of the time: a search without it took 0.5 to 0.7 of a diagnosis
JUDGING: Final = 0.85  # the same, when judging ends
T = TypeVar("T")


def stopped() -> float:
    """A clock of whoever has time: it does not go."""
    return 0.0


@dataclass(frozen=True)
class Budget:
    """seconds: from `began_s` on that clock."""

    seconds: float = math.inf
    clock: Callable[[], float] = stopped
    began_s: float = 0.0

    def over(self, share: float = 1.0) -> bool:
        """Whether this share of the time has passed."""
        return self.clock() - self.began_s >= share * self.seconds

    def in_time(self, items: Iterable[T], share: float = SEARCHING) -> Iterator[T]:
        """The items, as long as this share of the time has not passed."""
        for item in items:
            if self.over(share):
                return
            yield item
