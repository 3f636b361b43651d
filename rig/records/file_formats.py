"""Tables in files that are no plain text: LabVIEW's .lvm, MATLAB's .mat, and Excel workbooks."""

from __future__ import annotations

import csv
import io
import math
import pickle
import re
import subprocess
import sys
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any, cast

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.core.requirements import to_install
from rig.records.column_names import interpret_name
from rig.records.numbers import DecimalSign, parse_number, tidy_number
from rig.records.table import Column, Table, table_from_arrays
from rig.records.text_table import text_table

FIRST_LINE = "LabVIEW Measurement"
END, START_SPECIAL, END_SPECIAL = "***End_of_Header***", "***Start_Special***", "***End_Special***"
SEGMENT_TAGS = frozenset(
    ("Channels", "Samples", "Date", "Time", "Notes", "Y_Unit_Label", "X_Dimension", "X0", "Delta_X", "Test_Name")
)
SAME_S = 1e-9  # times that differ by less are the same


@dataclass
class Segment:
    """A segment: the fields of its header by their first word, names with Comment, rows and their lines."""

    tags: dict[str, list[str]]
    names: list[str] = field(default_factory=list)
    place: int = 0
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    def of_channels(self, tag: str, channels: int, every: int) -> list[str]:
        """Return a header's field of each channel; with times before each it may stand in every second field."""
        fields = self.tags.get(tag, [])
        filled = [text for text in fields if text]
        found = filled if len(filled) == channels else fields[::every][:channels]
        return found + [""] * (channels - len(found))

    def began(self) -> datetime | None:
        """Return the date and time in the header; None if there is none."""
        day, clock = (next(filter(None, self.tags.get(tag, [])), "") for tag in ("Date", "Time"))
        seconds, _, fraction = clock.replace(",", ".").partition(".")
        try:
            return datetime.fromisoformat(f"{day.replace('/', '-')} {seconds}.{(fraction + '000000')[:6]}")
        except ValueError:
            return None


def lvm_table(text: str, path: Path) -> Table:
    """Return the table in a text: the segments with the channels of the first. Raises Faults."""
    lines = text.splitlines()
    end = next((k for k, line in enumerate(lines) if line.startswith(END)), None)
    if end is None:
        raise fault(path, f"line {len(lines)}", f"a LabVIEW file without {END}; expected a whole file")
    header = {words[0]: words[-1] for words in (re.split("[\t,]", line, maxsplit=1) for line in lines[:end])}
    separator = "," if header.get("Separator", "").lower().startswith("comma") else "\t"
    decimal = (header.get("Decimal_Separator", "") + ".")[0]
    x_columns = header.get("X_Columns", "One").strip().capitalize()
    segments = [one for one in _segments(lines, end + 1, separator) if one.rows]
    if not segments:
        raise fault(path, f"line {len(lines)}", "names, and no row of numbers below them; expected rows")
    same = [one for one in segments if one.names == segments[0].names]
    table = _joined(same, path, decimal, x_columns)
    if len(same) < len(segments):
        table.notes.append(f"{len(segments) - len(same)} segments with other channels left out")
    return table


def _segments(lines: Sequence[str], start: int, separator: str) -> list[Segment]:
    """Return the segments without LabVIEW's special blocks."""
    found: list[Segment] = []
    tags: dict[str, list[str]] = {}
    special, named = False, False
    for k in range(start, len(lines)):
        word, *fields = [text.strip() for text in lines[k].split(separator)]
        if special or word == START_SPECIAL or not (word or any(fields)):
            special = (special or word == START_SPECIAL) and word != END_SPECIAL
        elif word == END:
            found.append(Segment(tags))
            tags, named = {}, False
        elif word in SEGMENT_TAGS or not found:
            tags[word] = fields
        elif not named:
            found[-1].names, found[-1].place, named = [word, *fields], k + 1, True
        else:
            found[-1].rows.append([word, *fields, *[""] * (len(found[-1].names) - 1 - len(fields))])
            found[-1].lines.append(k + 1)
    return found


def _joined(segments: Sequence[Segment], path: Path, decimal: str, x_columns: str) -> Table:
    """Return segments of the same channels below each other. Raises Faults."""
    first, every = segments[0], 2 if x_columns == "Multi" else 1
    names = list(first.names)
    while names and names[-1] in ("Comment", ""):
        names.pop()
    channels = range(1, len(names), every)
    units = first.of_channels("Y_Unit_Label", len(channels), every)
    rows = [row for segment in segments for row in segment.rows]
    notes = ["LabVIEW measurement file" + (f" of {len(segments)} segments" if len(segments) > 1 else "")]
    columns = [Column(names[k], [row[k] for row in rows], unit) for k, unit in zip(channels, units, strict=True)]
    placed = range(0, len(names), 2) if every == 2 else [0]
    times = [_times(segments, None if x_columns == "No" else k, every, decimal, path) for k in placed]
    ours = [column.meaning.ours for column in columns]
    main = ours.index("temperature_degC") if every == 2 and "temperature_degC" in ours else 0
    timed = any("Time" in text for text in first.tags.get("X_Dimension", ["Time"]))
    columns.insert(0, Column("Time (s)" if timed else "X_Value", times[main]))
    for k, own in enumerate(times if every == 2 else []):
        off_s = float(np.nanmax(np.abs(own - times[main]), initial=0.0))
        if off_s > SAME_S and ours[k] == "resistance_ohm":
            columns.append(Column("resistance_time_s", own))
        elif off_s > SAME_S:
            notes.append(f"{columns[k + 1].name!r} at the times of {columns[main + 1].name!r}, {off_s:.3g} s off")
    comments = [" ".join(row[len(names) :]).strip() for row in rows]
    if any(comments):
        columns.append(Column("Comment", comments))
    lines = [line for segment in segments for line in segment.lines]
    sign = DecimalSign(decimal, False, True)
    return Table(str(path), f"line {first.place}", columns, lines, decimal=sign, notes=notes)


def _times(segments: Sequence[Segment], k: int | None, every: int, decimal: str, path: Path) -> Array:
    """Return the times of all rows, s, from column k, or from the headers. Raises Faults if a segment begins before the
    end of the one before."""
    found: list[Array] = []
    began = segments[0].began()
    for number, segment in enumerate(segments):
        own = _segment_times(segment, k, every, decimal, path)
        last, begin = (float(found[-1][-1]) if found else -np.inf), segment.began()
        if number and not own[0] > last and begin is not None and began is not None:
            own = own + (begin - began).total_seconds()  # they count from the header's date
        if number and not own[0] > last:
            text = f"segment {number + 1} begins at {own[0]:g} s, and the one before ends at {last:g} s"
            raise fault(path, f"line {segment.lines[0]}", f"{text}: expected each as a file of its own")
        found.append(own)
    return np.concatenate(found)


def _segment_times(segment: Segment, k: int | None, every: int, decimal: str, path: Path) -> Array:
    """Return the times of a segment's rows, or of its header if the rows have none."""

    def number(text: str, line: int, what: str) -> float:
        try:
            return parse_number(tidy_number(text), decimal)
        except ValueError:
            raise fault(path, f"line {line}", f"{what}: {text[:40]!r}: expected a number") from None

    texts = [row[k] if k is not None else "" for row in segment.rows]
    if any(texts):
        pairs = zip(texts, segment.lines, strict=True)
        return np.array([number(text, line, "X_Value") if text else np.nan for text, line in pairs])
    line = max(segment.place - 1, 1)
    steps = {number(text, line, "Delta_X") for text in segment.tags.get("Delta_X", ["1"]) if text}
    if len(steps) != 1:
        shown = " and ".join(f"{step:g} s" for step in sorted(steps)) or "none"
        text = f"Delta_X: {shown}, and no times in the rows; expected one interval, or X_Columns One"
        raise fault(path, f"line {line}", text)
    zero = segment.of_channels("X0", 1, every)[0]
    start = number(zero, line, "X0") if zero else 0.0
    return start + steps.pop() * np.arange(len(segment.rows), dtype=np.float64)


MOST_COLUMNS = 1000  # of a matrix: more are a picture
MOST_NUMBERS = 250_000_000  # in one array: 2 GB, and zeros of that size are compressed to 2 MB
LONGEST = 400  # characters of a text: each row takes as much memory as the longest
DEEPEST = 3  # structs inside each other
NUMBERS = "biuf"  # numpy's kinds of real numbers
# by class: what to type in MATLAB
MATLAB_COMMANDS = {
    "table": "writetable({name}, '{stem}.csv')",
    "timetable": "writetimetable({name}, '{stem}.csv')",
    "datetime": "time_s = seconds({name} - {name}(1)); save('{stem}.mat', 'time_s', '-append')",
    "duration": "time_s = seconds({name}); save('{stem}.mat', 'time_s', '-append')",
}
ANY_COMMAND = "s = struct({name}); save('{stem}.mat', '-struct', 's', '-v7')"
TIMES = ("datetime", "duration")
BROKEN = "cannot be read as .mat: its sizes and kinds do not fit its bytes"
CHILD = "import sys; sys.path[:] = {paths!r}; from rig.records.file_formats import send; send(sys.argv[1], {most})"


def matlab_table(path: Path) -> Table:
    """Return the vectors of one length in a .mat file, in structs and arrays of structs too. Raises Faults."""
    vectors, objects = read_vectors(path)
    meanings = {interpret_name(name).ours for name, _ in vectors}
    for name, kind in objects:
        needed = {"time_s" if kind in TIMES else "temperature_degC"}
        if not needed <= meanings or not meanings & {"temperature_degC", "current_A"}:
            typed = MATLAB_COMMANDS.get(kind, ANY_COMMAND).format(name=name, stem=path.stem)
            raise fault(path, name, f"a MATLAB {kind}, which only MATLAB reads; expected, typed there: {typed}")
    lengths = [values.size for _, values in vectors if values.size >= 2 and values.dtype.kind != "U"]
    if not lengths:
        text = "in a struct or beside each other, or an array of structs with a number in each field"
        raise fault(path, "", f"no vectors of numbers; expected one for each column, {text}")
    lengths += [values.size for name, values in vectors if interpret_name(name).ours is not None]  # each counts twice
    rows = max(set(lengths) - {0, 1}, key=lambda n: (lengths.count(n), n))
    chosen = [(name, values) for name, values in vectors if values.size == rows]
    names = [name for name, _ in chosen]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise Faults([f"{path}: {name!r} appears in more than one struct; expected each name once" for name in twice])
    table = table_from_arrays(dict(chosen), str(path))
    if objects:
        table.notes.append(f"MATLAB objects left out: {', '.join(name for name, _ in objects)}")
    if left := sorted({name for name, values in vectors if values.size not in (1, rows)}):
        table.notes.append(f"left out, of another length: {', '.join(left[:8])}")
    return table


def read_vectors(path: Path) -> tuple[list[tuple[str, Array]], list[tuple[str, str]]]:
    """Return names and vectors, and names and classes of MATLAB's objects, which scipy cannot read.

    A matrix gives a vector for each of its columns, an array of structs one for each field: of text if there is text,
    or if a field has no or several numbers. Raises Faults.
    """
    if not path.is_file():
        raise fault(path, "", "no such file")
    command = [sys.executable, "-c", CHILD.format(paths=sys.path, most=MOST_NUMBERS), str(path)]
    child = subprocess.run(command, capture_output=True, check=False)
    if child.returncode == 2:
        raise Faults(child.stderr.decode(errors="replace").strip().splitlines()[-1:])
    if child.returncode != 0:
        raise fault(path, "", BROKEN)
    vectors, objects = pickle.loads(child.stdout)
    return vectors, objects


def send(path: str, most: int) -> None:
    """Write the vectors, pickled, to stdout, in the process of its own; or a line to stderr, and exit with status 2."""
    try:
        content = _load(Path(path), most)
        found, objects = list(_vectors(content)), _objects(content, Path(path))
    except Faults as faults:
        print(str(faults), file=sys.stderr)
        sys.exit(2)
    sys.stdout.buffer.write(pickle.dumps((found, objects)))


def _load(path: Path, most: int) -> Any:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadWarning

    try:
        try:
            largest = max((math.prod(shape) for _, shape, _ in whosmat(str(path))), default=0)
        except TypeError:  # scipy before 1.18 finds no size of an object
            largest = 0
        if largest > most:
            raise fault(path, "", f"an array of {largest} numbers; expected a record, {most} at most")
        warnings.simplefilter("ignore", MatReadWarning)  # of several objects, which `_objects` reports
        return loadmat(str(path), squeeze_me=True, struct_as_record=False, chars_as_strings=True)
    except Faults:
        raise
    except NotImplementedError:
        raise fault(path, "", "a .mat file of version 7.3; expected save(..., '-v7'), or a CSV file") from None
    except ArithmeticError:  # scipy reads a kind behind the end of its table, and divides by what stands there
        raise fault(path, "", BROKEN) from None
    except Exception as error:  # scipy raises whatever its parser meets in a broken file
        text = " ".join(str(error).split())[:200]
        kind = BROKEN if "cannot reshape" in text else f"cannot be read as .mat: {type(error).__name__}: {text}"
        raise fault(path, "", kind) from None


def _objects(content: Any, path: Path) -> list[tuple[str, str]]:
    """Return names and classes of MATLAB's objects, tables first."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabOpaque, varmats_from_mat

    if not any(isinstance(value, MatlabOpaque) for value in content.values()):
        return []
    found = []
    with path.open("rb") as file:
        for _, one in varmats_from_mat(file):
            for name, value in loadmat(cast(Any, one)).items():
                if isinstance(value, MatlabOpaque):
                    # before scipy 1.18: the name, then the system of the type, and the class
                    fields = list(cast(Any, value).flat[0])[:-1]
                    words = [each.decode() if isinstance(each, bytes) else str(each) for each in fields]
                    found.append((words[0] if len(words) > 2 else name, words[-1]))
    return sorted(found, key=lambda each: "table" not in each[1])


def _vectors(content: Any, depth: int = 0) -> Iterator[tuple[str, Any]]:
    items = content.items() if isinstance(content, dict) else ((n, getattr(content, n)) for n in content._fieldnames)
    for name, value in items:
        values = np.asarray(value)
        if name.startswith("__"):
            continue
        if hasattr(value, "_fieldnames") and depth < DEEPEST:
            yield from _vectors(value, depth + 1)
        elif values.dtype.kind == "O" and values.size and all(hasattr(one, "_fieldnames") for one in values.flat):
            for field in values.flat[0]._fieldnames:
                if (column := _column([getattr(struct, field) for struct in values.flat])) is not None:
                    yield field, column
        elif values.dtype.kind in "OU" and values.ndim == 1 and (column := _column(list(values))) is not None:
            yield name, column  # a cell array, or a matrix of characters
        elif values.dtype.kind in NUMBERS and values.ndim == 1:
            yield name, values
        elif values.dtype.kind in NUMBERS and values.ndim == 2 and values.shape[1] <= MOST_COLUMNS:
            yield from ((f"{name}{k + 1}", values[:, k]) for k in range(values.shape[1]))


def _column(cells: list[Any]) -> Any | None:
    """Return numbers if each cell is one, text if some cell is a number or a text, else None."""
    values = [np.asarray(cell) for cell in cells]
    alone = [value.ndim == 0 and value.dtype.kind in NUMBERS for value in values]
    if values and all(alone):
        return np.array(values)
    if any(alone) or any(value.ndim == 0 and value.dtype.kind == "U" for value in values):
        return np.array([_as_text(value)[:LONGEST].strip() for value in values])
    return None


def _as_text(value: Any) -> str:
    if value.size == 0:
        return ""
    if value.ndim:
        return f"{value.size} values"
    return repr(float(value)) if value.dtype.kind in NUMBERS else str(value)


FEWEST_ROWS = 12  # beside a longer table a shorter one is a summary: no model is fitted to fewer readings
# of a cell with a formula and its value, in the XML of a sheet (ECMA-376, part 1, 18.3.1.40 and 18.3.1.96)
FORMULA = re.compile(rb'<c r="(\w+)"[^>]*><f[ >/].*?(?:</f>|/>)(<v>[^<])?')
MERGED = re.compile(rb"<(?:\w+:)?mergeCell\s[^>]*\bref=[\"'](\w+:\w+)[\"']")  # the same, 18.3.1.54
DATE_TEXT = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{6}")  # of a date in `_cell_text`
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
            sheets[sheet.title] = _read_sheet(sheet, xml, path)
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
        text = f"{missing}: expected the values of formulas, which the file has not; open it in a spreadsheet program "
        text += "and save it, or save it as CSV"
        raise fault(path, f"sheet {title!r}", text)
    down = [area for area in merged if area.max_row > max(area.min_row, table.line_of[0] - 1)]
    if down:
        more = f" and {len(down) - 1} more" if len(down) > 1 else ""
        table.notes.append(f"merged cells taken as the same in each of their rows: {down[0].coord}{more}")
    if len(sheets) > 1:
        table.notes.append(f"sheet {title!r}" + (f" of {', '.join(map(repr, found))}" if len(found) > 1 else ""))
    return replace(table, row_word="row")


def _read_sheet(sheet: Any, xml: bytes, path: Path) -> tuple[str, list[Any], str]:
    """Return a sheet as tab-separated text, numbers to the same bits; the merged cells that hold something, as
    openpyxl's CellRange, which it does not give when it reads by row; and which formulas have no values in the file:
    programs that do not compute leave them out, and a whole column would read as empty."""
    from openpyxl.worksheet.cell_range import CellRange

    areas = (CellRange(area.decode()) for area in MERGED.findall(xml.rpartition(b"sheetData>")[2]))  # below the cells
    merged = sorted(areas, key=lambda a: (a.min_row, a.min_col))
    cells_with_formulas, missing = FORMULA.findall(xml), ""
    if cells_with_formulas and not any(value for _, value in cells_with_formulas):
        others = len(cells_with_formulas) - 1
        missing = cells_with_formulas[0][0].decode() + (f", and {others} more" if others else "")
    sheet.reset_dimensions()  # the file may give its size too small
    rows: list[list[str]] = []
    cells = width = 0
    for row in sheet.iter_rows(values_only=True):
        rows.append([_cell_text(cell) for cell in row])
        cells, width = cells + len(row), max(width, len(row))
        if len(rows) > MOST_ROWS or max(cells, width * len(rows)) > MOST_CELLS:
            most = f"more than {MOST_ROWS} rows or {MOST_CELLS} cells"
            raise fault(path, f"sheet {sheet.title!r}", f"{most}; expected a record")
    for cells_of_row in rows:
        cells_of_row += [""] * (width - len(cells_of_row))
    holding = []
    for area in merged:  # the content is in the first cell; over several columns it belongs to the first of them
        first, column = area.min_row - 1, area.min_col - 1
        content = rows[first][column] if first < len(rows) and column < len(rows[first]) else ""
        if content:
            holding.append(area)
            for row in rows[first : area.max_row]:
                row[column] = content
    for k in range(width):
        dated = [row for row in rows if DATE_TEXT.fullmatch(row[k])]
        if all(row[k].endswith(MIDNIGHT) for row in dated):
            for row in dated:
                row[k] = row[k].removesuffix(MIDNIGHT)
    out = io.StringIO()
    csv.writer(out, delimiter="\t", lineterminator="\n").writerows(rows)
    return out.getvalue(), holding, missing


def _cell_text(cell: Any) -> str:
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
