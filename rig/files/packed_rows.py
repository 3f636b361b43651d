"""The rows of a run in memory: eight bytes a value, because a hold of a week at 10 Hz has six million rows.

What kind a column is, its first row says: words (kept once each), whole numbers, or numbers. What comes out is what
went in: a number has the same bits, and so the same text.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

BLOCK = 4096  # rows that are made room for at a time: half a megabyte, and no row has to move when there are more


class PackedRows:
    """Rows of `width` values, as tuples; can be appended to, counted, iterated and taken by number."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._count = 0
        self._blocks: list[np.ndarray[Any, np.dtype[np.float64]]] = []
        self._whole: set[int] = set()  # columns of whole numbers
        self._words: dict[int, dict[str, int]] = {}  # of each column of words, with their numbers in the blocks

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        left = self._count
        for block in self._blocks:
            yield from map(self._row, block[:left].tolist())
            left -= BLOCK

    def __getitem__(self, index: int) -> tuple[Any, ...]:
        """The row of that number, or counted from the end. IndexError."""
        at = index + self._count if index < 0 else index
        if not 0 <= at < self._count:
            raise IndexError(index)
        return self._row(self._blocks[at // BLOCK][at % BLOCK].tolist())

    def append(self, values: Sequence[Any]) -> None:
        """One row more. ValueError where it is not as wide as the others."""
        if len(values) != self._width:
            raise ValueError(f"a row of {len(values)} values, expected {self._width}")
        if not self._count:
            self._whole = {k for k, value in enumerate(values) if isinstance(value, int)}
            self._words = {k: {} for k, value in enumerate(values) if isinstance(value, str)}
        packed = list(values)
        for k, words in self._words.items():
            packed[k] = words.setdefault(values[k], len(words))
        block, row = divmod(self._count, BLOCK)
        if block == len(self._blocks):
            self._blocks.append(np.empty((BLOCK, self._width)))
        self._blocks[block][row] = packed
        self._count += 1  # last: a signal's exception in between leaves no half row

    def numbers(self, k: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A column; of words the number of each in `words`."""
        if not self._count:
            return np.empty(0)
        return np.concatenate([block[:, k] for block in self._blocks])[: self._count]

    def words(self, k: int) -> list[str] | None:
        """The words of a column by their numbers, in the order in which they came; None of a column of numbers."""
        return list(self._words[k]) if k in self._words else None

    def column(self, k: int) -> np.ndarray[Any, np.dtype[Any]]:
        """A column as an array of its own kind."""
        numbers, words = self.numbers(k), self.words(k)
        if words is not None:
            return np.take(np.array(words), numbers.astype(np.intp))
        return numbers.astype(np.int64) if k in self._whole and np.all(numbers % 1.0 == 0.0) else numbers

    def _row(self, packed: list[Any]) -> tuple[Any, ...]:
        for k in self._whole:
            if packed[k].is_integer():
                packed[k] = int(packed[k])
        for k, words in self._words.items():
            packed[k] = list(words)[int(packed[k])]
        return tuple(packed)
