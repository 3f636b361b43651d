"""What a file is that was given in the place of a record and could not be read as one: a picture, a program, prose.

It is looked for only where the reading failed, so that nothing that could be read is refused for its looks.
"""

from __future__ import annotations

import ast
import json
import re
import tomllib
from pathlib import Path
from typing import Final

from rig.files.column_meaning import meaning_of

MARKS: Final = (  # the first bytes, as the formats' specifications fix them
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
MOST_BYTES: Final = 1_000_000  # no configuration, program or letter is longer
FEW_DIGITS: Final = 0.02  # of the characters: a table of numbers has more than half of them
WORD: Final = re.compile(r"[^\W\d_]{2,}")


def other_kind(path: Path) -> str:
    """What the file is, in words; '' where that is not known. It is not opened where it is no regular file."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError:
        return ""
    for mark, kind in MARKS:
        if data.startswith(mark):
            return kind
    if len(data) > MOST_BYTES or b"\0" in data:
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
