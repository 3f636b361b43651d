"""A table in an Excel workbook (.xlsx), through openpyxl: the sheet that holds rows of numbers."""

from __future__ import annotations

import csv
import io
import zipfile
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from rig.core.extras import to_install
from rig.core.faults import Faults, fault
from rig.files.table import Table
from rig.files.text_table import text_table

MOST_ROWS = 1_048_576  # that a sheet can have; the number of a row in a broken file may be any
MOST_CELLS = 60_000_000  # beyond this many it is no record
MOST_BYTES = 2_000_000_000  # unpacked: a full sheet of twenty columns; a file of 2 MB can unpack to this, too


def workbook_table(path: Path, decimal: str = "") -> Table:
    """The table of a workbook's only sheet that has one. Raises Faults."""
    try:
        from openpyxl import load_workbook
    except ModuleNotFoundError:
        text = f"an Excel workbook, which needs openpyxl: {to_install('files')}; or save it as CSV"
        raise fault(path, "", text) from None
    try:
        with zipfile.ZipFile(path) as package:
            unpacked = sum(member.file_size for member in package.infolist())
        if unpacked > MOST_BYTES:
            raise fault(
                path, "", f"unpacks to {unpacked / 1e9:.1f} GB; expected a record, {MOST_BYTES / 1e9:g} GB at most"
            )
        book = load_workbook(path, read_only=True, data_only=True)
        sheets = {sheet.title: _as_text(sheet, path) for sheet in book.worksheets}
        book.close()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except Faults:
        raise
    except Exception as error:  # openpyxl raises what its parser happened to meet in a broken file
        raise fault(path, "", f"cannot be read as .xlsx: {type(error).__name__}: {error}") from None
    found: dict[str, Table] = {}
    faults: list[str] = []
    for title, text in sheets.items():
        try:
            table = text_table(text, path, decimal)
        except Faults as fault_found:
            faults += fault_found.lines
            continue
        if table.line_of:
            found[title] = table
    if not found:
        raise Faults(faults[:5] or [f"{path}: expected a sheet with names and rows of numbers"])
    if len(found) > 1:
        raise fault(path, "", f"tables in {len(found)} sheets ({', '.join(found)}); expected one: save it as CSV")
    title, table = next(iter(found.items()))
    if len(sheets) > 1:
        table.said.append(f"sheet {title!r}")
    return Table(table.source, table.place, table.columns, table.line_of, "row", table.named, table.signs, table.said)


def _as_text(sheet: Any, path: Path) -> str:
    """A sheet's cells as tab-separated text, numbers to the same bits."""
    sheet.reset_dimensions()  # else rows beyond the size that the file says of itself would be left out in silence
    rows: list[list[str]] = []
    cells = width = 0
    for row in sheet.iter_rows(values_only=True):
        rows.append([_shown(cell) for cell in row])
        cells, width = cells + len(row), max(width, len(row))
        if len(rows) > MOST_ROWS or max(cells, width * len(rows)) > MOST_CELLS:
            most = f"more than {MOST_ROWS} rows or {MOST_CELLS} cells"
            raise fault(path, f"sheet {sheet.title!r}", f"{most}; expected a record")
    out = io.StringIO()
    writer = csv.writer(out, delimiter="\t", lineterminator="\n")
    writer.writerows([*row, *[""] * (width - len(row))] for row in rows)
    return out.getvalue()


def _shown(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, (bool, int, float)):
        return repr(float(cell))
    if isinstance(cell, datetime):
        return cell.isoformat(" ", "microseconds")
    if isinstance(cell, (date, time)):
        return cell.isoformat()
    if isinstance(cell, timedelta):
        seconds = cell.total_seconds()
        return f"{int(seconds // 3600)}:{int(seconds % 3600 // 60):02d}:{seconds % 60:09.6f}"
    return " ".join(str(cell).split())
