"""A table of arrays: numpy's, those of a data frame, and those of a MATLAB file (.mat, through scipy)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rig.core.faults import fault
from rig.files.table import Column, Table


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
