"""The text of a file from its bytes: UTF-8, UTF-16, or what instruments and spreadsheets wrote before those.

Numbers are the same bytes in all of the older encodings; only names and units differ. The older ones are told apart by
what they make of the bytes: letters of Western names, signs of units, or the words of a Japanese or Chinese header.
"""

from __future__ import annotations

import ast
import codecs
import io
import json
import re
import tomllib
import zlib
from importlib import import_module
from pathlib import Path
from typing import Final

from rig.core.faults import fault
from rig.records.column_names import meaning_of

ENCODING_MARKS = (  # the longer marks first: UTF-32's begins as UTF-16's does
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
WESTERN = frozenset("°µ²³±·×ºäöüÄÖÜßéèêëàâçîïôûùÉÈÀÇñóíáúÑåøæÅØÆãõ–—…’“”«»§\u00a0")
HEADER_WORDS = {
    "cp932": ("時間", "時刻", "日時", "温度", "抵抗", "電流", "℃"),
    "gb18030": ("时间", "日期", "温度", "电阻", "电流", "℃"),
}
PROBE_BYTES = 200_000  # names and units stand at the beginning


def decoded(data: bytes, path: Path) -> tuple[str, str]:
    """The text, and its encoding where that is none of UTF. Raises Faults."""
    for mark, encoding in ENCODING_MARKS:
        if data.startswith(mark):
            return _strict(data, encoding, path), ""
    if encoding := _wide(data):
        return _strict(data, encoding, path), ""
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise fault(path, f"line {line}", "a NUL byte; expected text (was the file cut off while it was written?)")
    try:
        return data.decode("utf-8"), ""
    except UnicodeDecodeError as error:
        beyond = error.start
    return _older(data, path, beyond)


def _strict(data: bytes, encoding: str, path: Path) -> str:
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise fault(path, f"byte {error.start}", f"expected {encoding.upper()}, as its first bytes say") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise fault(path, f"line {line}", "a NUL; expected text")
    return text


def _wide(data: bytes) -> str:
    """UTF-16 without a mark: every second byte of the beginning is 0, for it is digits and separators."""
    head = data[:1000]
    if len(head) < 8:
        return ""
    even, odd = head[0::2].count(0), head[1::2].count(0)
    half = len(head) // 2
    if odd > 0.8 * half and even < 0.1 * half:
        return "utf-16-le"
    return "utf-16-be" if even > 0.8 * half and odd < 0.1 * half else ""


def _older(data: bytes, path: Path, beyond: int) -> tuple[str, str]:
    """Text of before UTF-8. Raises Faults where no encoding makes sense of it."""
    head = data[: max(PROBE_BYTES, beyond + 1000)]
    control = sum(head.count(bytes([byte])) for byte in range(32) if byte not in (9, 10, 11, 12, 13, 26))
    if control > 0.01 * len(head) + 2:
        raise fault(path, f"byte {beyond}", "no text; expected a table in UTF-8, UTF-16 or a code page, .xlsx or .mat")
    for encoding, words in HEADER_WORDS.items():
        text = head.decode(encoding, errors="replace")
        if any(word in text for word in words):
            return data.decode(encoding, errors="replace"), encoding
    strange = {c for c in head.decode("cp1252", errors="replace") if not c.isascii()} - WESTERN
    mac = {c for c in head.decode("mac_roman") if not c.isascii()} - WESTERN - {"Ω", "µ"}
    if strange and not mac:
        return data.decode("mac_roman"), "Mac Roman"
    return data.decode("cp1252", errors="replace"), "cp1252"


PACKED_MARKS: Final = (
    (b"\x1f\x8b", "gzip"),
    (b"BZh", "bz2"),
    (b"\xfd7zXZ\x00", "lzma"),
)  # as the formats' definitions fix them
MOST_BYTES: Final = 1_000_000_000  # a record of ten million rows; zeros of that size are packed into a megabyte


def unpacked(data: bytes, path: Path) -> tuple[bytes, str]:
    """What is inside, and what packed it; the bytes themselves and "" where nothing did. Raises Faults."""
    packed_by = next((name for mark, name in PACKED_MARKS if data.startswith(mark)), "")
    if not packed_by:
        return data, ""
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
    return content, packed_by


KIND_MARKS: Final = (  # the first bytes, as the formats' specifications fix them
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
MOST_PROSE_BYTES: Final = 1_000_000  # no configuration, program or letter is longer
FEW_DIGITS: Final = 0.02  # of the characters: a table of numbers has more than half of them
WORD: Final = re.compile(r"[^\W\d_]{2,}")


def other_kind(path: Path) -> str:
    """What the file is, in words; '' where that is not known. It is not opened where it is no regular file."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            data = file.read(MOST_PROSE_BYTES + 1)
    except OSError:
        return ""
    for mark, kind in KIND_MARKS:
        if data.startswith(mark):
            return kind
    if len(data) > MOST_PROSE_BYTES or b"\0" in data:
        return ""
    text = data.decode("utf-8", errors="replace").lstrip("\ufeff").replace("\r\n", "\n")
    return _of_toml(text) or _of_json(text) or _of_python(text) or _of_words(text)


def _of_toml(text: str) -> str:
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError):
        return ""
    if "bench" in tables or "experiment" in tables:
        return "a configuration (TOML)"
    if "film" in tables or "plate" in tables:
        return "a model file (TOML)"
    return "a TOML file" if tables else ""


def _of_json(text: str) -> str:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return ""
    return "a JSON file" if isinstance(found, (dict, list)) else ""


def _of_python(text: str) -> str:
    """A program: it is Python's syntax, and imports or defines something."""
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return ""
    program = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef)
    return "a Python program" if any(isinstance(each, program) for each in body) else ""


def _of_words(text: str) -> str:
    """Mark-up or prose: lines of words with hardly a digit, and none of them names a column."""
    if re.match(r"\s*<(\?xml|!doctype|html|svg)", text, re.IGNORECASE):
        return "an HTML or XML page"
    lines = [line for line in text.splitlines() if line.strip()]
    digits = sum(map(str.isdigit, text))
    if len(lines) < 2 or digits > FEW_DIGITS * len(text) or len(WORD.findall(text)) < 2 * len(lines):
        return ""
    names = re.split(r"[\t;,|]", lines[0])
    return "" if any(meaning_of(name).ours is not None for name in names) else "words without a row of numbers"
