"""Records and models for a notebook: from files, arrays, data frames, and out of results."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from rig.config.model_file import Model
from rig.config.model_file import read_model as read_model_file
from rig.config.model_file import write_model as write_model_file
from rig.core.faults import fault, in_python
from rig.records.branches import RowOrder, join_branches
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_from_arrays
from rig.records.record import Record
from rig.records.record_file import read_record as read_record_file
from rig.records.table import frame_columns

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
    """Read a record: columns by name, each of shape (rows,), in s, degC, ohm, A.

    Names and units are read where they are plain; `Record.notes` says how each column was read (docs/records.md).

    Parameters
    ----------
    source : path of a file (CSV and other text, .xlsx, .mat), a mapping of arrays by name, or a pandas DataFrame
    column : where a column is whose name is not plain, "resistance_ohm=R@kohm", or a list of them
    decimal : "." or ",", if a file leaves it open
    needs : columns that have to be there, besides time_s
    period_s : of a file without times: how far apart its rows are (s); column="time_s=row" if that is not known
    reversed : of a file without times: the last row was taken first
    branches : heating and cooling stand side by side

    Returns
    -------
    Record

    Raises
    ------
    Faults : a line for each fault, with its place and what is expected

    Examples
    --------
    >>> record = rig.read_record({"t / min": t_min, "T [K]": T_K, "R [kohm]": R_kohm})
    """
    typed = [column] if isinstance(column, str) else list(column)
    if period_s is not None and not 0.0 < period_s < math.inf:
        raise fault("read_record", f"period_s {period_s:g}", "expected a number of seconds > 0")
    order = RowOrder(period_s, reversed, branches)
    if isinstance(source, (str, PathLike)):
        record = read_record_file(
            Path(source), [ColumnMapping.parse(text) for text in typed], needs, decimal, order=order
        )
    elif isinstance(source, Mapping):
        record = record_from_arrays(source, typed, needs, order=order)
    elif hasattr(source, "columns") and hasattr(source, "index"):
        record = record_from_arrays(frame_columns(source), typed, needs, "data frame", order)
    else:
        text = f"expected a file's path, a mapping of arrays by name or a data frame, not {type(source).__name__}"
        raise fault("read_record", "source", text)
    (record,) = join_branches([record], order)
    return record


def as_record(source: Any) -> Record:
    """Return a record as it is, that of a simulation or a run, or whatever `read_record` reads. Raises Faults."""
    if isinstance(source, Record):
        return source
    held = getattr(source, "record", None)
    return held if isinstance(held, Record) else read_record(source)


def as_records(sources: Iterable[Any]) -> list[Record]:
    """Return several records as `as_record` does, the two branches of a loop joined to one. Raises Faults."""
    return join_branches([as_record(one) for one in sources], RowOrder())


def read_model(path: str | PathLike[str]) -> Model:
    """Read film, plate and effects from a model file (TOML), as `peltier identify --out` writes it. Raises Faults."""
    return read_model_file(Path(path))


def write_model(path: str | PathLike[str], model: Any, comment: str = "") -> None:
    """Write a model file for `peltier run`, `predict` and `invert`. model: a Model, an identification or a diagnosis;
    comment: lines for its head. Raises Faults, OSError."""
    write_model_file(Path(path), as_model(model)[0], comment)


def as_model(source: Any) -> tuple[Model, str]:
    """Return the model of a Model, of a result that has one, or of a file, and its name in messages. Raises Faults."""
    if isinstance(source, Model):
        return source, "model"
    held = getattr(source, "model", None)
    if isinstance(held, Model):
        return held, "model"
    if isinstance(source, (str, PathLike)):
        return read_model(source), str(source)
    text = f"expected a Model, what identify or diagnose has found, or a file's path, not {type(source).__name__}"
    raise fault("model", "", text)
