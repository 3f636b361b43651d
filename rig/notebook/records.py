"""Records for a notebook: from a file, from arrays, from a data frame."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from rig.core.faults import fault
from rig.core.python_words import in_python
from rig.records.branches import RowOrder, join_branches
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_from_arrays, record_from_frame
from rig.records.record import Record
from rig.records.record_file import read_record as read_file

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
    and units are read where they are plain; `Record.notes` says what was taken for what (docs/records.md). column: of a
    name that is not plain, "resistance_ohm=R@kohm", or a list of them. decimal: "." or ",", where a file leaves it
    open. needs: columns that have to be there, besides time_s. Of a file without times: period_s: how far apart its
    rows are (column="time_s=row" where that is not known); reversed: the last row was taken first; branches: heating
    and cooling stand side by side.

        record = rig.read_record({"t / min": t_min, "T [K]": T_K, "R [kohm]": R_kohm})
    """
    typed = [column] if isinstance(column, str) else list(column)
    if period_s is not None and not 0.0 < period_s < math.inf:
        raise fault("read_record", f"period_s {period_s:g}", "expected a number of seconds > 0")
    order = RowOrder(period_s, reversed, branches)
    if isinstance(source, (str, PathLike)):
        record = read_file(Path(source), [ColumnMapping.parse(text) for text in typed], needs, decimal, order=order)
    elif isinstance(source, Mapping):
        record = record_from_arrays(source, typed, needs, order=order)
    elif hasattr(source, "columns") and hasattr(source, "index"):
        record = record_from_frame(source, typed, needs, order=order)
    else:
        text = f"expected a file's path, a mapping of arrays by name or a data frame, not {type(source).__name__}"
        raise fault("read_record", "source", text)
    (record,) = join_branches([record], order)
    return record


def as_record(source: Any) -> Record:
    """A record as it is, the one of a simulation or a run, or whatever `read_record` reads. Raises Faults."""
    if isinstance(source, Record):
        return source
    held = getattr(source, "record", None)
    return held if isinstance(held, Record) else read_record(source)


def as_records(sources: Iterable[Any]) -> list[Record]:
    """The same of several, of which the two branches of a loop become one record. Raises Faults."""
    return join_branches([as_record(one) for one in sources], RowOrder())
