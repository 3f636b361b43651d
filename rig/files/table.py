"""A table as a file holds it: names, units below them, columns of fields or numbers, and the line of each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from compensator.hysteresis.functions import Array
from rig.files.field_numbers import Signs


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


@dataclass(frozen=True, eq=False)
class Table:
    """source: the file. place: where its names are, as 'line 1'. line_of: the line of each row, for messages; row
    counts from 0. named: whether it has names. said: what was read as what."""

    source: str
    place: str
    columns: list[Column]
    line_of: Sequence[int]
    row_word: str = "line"
    named: bool = True
    signs: Signs = field(default_factory=Signs)
    said: list[str] = field(default_factory=list)

    def at(self, row: int) -> str:
        """A row's place in words."""
        return f"{self.row_word} {self.line_of[row]}"

    def names(self) -> list[str]:
        """Names as they are told: '#3' for a column without one."""
        return [column.name or f"#{k + 1}" for k, column in enumerate(self.columns)]
