"""Records for a notebook: from a file, from arrays, from a data frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from rig.core.faults import fault
from rig.core.python_words import in_python
from rig.files.column_mapping import ColumnMapping
from rig.files.record import Record
from rig.files.record_file import Rows
from rig.files.record_file import read_record as read_file

NEEDED = ("temperature_degC",)


@in_python()
def read_record(
    source: Any,
    column: str | Iterable[str] = (),
    *,
    decimal: str = "",
    needs: Iterable[str] = NEEDED,
    period_s: float | None = None,
    reversed: bool = False,
    branches: bool = False,
) -> Record:
    """A record: columns by name, each of shape (rows,), in s, degC, ohm, A. Raises Faults.

    source: a file's path (CSV and other text, .xlsx, .mat), a mapping of arrays by name, or a pandas DataFrame. Names
    and units are read where they are plain; `Record.said` says what was taken for what (docs/records.md). column: of a
    name that is not plain, "resistance_ohm=R@kohm", or a list of them. decimal: "." or ",", where a file leaves it
    open. needs: columns that have to be there, besides time_s. Of a file without times: period_s: how far apart its
    rows are (column="time_s=row" where that is not known); reversed: the last row was taken first; branches: heating
    and cooling stand side by side.

        record = rig.read_record({"t / min": t_min, "T [K]": T_K, "R [kohm]": R_kohm})
    """
    typed = [column] if isinstance(column, str) else list(column)
    if isinstance(source, (str, PathLike)):
        rows = Rows(period_s, reversed, branches)
        return read_file(Path(source), [ColumnMapping.parse(text) for text in typed], needs, decimal, rows=rows)
    if isinstance(source, Mapping):
        return Record.from_arrays(source, typed, needs)
    if hasattr(source, "columns") and hasattr(source, "index"):
        return Record.from_frame(source, typed, needs)
    text = f"expected a file's path, a mapping of arrays by name or a data frame, not {type(source).__name__}"
    raise fault("read_record", "source", text)


def as_record(source: Any) -> Record:
    """A record as it is, the one of a simulation or a run, or whatever `read_record` reads. Raises Faults."""
    if isinstance(source, Record):
        return source
    held = getattr(source, "record", None)
    return held if isinstance(held, Record) else read_record(source)
