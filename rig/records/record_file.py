"""Records in files: read as labs write them, written as CSV with one header line and units in the names.

A record of ours has the names of `rig.core.reading.OF_A_RECORD`, in any order; more columns are kept. Names and units
of another record are taken if they are clear; otherwise the fault says which --column to type (docs/records.md).

A file's first bytes decide what it is, not its name. In the encodings before UTF-8 numbers are the same bytes and only
names and units differ; the encoding is the one that gives Western letters, signs of units, or Asian names.

The record of a run of ours is read line by line: a week at 10 Hz is 1.2 GB of text, and would be ten times that as
fields. A file that a run would not write is left to the reader of text, which says what is wrong with it.
"""

from __future__ import annotations

import codecs
import csv
import io
import json
import math
import re
import tomllib
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.core.file_writing import writing
from rig.records.branches import RowOrder
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_from_table
from rig.records.file_formats import FIRST_LINE, lvm_table, matlab_table, workbook_table
from rig.records.numbers import UNITS
from rig.records.record import Record, unit_of
from rig.records.table import Column, Table
from rig.records.text_table import text_table

COMPRESSED = ((b"\x1f\x8b", "gzip"), (b"BZh", "bz2"), (b"\xfd7zXZ\x00", "lzma"))
MOST_BYTES = 1_000_000_000  # unpacked: a record of ten million rows
BYTE_ORDER_MARKS = (  # UTF-32's begins as UTF-16's does
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
WESTERN = frozenset("°µ²³±·×ºäöüÄÖÜßéèêëàâçîïôûùÉÈÀÇñóíáúÑåøæÅØÆãõ–—…’“”«»§\u00a0")
ASIAN_WORDS = {
    "cp932": ("時間", "時刻", "日時", "温度", "抵抗", "電流", "℃"),
    "gb18030": ("时间", "日期", "温度", "电阻", "电流", "℃"),
}
PROBED_BYTES = 200_000  # names and units are at the beginning
FILE_KINDS = (
    (b"\x89PNG\r\n", "a picture (PNG)"),
    (b"\xff\xd8\xff", "a picture (JPEG)"),
    (b"GIF8", "a picture (GIF)"),
    (b"%PDF-", "a document (PDF)"),
    (b"\x89HDF\r\n", "an HDF5 file; export its table as CSV"),
    (b"CDF\x01", "a NetCDF file; export its table as CSV"),
    (b"CDF\x02", "a NetCDF file; export its table as CSV"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file; its name has to end in .mat"),
    (b"PK\x03\x04", "an archive (ZIP); if it is a workbook, its name has to end in .xlsx"),
    (b"\xd0\xcf\x11\xe0", "a workbook or document of old (.xls, .doc), or one with a password; save it as CSV"),
)
MOST_TEXT_BYTES = 1_000_000  # of a configuration, a program or a letter
TOML_KINDS = {"a configuration (TOML)": {"bench", "experiment"}, "a model file (TOML)": {"film", "plate"}}


def _unpack(data: bytes, packed_by: str, path: Path) -> bytes:
    try:
        module = import_module(packed_by)
    except ImportError:  # a Python that was built without bz2 or lzma
        raise fault(path, "", f"compressed ({packed_by}), which this Python cannot unpack; unpack it first") from None
    try:
        with module.open(io.BytesIO(data)) as file:
            content: bytes = file.read(MOST_BYTES + 1)
    except EOFError:
        raise fault(path, "", f"compressed ({packed_by}), and cut off; expected the whole file") from None
    except (OSError, zlib.error, getattr(module, "LZMAError", OSError)) as error:
        raise fault(path, "", f"compressed ({packed_by}), and damaged: {error}") from None
    if len(content) > MOST_BYTES:
        raise fault(path, "", f"unpacks to more than {MOST_BYTES / 1e9:g} GB; expected a record")
    return content


def _decode(data: bytes, path: Path) -> tuple[str, str]:
    """Return the text, and the name of its encoding if that is not UTF."""
    encoding = next((name for mark, name in BYTE_ORDER_MARKS if data.startswith(mark)), "") or _unmarked_utf16(data)
    if encoding:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError as error:
            raise fault(path, f"byte {error.start}", f"expected {encoding.upper()}, as its first bytes say") from None
        if "\0" in text:
            raise fault(path, f"line {text.count(chr(10), 0, text.index(chr(0))) + 1}", "a NUL; expected text")
        return text, ""
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise fault(path, f"line {line}", "a NUL byte; expected text (was the file cut off while it was written?)")
    try:
        return data.decode("utf-8"), ""
    except UnicodeDecodeError as error:
        return _decode_code_page(data, path, error.start)


def _unmarked_utf16(data: bytes) -> str:
    """Return the kind of UTF-16 if every second byte of the beginning is 0, as of digits and separators; else ''."""
    head = data[:1000]
    if len(head) < 8:
        return ""
    even, odd = 2 * head[0::2].count(0) / len(head), 2 * head[1::2].count(0) / len(head)
    if odd > 0.8 and even < 0.1:
        return "utf-16-le"
    return "utf-16-be" if even > 0.8 and odd < 0.1 else ""


def _decode_code_page(data: bytes, path: Path, beyond: int) -> tuple[str, str]:
    """Return text of an encoding before UTF-8, and its name; beyond: the first byte that is not UTF-8."""
    head = data[: max(PROBED_BYTES, beyond + 1000)]
    control = sum(head.count(bytes([byte])) for byte in range(32) if byte not in (9, 10, 11, 12, 13, 26))
    if control > 0.01 * len(head) + 2:
        raise fault(path, f"byte {beyond}", "no text; expected a table in UTF-8, UTF-16 or a code page, .xlsx or .mat")
    for encoding, words in ASIAN_WORDS.items():
        text = head.decode(encoding, errors="replace")
        if any(word in text for word in words):
            return data.decode(encoding, errors="replace"), encoding
    strange = {c for c in head.decode("cp1252", errors="replace") if not c.isascii()} - WESTERN
    strange_mac = {c for c in head.decode("mac_roman") if not c.isascii()} - WESTERN - {"Ω", "µ"}
    if strange and not strange_mac:
        return data.decode("mac_roman"), "Mac Roman"
    return data.decode("cp1252", errors="replace"), "cp1252"


def describe_file(path: Path) -> str:
    """Return what a file is that could not be read as a record, as in 'a picture (PNG)'; '' if that is not known."""
    try:
        if not path.is_file():  # a pipe may have no end
            return ""
        with path.open("rb") as file:
            data = file.read(MOST_TEXT_BYTES + 1)
    except OSError:
        return ""
    for mark, kind in FILE_KINDS:
        if data.startswith(mark):
            return kind
    if len(data) > MOST_TEXT_BYTES or b"\0" in data:
        return ""
    text = data.decode("utf-8", errors="replace").lstrip("\ufeff").replace("\r\n", "\n")
    if re.match(r"\s*<(\?xml|!doctype|html|svg)", text, re.IGNORECASE):
        return "an HTML or XML page"
    with suppress(ValueError, RecursionError):
        if isinstance(json.loads(text), (dict, list)):
            return "a JSON file"
    with suppress(ValueError, RecursionError):
        tables = tomllib.loads(text)
        named = [kind for kind, keys in TOML_KINDS.items() if keys & tables.keys()]
        return next(iter(named), "a TOML file" if tables else "")
    return ""


SIGNATURE = {"time_s", "tick", "phase"}  # columns of every run, and together of no other file
WORDS = "phase"  # the only column of words, and the last


def read_run_table(path: Path) -> Table | None:
    """Return the table of a run's own record, of numbers; None if the file is a pipe, or not clearly a run's. Raises
    OSError."""
    if not path.is_file():  # a pipe would lose its first lines
        return None
    notes: list[str] = []
    words: dict[str, float] = {}
    with path.open(encoding="ascii", newline="\n") as file, warnings.catch_warnings(action="error"):
        try:
            names = file.readline().rstrip("\n").split(",")
            if not set(names) >= SIGNATURE or len(set(names)) != len(names) or names[-1] != WORDS:
                return None

            def rows() -> Iterator[str]:
                for number, line in enumerate(file, 2):
                    if line[-1] != "\n" and line.count(",") < len(names) - 1:
                        notes.append(f"line {number} left out, it was cut off")
                        return
                    if line == "\n" or '"' in line:
                        raise ValueError
                    yield line.replace(",,", ",nan,").replace(",,", ",nan,")

            numbers: dict[int | str, Any] = {len(names) - 1: lambda word: words.setdefault(word, float(len(words)))}
            matrix = np.loadtxt(rows(), delimiter=",", comments=None, ndmin=2, converters=numbers)
        except (ValueError, UserWarning):  # no text of ASCII, other fields, one that is no number; or no rows
            return None
    values = dict(zip(names, map(np.ascontiguousarray, matrix.T), strict=True))
    time, phases = values["time_s"], list(words)
    if time.size < 2 or not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0.0):
        return None
    of_phases = [phases[k] for k in values.pop(WORDS).astype(np.intp)]  # one text a phase, not one a row
    table = [*(Column(name, column) for name, column in values.items()), Column(WORDS, of_phases)]
    return Table(str(path), "line 1", table, range(2, 2 + time.size), notes=notes)


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
    """Return the record in a file. Raises Faults, a line for each.

    mappings: the user's --column options; needs: columns that have to be there, besides time_s; decimal: '.' or ',' if
    the user named the sign; options: the user can type --column, so that faults may say what to type; order: of the
    rows, if the file has no times.
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
            return workbook_table(path, decimal)
        if ending == MATLAB:
            return matlab_table(path)
        if not decimal and (table := read_run_table(path)) is not None:
            return table
        data = path.read_bytes()
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except OSError as error:
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    packed_by = next((name for mark, name in COMPRESSED if data.startswith(mark)), "")
    text, encoding = _decode(_unpack(data, packed_by, path) if packed_by else data, path)
    table = lvm_table(text, path) if text.startswith(FIRST_LINE) else text_table(text, path, decimal)
    if ending in WORKBOOKS:
        table.notes.append(f"text, and no workbook as its name ({ending}) says")
    table.notes.extend([f"unpacked ({packed_by})"] * bool(packed_by) + [f"text in {encoding}"] * bool(encoding))
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
