"""A table in an Excel workbook (.xlsx), read with openpyxl: the only sheet with rows of numbers."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from rig.core.faults import Faults, fault
from rig.core.requirements import to_install
from rig.records.table import Table
from rig.records.text_table import text_table

FEWEST_ROWS = 12  # beside a longer table a shorter one is a summary: no model is fitted to fewer readings
# of a cell with a formula and its value, in the XML of a sheet (ECMA-376, part 1, 18.3.1.40 and 18.3.1.96)
FORMULA = re.compile(rb'<c r="(\w+)"[^>]*><f[ >/].*?(?:</f>|/>)(<v>[^<])?')
MERGED = re.compile(rb"<(?:\w+:)?mergeCell\s[^>]*\bref=[\"'](\w+:\w+)[\"']")  # the same, 18.3.1.54
DATE_TEXT = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{6}")  # of a date in `_as_text`
MIDNIGHT = " 00:00:00.000000"  # in every cell of a column of dates whose clock is a column of its own
MOST_ROWS = 1_048_576  # of a sheet; a broken file may have any number of a row
MOST_CELLS = 60_000_000
MOST_BYTES = 2_000_000_000  # unpacked: a full sheet of twenty columns; a file of 2 MB can unpack to as much


def workbook_table(path: Path, decimal: str = "") -> Table:
    """Return the table of a workbook's only sheet that has one. Raises Faults."""
    try:
        from openpyxl.reader.excel import ExcelReader
    except ModuleNotFoundError:
        text = f"an Excel workbook, which needs openpyxl: {to_install('files')}; or save it as CSV"
        raise fault(path, "", text) from None
    sheets: dict[str, tuple[str, list[Any], str]] = {}
    try:
        with zipfile.ZipFile(path) as package:
            unpacked = sum(member.file_size for member in package.infolist())
        if unpacked > MOST_BYTES:
            text = f"unpacks to {unpacked / 1e9:.1f} GB; expected a record, {MOST_BYTES / 1e9:g} GB at most"
            raise fault(path, "", text)
        reader = ExcelReader(path, read_only=True, data_only=True)  # load_workbook does not say where the sheets are
        reader.read()
        members = {sheet.name: link.target for sheet, link in reader.parser.find_sheets()}
        for sheet in reader.wb.worksheets:
            xml = reader.archive.read(members[sheet.title])
            sheets[sheet.title] = (*_read_sheet(sheet, _merged_cells(xml), path), _missing_values(xml))
        reader.wb.close()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except Faults:
        raise
    except Exception as error:  # openpyxl raises whatever its parser meets in a broken file
        raise fault(path, "", f"cannot be read as .xlsx: {type(error).__name__}: {error}") from None
    found: dict[str, Table] = {}
    faults: list[str] = []
    for title, (text, _, _) in sheets.items():
        try:
            table = text_table(text, path, decimal)
        except Faults as fault_found:
            faults += fault_found.lines
            continue
        if table.line_of:
            found[title] = table
    if not found:
        raise Faults(faults[:5] or [f"{path}: expected a sheet with names and rows of numbers"])
    long = {title: table for title, table in found.items() if len(table.line_of) >= FEWEST_ROWS} or found
    if len(long) > 1:
        raise fault(path, "", f"tables in {len(long)} sheets ({', '.join(long)}); expected one: save it as CSV")
    title, table = next(iter(long.items()))
    _, merged, missing = sheets[title]
    if missing:
        text = f"{missing}, which the file has not; open it in a spreadsheet program and save it, or save it as CSV"
        raise fault(path, f"sheet {title!r}", text)
    down = [area for area in merged if area.max_row > max(area.min_row, table.line_of[0] - 1)]
    if down:
        more = f" and {len(down) - 1} more" if len(down) > 1 else ""
        table.notes.append(f"merged cells taken as the same in each of their rows: {down[0].coord}{more}")
    if len(sheets) > 1:
        table.notes.append(f"sheet {title!r}" + (f" of {', '.join(map(repr, found))}" if len(found) > 1 else ""))
    return replace(table, row_word="row")


def _missing_values(xml: bytes) -> str:
    """Return which formulas of a sheet have no values in the file, '' if they have; programs that do not compute leave
    them out, and a whole column would read as empty."""
    cells = FORMULA.findall(xml)
    if not cells or any(value for _, value in cells):
        return ""
    more = f", and {len(cells) - 1} more" if len(cells) > 1 else ""
    return f"{cells[0][0].decode()}{more}: expected the values of formulas"


def _merged_cells(xml: bytes) -> list[Any]:
    """Return the merged cells of a sheet as openpyxl's CellRange; openpyxl does not give them when it reads by row."""
    from openpyxl.worksheet.cell_range import CellRange

    below = xml.rpartition(b"sheetData>")[2]  # the cells themselves are above
    areas = (CellRange(area.decode()) for area in MERGED.findall(below))
    return sorted(areas, key=lambda a: (a.min_row, a.min_col))


def _read_sheet(sheet: Any, merged: list[Any], path: Path) -> tuple[str, list[Any]]:
    """Return a sheet as tab-separated text, numbers to the same bits, and the merged cells that hold something."""
    sheet.reset_dimensions()  # the file may give its size too small
    rows: list[list[str]] = []
    cells = width = 0
    for row in sheet.iter_rows(values_only=True):
        rows.append([_as_text(cell) for cell in row])
        cells, width = cells + len(row), max(width, len(row))
        if len(rows) > MOST_ROWS or max(cells, width * len(rows)) > MOST_CELLS:
            most = f"more than {MOST_ROWS} rows or {MOST_CELLS} cells"
            raise fault(path, f"sheet {sheet.title!r}", f"{most}; expected a record")
    for cells_of_row in rows:
        cells_of_row += [""] * (width - len(cells_of_row))
    holding = _fill_merged(rows, merged)
    for k in range(width):
        dated = [row for row in rows if DATE_TEXT.fullmatch(row[k])]
        if all(row[k].endswith(MIDNIGHT) for row in dated):
            for row in dated:
                row[k] = row[k].removesuffix(MIDNIGHT)
    out = io.StringIO()
    csv.writer(out, delimiter="\t", lineterminator="\n").writerows(rows)
    return out.getvalue(), holding


def _fill_merged(rows: list[list[str]], merged: list[Any]) -> list[Any]:
    """Copy the content of merged cells, which is in the first, into those below it; return those that hold something.

    What stands over several columns belongs to the first of them.
    """
    holding = []
    for area in merged:
        first, column = area.min_row - 1, area.min_col - 1
        content = rows[first][column] if first < len(rows) and column < len(rows[first]) else ""
        if content:
            holding.append(area)
            for row in rows[first : area.max_row]:
                row[column] = content
    return holding


def _as_text(cell: Any) -> str:
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
