"""The text in a file: unpacked, decoded; and what a file is that holds no table.

A file's first bytes decide, not its name. In the encodings before UTF-8 numbers are the same bytes and only names and
units differ; the encoding is the one that gives Western letters, signs of units, or Japanese or Chinese column names.
"""

from __future__ import annotations

import codecs
import io
import json
import re
import tomllib
import zlib
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from rig.core.faults import fault

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


def read_text_of(data: bytes, path: Path) -> tuple[str, list[str]]:
    """Return the text in a file's bytes, and notes: what it was compressed with, and its encoding if that is not UTF.
    Raises Faults."""
    packed_by = next((name for mark, name in COMPRESSED if data.startswith(mark)), "")
    notes = [f"unpacked ({packed_by})"] if packed_by else []
    text, encoding = _decode(_unpack(data, packed_by, path) if packed_by else data, path)
    return text, [*notes, f"text in {encoding}"] if encoding else notes


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
