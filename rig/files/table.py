"""A table as a file holds it: names, units below them, columns of fields or numbers, and the line of each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.files.field_numbers import Signs, blank_like


@dataclass(frozen=True, eq=False)
class Column:
    """name: as the file has it, '' where it has none. unit: what stands below the name in a line of units."""

    name: str
    fields: Sequence[str] | Array
    unit: str = ""

    @property
    def numbers(self) -> Array | None:
        """The values, where they are numbers already (a workbook of MATLAB's, arrays of Python's)."""
        return None if isinstance(self.fields, list) else self.fields  # type: ignore[return-value]

    @property
    def texts(self) -> list[str] | None:
        """The fields, where they are text."""
        return self.fields if isinstance(self.fields, list) else None

    def of(self, rows: Sequence[int] | NDArray[np.intp]) -> Column:
        """The column with these rows only, in this order; of a row -1 nothing is known."""
        texts = self.texts
        if texts is not None:
            return replace(self, fields=[texts[k] if k >= 0 else "" for k in rows])
        taken = np.asarray(rows, dtype=np.intp)
        return replace(self, fields=np.where(taken < 0, np.nan, np.asarray(self.fields)[taken]))

    def filled(self) -> NDArray[np.bool_]:
        """The rows in which something stands."""
        if self.texts is not None:
            return np.array([not blank_like(text) for text in self.texts], dtype=np.bool_)
        return np.isfinite(np.asarray(self.fields, dtype=np.float64))


@dataclass(frozen=True, eq=False)
class Table:
    """source: the file. place: where its names are, as 'line 1'. line_of: the line of each row, for messages; row
    counts from 0. named: whether it has names. times: where those come from: the file, a period that was typed, or
    the order of the rows alone. said: what was read as what."""

    source: str
    place: str
    columns: list[Column]
    line_of: Sequence[int]
    row_word: str = "line"
    named: bool = True
    signs: Signs = field(default_factory=Signs)
    said: list[str] = field(default_factory=list)
    times: str = "file"

    def at(self, row: int) -> str:
        """A row's place in words."""
        return f"{self.row_word} {self.line_of[row]}"

    def names(self) -> list[str]:
        """Names as they are told: '#3' for a column without one."""
        return [column.name or f"#{k + 1}" for k, column in enumerate(self.columns)]

    def of(self, rows: Sequence[int] | NDArray[np.intp]) -> Table:
        """The table with these rows only, in this order."""
        lines = [self.line_of[k] for k in rows]
        return replace(self, columns=[column.of(rows) for column in self.columns], line_of=lines)
