"""A table in an Excel workbook (.xlsx), through openpyxl: the sheet that holds rows of numbers."""

from __future__ import annotations

import csv
import io
import re
import zipfile
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from rig.core.extras import to_install
from rig.core.faults import Faults, fault
from rig.records.table import Table
from rig.records.text_table import is_value, text_table

FEWEST_ROWS = 12  # no model is fitted to fewer readings: a shorter table beside a longer one is a summary, not a record
FORMULA = re.compile(rb"<f[ >/]")  # of a cell, in the XML of a sheet (ECMA-376, part 1, 18.3.1.40)
MERGED = re.compile(rb"<(?:\w+:)?mergeCell\s[^>]*\bref=[\"'](\w+:\w+)[\"']")  # the same, 18.3.1.54
STAMP = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{6}")  # what `_shown` makes of a date
MIDNIGHT = " 00:00:00.000000"  # a column of dates alone has it in every cell: the clock is a column of its own
MOST_ROWS = 1_048_576  # that a sheet can have; the number of a row in a broken file may be any
MOST_CELLS = 60_000_000  # beyond this many it is no record
MOST_BYTES = 2_000_000_000  # unpacked: a full sheet of twenty columns; a file of 2 MB can unpack to this, too


def workbook_table(path: Path, decimal: str = "") -> Table:
    """The table of a workbook's only sheet that has one. Raises Faults."""
    try:
        from openpyxl.reader.excel import ExcelReader
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
        reader = ExcelReader(path, read_only=True, data_only=True)  # as load_workbook does; it knows where sheets are
        reader.read()
        members = {sheet.name: link.target for sheet, link in reader.parser.find_sheets()}
        sheets, formulas = {}, {}
        for sheet in reader.wb.worksheets:
            merged, computed = _beside_the_cells(reader.archive.read(members[sheet.title]))
            sheets[sheet.title] = _as_text(sheet, merged, path)
            if computed and (without := _without_values(path, sheet.title)):
                formulas[sheet.title] = without
        reader.wb.close()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except Faults:
        raise
    except Exception as error:  # openpyxl raises what its parser happened to meet in a broken file
        raise fault(path, "", f"cannot be read as .xlsx: {type(error).__name__}: {error}") from None
    found: dict[str, Table] = {}
    faults: list[str] = []
    for title, (text, _) in sheets.items():
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
    if title in formulas:
        text = "open it in a spreadsheet program and save it, or save it as CSV"
        raise fault(path, f"sheet {title!r}", f"{formulas[title]}, which the file has not; {text}")
    down = [area for area in sheets[title][1] if area.max_row > max(area.min_row, table.line_of[0] - 1)]
    if down:
        more = f" and {len(down) - 1} more" if len(down) > 1 else ""
        table.said.append(f"merged cells taken as the same in each of their rows: {down[0].coord}{more}")
    if len(sheets) > 1:
        table.said.append(f"sheet {title!r}" + (f" of {', '.join(map(repr, found))}" if len(found) > 1 else ""))
    return Table(table.source, table.place, table.columns, table.line_of, "row", table.named, table.signs, table.said)


def _without_values(path: Path, title: str) -> str:
    """That a sheet has formulas whose values are not in the file, which programs leave out that do not compute them;
    "" where it has them. Such a cell reads as an empty one: a whole column would be missing without a word."""
    from openpyxl import load_workbook

    books = [load_workbook(path, read_only=True, data_only=values) for values in (True, False)]
    shown, written = (book[title] for book in books)
    for sheet in (shown, written):
        sheet.reset_dimensions()
    cells = [
        (value, formula.coordinate)
        for row, beside in zip(shown.iter_rows(values_only=True), written.iter_rows(), strict=True)
        for value, formula in zip(row, beside, strict=True)
        if formula.data_type == "f"
    ]
    for book in books:
        book.close()
    if not cells or any(value is not None for value, _ in cells):  # one of many that is empty has "" for its value
        return ""
    more = f", and {len(cells) - 1} more" if len(cells) > 1 else ""
    return f"{cells[0][1]}{more}: expected the values of formulas"


def _beside_the_cells(sheet: bytes) -> tuple[list[Any], bool]:
    """What a sheet that is read row by row does not tell itself, from its XML: its merged cells, as openpyxl's
    CellRange, and whether it has formulas."""
    from openpyxl.worksheet.cell_range import CellRange

    below = sheet.rpartition(b"sheetData>")[2]  # the cells themselves are above
    areas = (CellRange(area.decode()) for area in MERGED.findall(below))
    return sorted(areas, key=lambda a: (a.min_row, a.min_col)), FORMULA.search(sheet) is not None


def _filled(rows: list[list[str]], merged: list[Any]) -> list[Any]:
    """What merged cells hold, which is in the first of them, into all of them; those that hold something.

    A label belongs to all its rows, and a name to all its columns; a remark that is alone in its row to none. A number
    is one column's: the others get where it is, which is no number.
    """
    holding = []
    for area in merged:
        first, column = area.min_row - 1, area.min_col - 1
        held = rows[first][column] if first < len(rows) and column < len(rows[first]) else ""
        alone = sum(map(bool, rows[first])) == 1 if held else False
        beside = f"merged with {area.coord.partition(':')[0]}" if is_value(held) else "" if alone else held
        for row in rows[first : area.max_row] if held else ():
            row[column : area.max_col] = [held, *[beside] * (len(row[column : area.max_col]) - 1)]
        holding += [area] if held else []
    return holding


def _as_text(sheet: Any, merged: list[Any], path: Path) -> tuple[str, list[Any]]:
    """A sheet's cells as tab-separated text, numbers to the same bits; and those of the merged that hold something."""
    sheet.reset_dimensions()  # else rows beyond the size that the file says of itself would be left out in silence
    rows: list[list[str]] = []
    cells = width = 0
    for row in sheet.iter_rows(values_only=True):
        rows.append([_shown(cell) for cell in row])
        cells, width = cells + len(row), max(width, len(row))
        if len(rows) > MOST_ROWS or max(cells, width * len(rows)) > MOST_CELLS:
            most = f"more than {MOST_ROWS} rows or {MOST_CELLS} cells"
            raise fault(path, f"sheet {sheet.title!r}", f"{most}; expected a record")
    for row in rows:
        row += [""] * (width - len(row))
    holding = _filled(rows, merged)
    for k in range(width):
        column = [row for row in rows if STAMP.fullmatch(row[k])]
        if all(row[k].endswith(MIDNIGHT) for row in column):
            for row in column:
                row[k] = row[k].removesuffix(MIDNIGHT)
    out = io.StringIO()
    writer = csv.writer(out, delimiter="\t", lineterminator="\n")
    writer.writerows(rows)
    return out.getvalue(), holding


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
