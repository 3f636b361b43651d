"""Good inputs made bad: by bytes, and by what TOML, JSON or CSV make of them. Chance is a random.Random, given."""

from __future__ import annotations

import copy
import csv
import io
import json
import random
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import tomli_w

from benchmarks._mutated_tables import bad_matlab, bad_workbook

DIGITS = "9" * 5000
ENCODINGS = ["utf-16", "utf-32", "cp037", "utf-8-sig"]
BROKEN = (  # no TOML, JSON, CSV or workbook any more
    *(ValueError, IndexError, KeyError, TypeError, RecursionError, csv.Error),
    *(OSError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error),
)
NUMBERS = [
    "0",
    "-1",
    "1",
    "1e308",
    "-1e308",
    "1e-9",
    "1e-320",
    "1e9",
    "1e999",
    "nan",
    "inf",
    "-inf",
    DIGITS,
    "0x" + "f" * 40,
]
WORDS = [
    "",
    " ",
    "\\u0000",
    "é",
    "\U0001f321",
    "a" * 200_000,
    "../../etc/passwd",
    "/dev/zero",
    "/",
    "sim://",
    "{}",
    "%s%n",
    "#?%",
]
VALUES: list[Any] = [
    0,
    -1,
    1,
    2,
    10**6,
    10**9,
    10**12,
    2**63 - 1,
    -(2**63),
    0.0,
    -0.0,
    1e308,
    -1e308,
    1e-9,
    1e-320,
    1e9,
    5e-324,
    0.5,
    float("nan"),
    float("inf"),
    -float("inf"),
    True,
    False,
    "",
    "x",
    "\0",
    "é",
    "a" * 100_000,
    "../x",
    "/dev/zero",
    "/",
    "1",
    "1e308",
    [],
    {},
    [1],
    [1, 2],
    [2, 1],
    [1e308, -1e308],
    ["a"],
    [[]],
    [0.0] * 5000,
    {"a": 1},
    [{"name": "x"}],
]
JUNK = [
    b"\0",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\xed\xa0\x80",
    b"\r",
    b"\n\n",
    b'"',
    b"'''",
    b"[" * 3000,
    b"{a=" * 2000,
    b"a." * 3000 + b"a=1\n",
    b",",
    b";",
    b"=",
    b"#",
    DIGITS.encode(),
    b"1e308",
    b"-",
    b"inf",
    b"x" * 200_000,
    b'"' + b"y" * 140_000,
]


def by_bytes(content: bytes, chance: random.Random) -> bytes:
    """Cut, doubled, moved, inserted, overwritten, in another encoding."""
    size = len(content)
    at, wide = chance.randrange(size + 1), chance.choice([1, 1, 2, 8, 60, 400])
    ways: list[Callable[[], bytes]] = [
        lambda: content[:at],
        lambda: content[at:],
        lambda: content[:at] + content[at + wide :],
        lambda: content[:at] + content[at : at + wide] * chance.choice([2, 3, 50]) + content[at + wide :],
        lambda: content[:at] + chance.choice(JUNK) + content[at:],
        lambda: content[:at] + chance.choice(JUNK) + content[at + wide :],
        lambda: content[:at] + chance.randbytes(wide) + content[at + wide :],
        lambda: _lines(content, chance),
        lambda: content.decode("utf-8", "replace").encode(chance.choice(ENCODINGS), "replace"),
        lambda: content.replace(b"\n", chance.choice([b"\r\n", b"\r", b"", b"\x0b", b"\xe2\x80\xa8"])),
        lambda: b"",
    ]
    return chance.choice(ways)()


def _lines(content: bytes, chance: random.Random) -> bytes:
    lines = content.split(b"\n")
    chance.choice([chance.shuffle, lambda some: some.append(chance.choice(some)), lambda some: some.reverse()])(lines)
    return b"\n".join(lines)


def in_tree(tree: Any, chance: random.Random) -> None:
    """One entry of tables and lists inside each other: another value, another name, gone, or there twice."""
    where = chance.choice(_places(tree))
    holder, key = where
    way = chance.randrange(6)
    if way <= 2:
        holder[key] = copy.deepcopy(chance.choice(VALUES))
    elif way == 3:
        del holder[key]
    elif isinstance(holder, dict):
        value = holder.pop(key) if way == 4 else copy.deepcopy(holder[key])
        holder[f"{key}{chance.choice(['x', '', '.', ' '])}"] = value
    else:
        holder.extend([copy.deepcopy(holder[key])] * chance.choice([1, 50]))


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    left = [tree]
    while left:
        holder = left.pop()
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            found.append((holder, key))
            if isinstance(holder[key], (dict, list)) and len(found) < 2000:
                left.append(holder[key])
    return found or [({"": 0}, "")]


def toml(content: bytes, chance: random.Random) -> bytes:
    """A TOML file with one or some entries changed."""
    text = content.decode()
    if chance.random() < 0.25:
        lines = [k for k, line in enumerate(text.splitlines()) if "=" in line]
        at, changed = chance.choice(lines), text.splitlines()
        raw = chance.choice([*NUMBERS, *(f'"{word}"' for word in WORDS), "[" * 2000 + "]" * 2000, "1979-05-27", "{}"])
        changed[at] = changed[at].partition("=")[0] + "= " + raw
        return "\n".join(changed).encode()
    tree = tomllib.loads(text)
    for _ in range(chance.choice([1, 1, 1, 2, 5])):
        in_tree(tree, chance)
    try:
        return tomli_w.dumps(tree).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError):
        return by_bytes(content, chance)


def json_text(content: bytes, chance: random.Random) -> bytes:
    """JSON, or JSON lines, with one or some entries changed."""
    lines = content.decode().splitlines() if content.count(b"\n{") else [content.decode()]
    at = chance.randrange(len(lines))
    try:
        tree = {"root": json.loads(lines[at])}
    except ValueError:
        return by_bytes(content, chance)
    for _ in range(chance.choice([1, 1, 2])):
        in_tree(tree, chance)
    lines[at] = json.dumps(tree.get("root"))
    if chance.random() < 0.1:
        lines[at] = chance.choice(["[" * 5000, DIGITS, '"\\ud800"', "null", "NaN", '{"a":' * 3000])
    return "\n".join(lines).encode()


def table(content: bytes, chance: random.Random) -> bytes:
    """A CSV file with cells, rows or columns changed."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    width = len(rows[0])
    way, row, column = chance.randrange(7), chance.randrange(len(rows)), chance.randrange(width)
    if way <= 2:
        for _ in range(chance.choice([1, 1, 5, 200])):
            rows[chance.randrange(len(rows))][chance.randrange(width)] = chance.choice([*NUMBERS, *WORDS, "1,5", "-5"])
    elif way == 3:
        rows = [[*cells[:column], *cells[column + 1 :]] for cells in rows]
    elif way == 4:
        rows = [[*cells, cells[column]] for cells in rows]
    elif way == 5:
        value = chance.choice(NUMBERS)
        rows = [rows[0], *([*cells[:column], value, *cells[column + 1 :]] for cells in rows[1:])]
    else:
        rows = [rows[0], *rows[row:]] if chance.random() < 0.5 else rows[: row + 1] + rows[row : row + 1]
    text = io.StringIO()
    csv.writer(text, delimiter=chance.choice(",,,;\t"), lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "surrogatepass")


WAYS = {
    "toml": toml,
    "json": json_text,
    "jsonl": json_text,
    "csv": table,
    "xlsx": bad_workbook,
    "mat": bad_matlab,
}


def mutated(name: str, content: bytes, chance: random.Random) -> bytes:
    """A file made bad in one of the ways that go with its name."""
    own = WAYS.get(name.rpartition(".")[2])
    if own is None or not content or chance.random() < 0.35:
        return by_bytes(content, chance)
    try:
        return own(content, chance)
    except BROKEN:
        return by_bytes(content, chance)
