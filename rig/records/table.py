"""A table as a file or a program holds it: names, units, columns of text or numbers, and the place of each row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.column_names import Meaning, interpret_name
from rig.records.numbers import DecimalSign, Numbers, is_blank, read_numbers, replace_sentinels

RowIndices = Sequence[int] | NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Column:
    """A column: name as in the file ('' for none), fields (texts or numbers), unit in the line below the names."""

    name: str
    fields: Sequence[str] | Array
    unit: str = ""

    @property
    def texts(self) -> list[str] | None:
        """The fields if they are text, else None."""
        return self.fields if isinstance(self.fields, list) else None

    @property
    def meaning(self) -> Meaning:
        """The meaning of the name and the unit."""
        return interpret_name(self.name, self.unit)

    def select(self, rows: RowIndices) -> Column:
        """Return the column with these rows in this order; row -1 is an empty field."""
        texts = self.texts
        if texts is not None:
            return replace(self, fields=[texts[k] if k >= 0 else "" for k in rows])
        index = np.asarray(rows, dtype=np.intp)
        return replace(self, fields=np.where(index < 0, np.nan, np.asarray(self.fields)[index]))

    def filled(self) -> NDArray[np.bool_]:
        """Return the rows whose field is not empty."""
        if self.texts is not None:
            return np.array([not is_blank(text) for text in self.texts], dtype=np.bool_)
        return np.isfinite(np.asarray(self.fields, dtype=np.float64))

    def first(self) -> str:
        """Return the first text that is not blank; '' if there is none."""
        return next((text for text in self.texts or () if not is_blank(text)), "")

    def numbers(self, decimal: DecimalSign, ending: str | None = None) -> Numbers:
        """Return the fields as numbers. Raises ValueError as `read_numbers` does."""
        if self.texts is not None:
            return read_numbers(self.texts, decimal, ending)
        return replace_sentinels(np.asarray(self.fields, dtype=np.float64), ending)


@dataclass(frozen=True, eq=False)
class Table:
    """A table with names.

    Attributes
    ----------
    source : the file
    place : of the names, such as 'line 1'
    line_of : the line of each row, for messages; row_word: 'line', or 'row' if the file has no lines
    named : False if the file has no names
    notes : what was read as what, for people
    times : where times come from: "file", "period" (typed) or "rows" (only their order is known)
    """

    source: str
    place: str
    columns: list[Column]
    line_of: Sequence[int]
    row_word: str = "line"
    named: bool = True
    decimal: DecimalSign = field(default_factory=DecimalSign)
    notes: list[str] = field(default_factory=list)
    times: str = "file"

    def place_of(self, row: int) -> str:
        """Return the place of a row, as in 'line 12'."""
        return f"{self.row_word} {self.line_of[row]}"

    def shown_names(self) -> list[str]:
        """Return the names for messages: '#3' for a third column without a name."""
        return [column.name or f"#{k + 1}" for k, column in enumerate(self.columns)]

    def select(self, rows: RowIndices) -> Table:
        """Return the table with these rows in this order."""
        lines = [self.line_of[k] for k in rows]
        return replace(self, columns=[column.select(rows) for column in self.columns], line_of=lines)


def table_from_arrays(columns: Mapping[str, Any], source: str) -> Table:
    """Return a table of arrays by name. Raises Faults: no arrays, of unequal length, or of several dimensions."""
    table = [Column(str(name), _fields(np.asarray(values), str(name), source)) for name, values in columns.items()]
    lengths = {column.name: len(column.fields) for column in table}
    if not table:
        raise fault(source, "", "no columns; expected time_s and what was measured")
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise fault(source, "", f"columns of unequal length: {shown}")
    return Table(source, "", table, range(len(table[0].fields)), row_word="row")


def _fields(values: Any, name: str, source: str) -> Any:
    """Return numbers as float64, dates as text, durations as seconds, all else as text."""
    values = np.squeeze(values) if values.ndim > 1 else values
    if values.ndim != 1:
        raise fault(source, repr(name), f"{values.ndim} dimensions; expected one")
    if values.dtype.kind == "M":
        return ["" if np.isnat(value) else str(value) for value in values.astype("datetime64[us]")]
    if values.dtype.kind == "m":
        return values / np.timedelta64(1, "ns") * 1e-9
    if values.dtype.kind in "biufO":
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError):
            pass
    return ["" if text in ("None", "nan", "NaN", "NaT", "<NA>") else text for text in map(str, values)]


def frame_columns(frame: Any) -> dict[str, Any]:
    """Return a data frame's columns by name, and its index if it holds dates or has a name of its own."""
    columns: dict[str, Any] = {}
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    if index is not None and str(name) not in map(str, frame.columns):
        values = np.asarray(index)
        if values.dtype.kind == "M" or name is not None:
            columns[str(name) if name is not None else "time"] = values
    return columns | {str(name): np.asarray(frame[name]) for name in frame.columns}
