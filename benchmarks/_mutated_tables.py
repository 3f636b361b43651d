"""Workbooks and MATLAB files made bad: inside their packing, where bytes changed from outside seldom get."""

from __future__ import annotations

import io
import random
import re
import zipfile
import zlib
from typing import Any

import numpy as np
from openpyxl import Workbook
from scipy.io import savemat

BOMB_BYTES = 400_000_000  # of blanks, which are packed into some 400 kB
CELLS = ["", "x", "1e308", "-1", "nan", "9" * 400, "1e999", "#DIV/0!", "TRUE", "&lt;", "-0", "1,5", "a" * 100_000]
ATTRIBUTES = ["A1:XFD1048576", "XFD1048576", "A0", "ZZZZ9", "", "-1", "9" * 30, "s", "d", "inlineStr", "e", "b"]
MARKUP = [
    b"<row r='1048576'><c r='XFD1048576'><v>1</v></c></row></sheetData>",
    b"</sheetData></sheetData>",
    b"<sheetData>" * 500,
    b"<row>" * 5000,
    b"<!DOCTYPE a [<!ENTITY b 'bb'>]>",
    b"<c><f>1/0</f></c></sheetData>",
    b"<c t='s'><v>99999999</v></c></sheetData>",
]
ARRAYS: list[Any] = [
    np.zeros(0),
    np.zeros((3, 3, 3)),
    np.zeros((2, 5000)),
    np.full(40, np.nan),
    np.full(40, np.inf),
    np.linspace(0.0, 1.7e308, 40),
    np.arange(40, dtype=np.int8),
    np.arange(40) * 1j,
    np.array(["a", "b"], dtype=object),
    np.arange(41.0),
    np.array(5.0),
    {"time_s": np.arange(3.0), "deeper": {"time_s": np.arange(3.0)}},
    "a word",
]


def workbook(rows: list[list[Any]]) -> bytes:
    """A workbook of one sheet."""
    book, out = Workbook(), io.BytesIO()
    assert book.active is not None
    for row in rows:
        book.active.append(row)
    book.save(out)
    return out.getvalue()


def matlab(columns: dict[str, Any], packed: bool = True) -> bytes:
    """A .mat file of version 5."""
    out = io.BytesIO()
    savemat(out, columns, do_compression=packed)
    return out.getvalue()


def bad_workbook(content: bytes, chance: random.Random) -> bytes:
    """One of its files changed, gone, twice, or far too large."""
    with zipfile.ZipFile(io.BytesIO(content)) as package:
        files = [(name, package.read(name)) for name in package.namelist()]
    at = chance.randrange(len(files))
    sheet = next((k for k, (name, _) in enumerate(files) if "sheet1" in name), at)
    at = sheet if chance.random() < 0.6 else at
    name, text = files[at]
    way = chance.randrange(8)
    if way == 0:
        files[at] = (name, text.replace(b"<sheetData>", b"<sheetData>" + b" " * BOMB_BYTES))
    elif way == 1:
        del files[at]
    elif way == 2:
        files.append((name.upper(), text[: len(text) // 2]))
    elif way == 3:
        spot = chance.randrange(len(text))
        files[at] = (name, text[:spot] + chance.choice([*MARKUP, b"\0", b"\xff", b"<", b"&b;"]) + text[spot:])
    elif way == 4:
        files[at] = (name, text.replace(b"</sheetData>", chance.choice(MARKUP)))
    else:
        pattern, others = (rb"<v>[^<]*</v>", CELLS) if way < 7 else (rb'"[^"]*"', ATTRIBUTES)
        if spots := list(re.finditer(pattern, text)):
            found, new = chance.choice(spots), chance.choice(others).encode()
            new = b"<v>" + new + b"</v>" if way < 7 else b'"' + new + b'"'
            files[at] = (name, text[: found.start()] + new + text[found.end() :])
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as package:
        for name, text in files:
            package.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)
    return out.getvalue()


def bad_matlab(content: bytes, chance: random.Random) -> bytes:
    """Other arrays in it, or bytes changed below its compression; a size that it does not have."""
    time_s = np.arange(40.0)
    columns: dict[str, Any] = {"time_s": time_s, "temperature_degC": 40.0 + time_s, "resistance_ohm": 1e5 - time_s}
    name = chance.choice(list(columns))
    if chance.random() < 0.3:
        return matlab({**columns, name: chance.choice(ARRAYS)}, chance.random() < 0.5)
    if chance.random() < 0.1:
        return matlab({**columns, name: np.zeros(BOMB_BYTES // 8)})
    plain = bytearray(matlab(columns, packed=False))
    for _ in range(chance.choice([1, 1, 2, 8])):
        plain[chance.randrange(128, len(plain))] = chance.choice([0, 1, 0x7F, 0xFF, chance.randrange(256)])
    if chance.random() < 0.5:
        return bytes(plain)
    packed = zlib.compress(bytes(plain[128:]))
    return bytes(plain[:128]) + (15).to_bytes(4, "little") + len(packed).to_bytes(4, "little") + packed
