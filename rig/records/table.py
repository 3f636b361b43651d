"""A table as a file holds it: names, units below them, columns of fields or numbers, and the line of each row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.numbers import Signs, blank_like


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


def array_table(columns: Mapping[str, Any], source: str) -> Table:
    """A table of columns by name. Raises Faults: none, of unequal length, or of more than one dimension."""
    table = [Column(str(name), _fields(np.asarray(values), str(name), source)) for name, values in columns.items()]
    lengths = {column.name: len(column.fields) for column in table}
    if not table:
        raise fault(source, "", "no columns; expected time_s and what was measured")
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise fault(source, "", f"columns of unequal length: {told}")
    rows = next(iter(lengths.values()))
    return Table(source, "", table, range(rows), row_word="row")


def _fields(values: Any, name: str, source: str) -> Any:
    """Numbers as float64; times as seconds from the first; all else as text."""
    values = np.squeeze(values) if values.ndim > 1 else values
    if values.ndim != 1:
        raise fault(source, repr(name), f"{values.ndim} dimensions; expected one")
    if values.dtype.kind == "M":
        return ["" if np.isnat(value) else str(value) for value in values.astype("datetime64[us]")]
    if values.dtype.kind == "m":
        return values / np.timedelta64(1, "ns") * 1e-9
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    if values.dtype.kind == "O":
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError):
            pass
    return ["" if text in ("None", "nan", "NaN", "NaT", "<NA>") else text for text in map(str, values)]


def columns_of_frame(frame: Any) -> dict[str, Any]:
    """A data frame's columns by name, its index among them where it is one of dates or has a name."""
    columns: dict[str, Any] = {}
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    if index is not None and str(name) not in map(str, frame.columns):
        values = np.asarray(index)
        if values.dtype.kind == "M" or name is not None:
            columns[str(name) if name is not None else "time"] = values
    for name in frame.columns:
        columns[str(name)] = np.asarray(frame[name])
    return columns
