"""Other records of the same rig in two halves, so that the rows that decide a name are not those that judge it.

Of several records every other one; of a single one alternate blocks, as long as what is left of its prediction hangs
together: a shorter one would say what its neighbours say. Blocks and no halves in time: a heat sink shows late in a
record, and its first half would not know of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from sim.diagnosis.data.record import BLOCKS, Mask, Record
from sim.inference.nuisance import told_rows

FEWEST_BLOCKS: Final = 6  # three of each half: an effect that shows in one part of a record is then in both


@dataclass(frozen=True, eq=False)
class Halves:
    """first, second: of each record its rows in that half, without those to which what belongs to it is fitted;
    decided: whether names were asked of them; first_judges, second_judges: whether the names are those that the other
    half alone leaves. Where neither does, both decided, and what is measured on them is optimistic. refused: names that
    one half speaks against and the other does not; overruled: those of them that all rows together need."""

    others: tuple[Record, ...]
    first: tuple[Mask, ...]
    second: tuple[Mask, ...]
    decided: bool = False
    first_judges: bool = True
    second_judges: bool = True
    refused: frozenset[str] = frozenset()
    overruled: frozenset[str] = frozenset()

    def judged_by(
        self, first: bool, second: bool, refused: frozenset[str], overruled: frozenset[str] = frozenset()
    ) -> Halves:
        """The same after names were decided by them, with what judges."""
        return replace(
            self, decided=True, first_judges=first, second_judges=second, refused=refused, overruled=overruled
        )

    @property
    def judging(self) -> list[Mask]:
        """Of each record the rows on which gain and error are measured."""
        both = not (self.first_judges or self.second_judges)
        parts = zip(self.first, self.second, strict=True)
        return [(a & (self.first_judges or both)) | (b & (self.second_judges or both)) for a, b in parts]

    @property
    def folds(self) -> list[dict[str, int]]:
        """Of each fold how many rows decided, and how many judged."""
        if not self.decided:
            return [{"deciding": 0, "judging": sum(int(np.sum(rows)) for rows in self.judging)}]
        a, b = (sum(int(np.sum(rows)) for rows in half) for half in (self.first, self.second))
        folds = [{"deciding": a, "judging": b}] * self.second_judges
        folds += [{"deciding": b, "judging": a}] * self.first_judges
        return folds or [{"deciding": a + b, "judging": 0}]

    def document(self) -> list[dict[str, Any]]:
        """Which rows of which record (the first one given is 1) are in which half, in the time of its file."""
        found = []
        for k, other in enumerate(self.others):
            half = np.where(self.first[k], 1, np.where(self.second[k], 2, 0))
            edges = np.flatnonzero(np.diff(half, prepend=-1, append=-1))
            for begin, end in itertools.pairwise(edges):
                if half[begin]:
                    time = other.file_s[[begin, end - 1]].tolist()
                    found.append({"record": k + 1, "half": int(half[begin]), "from_s": time[0], "to_s": time[1]})
        return found


def halves_of(others: Sequence[Record], correlated_s: Sequence[float]) -> Halves:
    """correlated_s: of each record, how long what is left of its prediction hangs together."""
    first, second = [], []
    for k, other in enumerate(others):
        left = ~told_rows(other)
        odd = np.full(other.rows, k % 2 == 1) if len(others) > 1 else _odd_blocks(other, left, correlated_s[k])
        first.append(left & ~odd)
        second.append(left & odd)
    return Halves(tuple(others), tuple(first), tuple(second))


def _odd_blocks(other: Record, left: Mask, correlated_s: float) -> Mask:
    begin = float(other.time_s[np.argmax(left)])
    span = max(float(other.time_s[-1]) - begin, other.interval_s)
    length = min(max(correlated_s, span / BLOCKS), span / FEWEST_BLOCKS)
    return np.asarray((other.time_s - begin) // (length * (1.0 + 1e-12)) % 2 == 1)
