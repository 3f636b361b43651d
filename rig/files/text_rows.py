"""The rows of a table in text, by column: at once where they are numbers and nothing else, else field by field.

Blank lines, comments, names that stand again after a restart, words behind the last row and a last line that was cut
off are left out; a row with another number of fields is a fault.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.files.field_numbers import number_like, signs_of
from rig.files.text_form import SAMPLE, Form, divided_line
from rig.files.text_head import Head

COMMENTED_ROW = re.compile(r"[\r\n]\s*[#%!]")
COMMENT = ("#", "%", "!")
DIGIT = re.compile(r"\d")
MOST_FAULTS = 20  # a file: more lines are read by nobody
MOST_CLOSING = 10  # lines of words behind the rows; more are another table
FEW_ROWS = 20  # of fewer, a last number that is shorter than all others is no wonder
SHOWN = 40  # characters of what was left out
BLOCK_ROWS = 500  # read at a time: few enough lists that Python's collector does not go through them again and again
Fields = list[str] | Array


def columns_of(
    lines: list[str], start: int, form: Form, head: Head, text: str, path: Path
) -> tuple[list[Fields], Sequence[int], list[str]]:
    """Fields by column, the line of each row, and what was left out. Raises Faults: a row with other fields."""
    body = lines[start:]
    if _ends_within_a_number(body, form, text):
        whole, places, said = columns_of(lines[:-1], start, form, head, text + "\n", path)
        return whole, places, [*said, f"line {len(lines)} left out, it may have been cut off: {body[-1][-SHOWN:]!r}"]
    repeated = any(text.count(raw) > 1 for raw in head.raw if raw)
    blank = form.separator != "" and form.separator * (form.fields - 1) in text
    plain = not (repeated or blank or COMMENTED_ROW.search(text))
    if plain and len(body) > SAMPLE and '"' not in text and len(form.numeric) == form.fields:
        numbers = _plain_numbers(body, form)
        if numbers is not None:
            return numbers, range(start + 1, start + 1 + len(body)), []
    try:
        columns = _in_blocks(body, form) if plain else None
        if columns is not None and len(columns[0]) == len(body):
            return list(columns), range(start + 1, start + 1 + len(body)), []
        rows, line_of = _all_rows(body, start, form)
    except csv.Error as error:
        raise fault(path, f"from line {start + 1}", f"{error}; expected a table with a field's end in sight") from None
    kept, places, said = _sorted_out(rows, line_of, body if len(rows) == len(body) else None, form, head, text, path)
    return [list(column) for column in zip(*kept, strict=True)] or [[] for _ in range(form.fields)], places, said


def _ends_within_a_number(body: list[str], form: Form, text: str) -> bool:
    """Whether the last line has no end, and its last field fewer characters than every other row's: 156.5501 of which
    15 was written is a number, too."""
    if text.endswith(("\n", "\r")) or len(body) <= FEW_ROWS:
        return False
    rows = [divided_line(line, form.separator) for line in body[-SAMPLE:]]
    if len(rows[-1]) != form.fields or not number_like(rows[-1][-1]):
        return False
    others = [len(row[-1]) for row in rows[:-1] if len(row) == form.fields and row[-1]]
    return len(rows[-1][-1]) < min(others, default=0)


def _plain_numbers(body: list[str], form: Form) -> list[Fields] | None:
    """Long tables of nothing but numbers with points, at once; None where they are something else."""
    sample = [divided_line(line, form.separator) for line in body[:SAMPLE]]
    signs = signs_of(list(zip(*sample, strict=False)), form.separator)
    if signs.decimal == "," or signs.points_open:
        return None
    try:
        matrix = np.loadtxt(body, delimiter=form.separator or None, comments=None, ndmin=2)
    except ValueError:
        return None
    if matrix.shape != (len(body), form.fields) or np.any(np.isinf(matrix)):  # 'inf', or more digits than a number has
        return None
    return [np.ascontiguousarray(column) for column in matrix.T]


def _in_blocks(body: list[str], form: Form) -> list[list[str]] | None:
    """Fields by column, some hundred rows at a time; None where a row has another number of them."""
    columns: list[list[str]] = [[] for _ in range(form.fields)]
    reader = _reader(body, form)
    while rows := list(islice(reader, BLOCK_ROWS)):
        if set(map(len, rows)) != {form.fields}:
            return None
        for column, fields in zip(columns, zip(*rows, strict=True), strict=True):
            column.extend(fields)
    return columns


def _reader(body: list[str], form: Form) -> Any:
    if not form.separator:
        return (line.split() for line in body)
    return csv.reader(body, delimiter=form.separator, skipinitialspace=True)


def wrong_width(path: Path, line: int, fields: int, expected: int) -> str:
    """A fault's line about a row with another number of fields."""
    return f"{path}: line {line}: {fields} field{'s' * (fields != 1)}, expected {expected}"


def _all_rows(body: list[str], start: int, form: Form) -> tuple[list[list[str]], list[int]]:
    """Every row with the line that it ends in."""
    reader = _reader(body, form)
    if not form.separator:
        return list(reader), list(range(start + 1, start + 1 + len(body)))
    rows, line_of = [], []
    for row in reader:
        rows.append(row)
        line_of.append(start + reader.line_num)
    return rows, line_of


def _end_of_numbers(rows: list[list[str]], form: Form) -> int:
    """Behind the last row that has a number: programs write words there ("End of data"), a few lines of them."""
    end = len(rows)
    while end > max(len(rows) - MOST_CLOSING, 0) and _only_words(rows[end - 1], form):
        end -= 1
    return end


def _only_words(row: list[str], form: Form) -> bool:
    """Without a digit; or with one somewhere, as in a clock's time, and no row of the table."""
    return not any(map(DIGIT.search, row)) or (len(row) != form.fields and not any(map(number_like, row)))


def _sorted_out(
    rows: list[list[str]],
    line_of: Sequence[int],
    body: list[str] | None,
    form: Form,
    head: Head,
    text: str,
    path: Path,
) -> tuple[list[list[str]], Sequence[int], list[str]]:
    """Rows without comments, blank lines, names that are written again and a last line that was cut off."""
    kept: list[list[str]] = []
    places: list[int] = []
    faults: list[str] = []
    more = 0
    said: list[str] = []
    again, end = 0, _end_of_numbers(rows, form)
    closing = [text for row in rows[end:] if (text := " ".join(" ".join(row).split()))]
    if words := [text for text in closing if text[0] not in COMMENT]:
        said.append(f"words after the last row left out: {words[0][:SHOWN]!r}{' and more' if len(words) > 1 else ''}")
    for k, row in enumerate(rows[:end]):
        if not any(field.strip() for field in row) or row[0].lstrip()[:1] in COMMENT:
            continue
        if body is not None and body[k].strip() in head.raw:
            again += 1
            continue
        while len(row) > form.fields and not row[-1].strip():
            row = row[:-1]
        if len(row) == form.fields:
            kept.append(row)
            places.append(line_of[k])
        elif k == len(rows) - 1 and len(row) < form.fields and not text.endswith(("\n", "\r")):
            said.append(f"line {line_of[k]} left out, it was cut off")
        elif len(faults) < MOST_FAULTS:
            faults.append(wrong_width(path, line_of[k], len(row), form.fields))
        else:
            more += 1
    if faults:
        raise Faults([*faults, *([f"{path}: and {more} more lines like these"] if more else [])])
    if again:
        said.append(f"names again among the rows ({again} lines)")
    return kept, places, said
