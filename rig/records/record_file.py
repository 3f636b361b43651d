"""Records in files: read as labs write them, written as CSV with one header line and units in the names.

    read_record         text in any usual encoding and separator, compressed or not, .xlsx, .mat -> Record
    write_columns       columns -> CSV

A record of ours has the names of `rig.core.columns.OF_A_RECORD`, in any order; more columns are kept. Names and units
of another record are taken if they are clear; otherwise the fault says which --column to type (docs/records.md).
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TextIO

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.core.file_writing import writing
from rig.records.branches import RowOrder
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_from_table
from rig.records.file_text import describe_file, read_text_of
from rig.records.lvm_table import is_lvm, lvm_table
from rig.records.record import Record, unit_of
from rig.records.run_table import read_run_table
from rig.records.table import Table
from rig.records.text_table import text_table
from rig.records.units import UNITS

__all__ = ["UNITS", "ColumnMapping", "Record", "RowOrder", "print_columns", "read_record", "unit_of", "write_columns"]

WORKBOOKS, MATLAB = (".xlsx", ".xlsm"), ".mat"  # endings of files that are no text


def read_record(
    path: Path,
    mappings: Iterable[ColumnMapping] = (),
    needs: Iterable[str] = (),
    decimal: str = "",
    options: bool = True,
    order: RowOrder | None = None,
) -> Record:
    """Return the record in a file.

    Parameters
    ----------
    path : the file
    mappings : the user's --column options
    needs : columns that have to be there, besides time_s
    decimal : '.' or ',' if the user named the decimal sign
    options : the user can type --column, so that faults may say what to type
    order : the order of the rows, if the file has no times

    Raises
    ------
    Faults
        A line each for a missing column, a field that is no number, times that do not increase, a file without a table.
    """
    try:
        return record_from_table(_read_table(path, decimal), mappings, needs, options, order)
    except Faults:
        kind = describe_file(path) if not _is_workbook(path) and path.suffix.lower() != MATLAB else ""
        if not kind:
            raise
    raise fault(path, "", f"this is no table of numbers: {kind}; expected columns of numbers below a line of names")


def _is_workbook(path: Path) -> bool:
    """Return True if name and first bytes are a workbook's: some programs write text under such a name."""
    try:
        if path.suffix.lower() not in WORKBOOKS or not path.is_file():  # a pipe must not lose its first bytes
            return False
        with path.open("rb") as file:
            return file.read(2) == b"PK"
    except OSError:
        return False


def _read_table(path: Path, decimal: str) -> Table:
    ending = path.suffix.lower()
    try:
        if path.is_dir():
            inside = path / "record.csv"
            raise fault(path, "", "is a folder; expected a file" + (f", as {inside}" if inside.is_file() else ""))
        # Only a pipe that this process was started with has a writer: `... | peltier identify /dev/stdin`, `<(...)`.
        fed = path == Path("/dev/stdin") or path.parent in (Path("/dev/fd"), Path("/proc/self/fd"))
        if path.is_char_device() or path.is_socket() or (path.is_fifo() and not fed):
            raise fault(path, "", "is a device or a pipe; expected a file")
        if _is_workbook(path):
            from rig.records.workbook_table import workbook_table

            return workbook_table(path, decimal)
        if ending == MATLAB:
            from rig.records.matlab_table import matlab_table

            return matlab_table(path)
        if not decimal and (table := read_run_table(path)) is not None:
            return table
        data = path.read_bytes()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except OSError as error:
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    text, notes = read_text_of(data, path)
    table = lvm_table(text, path) if is_lvm(text) else text_table(text, path, decimal)
    if ending in WORKBOOKS:
        table.notes.append(f"text, and no workbook as its name ({ending}) says")
    table.notes.extend(notes)
    return table


def write_columns(path: Path, columns: Mapping[str, Array | list[str]]) -> None:
    """Write columns as a CSV file; numbers read back to the same bits, nan becomes an empty field."""
    with writing(path) as new, new.open("w", encoding="utf-8", newline="") as file:
        print_columns(file, columns)


def print_columns(file: TextIO, columns: Mapping[str, Array | list[str]]) -> None:
    """Write columns as CSV into an open file."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([_as_field(value) for value in row])


def _as_field(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    number = float(value)  # type: ignore[arg-type]
    return "" if math.isnan(number) else repr(number)
