"""Records in files: read as labs write them, written as CSV with one header line and units in the names.

    read_record         text in any usual encoding and separator, compressed or not, .xlsx, .mat -> Record
    write_columns       columns -> CSV

A record of ours has the names of `rig.core.columns.OF_A_RECORD`, in any order; more columns are kept. Of a record
from elsewhere names and units are taken where they are plain; where not, the refusal says what --column to type
(docs/records.md).
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
from rig.core.file_writing import written
from rig.records.branches import Rows
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_of
from rig.records.file_text import decoded, other_kind, unpacked
from rig.records.lvm_table import is_lvm, lvm_table
from rig.records.record import Record, unit_of
from rig.records.run_table import run_table
from rig.records.table import Table
from rig.records.text_table import text_table
from rig.records.units import UNITS

__all__ = ["UNITS", "ColumnMapping", "Record", "Rows", "print_columns", "read_record", "unit_of", "write_columns"]

WORKBOOKS, MATLAB = (".xlsx", ".xlsm"), ".mat"  # endings of files that are no text


def read_record(
    path: Path,
    mappings: Iterable[ColumnMapping] = (),
    needs: Iterable[str] = (),
    decimal: str = "",
    flags: bool = True,
    rows: Rows | None = None,
) -> Record:
    """Read a record. Raises Faults: a missing column, a field that is no number, time that does not increase, a file
    that is no table at all.

    needs: columns that have to be there, besides time_s. decimal: '.' or ',' where the file leaves open which sign
    stands before its decimals. flags: whether the caller takes --column, so that refusals may say what to type. rows:
    what somebody says of their order, where the file has no times.
    """
    try:
        return record_of(_table(path, decimal), mappings, needs, flags, rows)
    except Faults:
        kind = other_kind(path) if not _workbook(path) and path.suffix.lower() != MATLAB else ""
        if not kind:
            raise
    raise fault(path, "", f"this is no table of numbers: {kind}; expected columns of numbers below a line of names")


def _fed(path: Path) -> bool:
    """Whether a pipe is one that this process was started with: somebody writes into it (`... | peltier identify
    /dev/stdin`, `<(...)` of a shell)."""
    return path == Path("/dev/stdin") or path.parent in (Path("/dev/fd"), Path("/proc/self/fd"))


def _workbook(path: Path) -> bool:
    """Whether a file is a workbook, by its name and its first bytes: some programs write text under such a name."""
    try:
        if path.suffix.lower() not in WORKBOOKS or not path.is_file():  # a pipe that nobody feeds has no first bytes
            return False
        with path.open("rb") as file:
            return file.read(2) == b"PK"
    except OSError:
        return False


def _refuse_folder(path: Path) -> None:
    """Raises Faults; a run's folder has its record inside."""
    if path.is_dir():
        inside = path / "record.csv"
        raise fault(path, "", "is a folder; expected a file" + (f", as {inside}" if inside.is_file() else ""))


def _table(path: Path, decimal: str) -> Table:
    """What a file holds. Raises Faults."""
    try:
        _refuse_folder(path)
        if path.is_char_device() or path.is_socket() or (path.is_fifo() and not _fed(path)):  # these may have no end
            raise fault(path, "", "is a device or a pipe; expected a file")
    except OSError as error:  # a name that is too long
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    ending = path.suffix.lower()
    if _workbook(path):
        from rig.records.workbook_table import workbook_table

        return workbook_table(path, decimal)
    if ending == MATLAB:
        from rig.records.matlab_table import matlab_table

        return matlab_table(path)
    try:
        if not decimal and (table := run_table(path)) is not None:
            return table
        data = path.read_bytes()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except OSError as error:
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    data, packed_by = unpacked(data, path)
    text, encoding = decoded(data, path)
    table = lvm_table(text, path) if is_lvm(text) else text_table(text, path, decimal)
    if packed_by:
        table.said.append(f"unpacked ({packed_by})")
    if ending in WORKBOOKS:
        table.said.append(f"text, and no workbook as its name ({ending}) says")
    if encoding:
        table.said.append(f"text in {encoding}")
    return table


def write_columns(path: Path, columns: Mapping[str, Array | list[str]]) -> None:
    """Write columns as a CSV file; numbers read back to the same bits, nan becomes an empty field."""
    with written(path) as new, new.open("w", encoding="utf-8", newline="") as file:
        print_columns(file, columns)


def print_columns(file: TextIO, columns: Mapping[str, Array | list[str]]) -> None:
    """The same into an open file."""
    names = list(columns)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    for row in zip(*(columns[name] for name in names), strict=True):
        writer.writerow([_shown(value) for value in row])


def _shown(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    number = float(value)  # type: ignore[arg-type]
    return "" if math.isnan(number) else repr(number)
