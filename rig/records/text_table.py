"""A table in text: the separator of its fields, the line of names, the units, and the rows below.

The layout is learned from the first thousand lines. Instruments write pages of settings above a table; a line with as
many fields as the rows, none of them a number, may hold the names, and of several such lines the one with most known
names is taken. Blank lines, comments, repeated names, words below the last row and a last line that was cut off are
left out; a row with another number of fields is a fault.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.branches import branch_in_name, has_repeated_names
from rig.records.column_names import interpret_name
from rig.records.numbers import DecimalSign, find_decimal_sign, is_blank, is_number, parse_unit
from rig.records.table import Column, Table
from rig.records.times import is_time

SAMPLED_LINES = 1000  # at the beginning, from which the layout is learned
SAMPLED_CHARACTERS = 1_000_000  # the sample is split with every separator
LONGEST_LINE = 200_000  # characters
FEWEST_VALUES = 2  # of a row: meters write more words than numbers beside a reading
SEPARATORS = ("\t", ";", ",", "|", "")  # "" is blanks
HEADER_LINES = 6  # of names, units and comments above the first row
COMMENT = re.compile(r"\s*(#|%|!|//|;)+\s*")
COMMENT_SIGNS = ("#", "%", "!")
MOST_CLOSING_LINES = 10  # of words below the rows; more are another table
FEW_ROWS = 20  # in fewer, a last number that is shorter than all others proves nothing
SHOWN = 40  # characters of what was left out
MOST_COLUMNS = 2000
Fields = list[str] | Array


@dataclass(frozen=True)
class Layout:
    """The separator of fields, how many there are in a row, and which of them are numbers or times."""

    separator: str
    fields: int
    numeric: frozenset[int]


@dataclass(frozen=True)
class Header:
    """Name and unit of each column, '' if it has none. line: index of the names' line. raw: the header's lines as they
    stand."""

    names: list[str]
    units: list[str]
    line: int
    raw: frozenset[str] = frozenset()


def text_table(text: str, path: Path, decimal: str = "") -> Table:
    """Return the table in a text; decimal: '.' or ',' if the user typed it. Raises Faults."""
    lines = text.rstrip("\x1a\0").splitlines()
    if lines and lines[0].strip() == "IGOR":
        lines = _igor_rows(lines)
    if not any(line.strip() and not line.startswith("#") for line in lines):
        raise fault(path, "line 1", "expected a header line with column names, the file is empty")
    lines = _join_quoted_names(lines)
    sample = _sample(lines, path)
    separators = [one for one in SEPARATORS if not one or any(one in line for line in sample)]
    layouts = [_layout_with([split_line(line, one) for line in sample], one) for one in separators]
    layout = max(filter(None, layouts), key=lambda each: each[0], default=(0.0, None))[1]
    if layout is None:
        line = next(k for k, line in enumerate(lines, 1) if line.strip() and not line.startswith("#"))
        raise fault(path, f"line {line}", "no row of numbers below it; expected names, and rows of numbers below them")
    if layout.fields > MOST_COLUMNS:
        raise fault(path, "", f"{layout.fields} columns; expected at most {MOST_COLUMNS}")
    start = _first_row(lines, layout)
    header = _find_header(lines, start, layout, path)
    columns, line_of, notes = _read_rows(lines, start, layout, header, text, path)
    texts = [column for column in columns if isinstance(column, list)]
    sign = DecimalSign(decimal, False, True) if decimal else find_decimal_sign(texts, layout.separator)
    notes += ["decimal comma"] if sign.sign == "," and not sign.typed else []
    table = [
        Column(name, column, unit)
        for name, column, unit in zip(header.names, columns, header.units, strict=True)
        if name or not isinstance(column, list) or any(field.strip() for field in column)
    ]
    place = f"line {header.line + 1}"
    return Table(str(path), place, table, line_of, named=any(header.names), decimal=sign, notes=notes)


def split_line(line: str, separator: str) -> list[str]:
    """Return a line's fields; quotes hold a field together."""
    if separator == "":
        return line.split()
    if '"' not in line:
        return [field.strip() for field in line.split(separator)]
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def is_value(field: str) -> bool:
    return is_number(field) or is_time(field)


def _sample(lines: list[str], path: Path) -> list[str]:
    """Return the first lines that are neither blank nor comments."""
    sample: list[str] = []
    characters = 0
    for k, line in enumerate(lines[: 4 * SAMPLED_LINES]):
        if len(line) > LONGEST_LINE:
            raise fault(path, f"line {k + 1}", f"{len(line)} characters; expected a table, a row a line")
        characters += len(line)
        if len(sample) >= SAMPLED_LINES or characters > SAMPLED_CHARACTERS:
            break
        if line.strip() and not line.lstrip().startswith(COMMENT_SIGNS):
            sample.append(line)
    return sample


def _layout_with(rows: list[list[str]], separator: str) -> tuple[float, Layout] | None:
    """Return the layout of rows with a separator, and its score: the share of fields that are numbers, times the root
    of the share of lines that are rows."""
    marked = []
    for row in rows:
        values = [is_value(field) for field in row]
        filled = sum(1 for field, value in zip(row, values, strict=True) if value or not is_blank(field))
        if len(row) >= 2 and any(values) and (sum(values) >= FEWEST_VALUES or 2 * sum(values) >= filled):
            marked.append((row, values, filled))
    if not marked:
        return None
    counts = Counter(len(row) for row, _, _ in marked)
    width = max(counts, key=lambda n: (counts[n], n))
    marked = [each for each in marked if len(each[0]) == width]
    share = sum(sum(values) for _, values, _ in marked) / max(1, sum(filled for _, _, filled in marked))
    texts = [sum(1 for row, v, _ in marked if not v[k] and not is_blank(row[k])) for k in range(width)]
    numbers = [sum(1 for _, v, _ in marked if v[k]) for k in range(width)]
    numeric = frozenset(k for k in range(width) if numbers[k] > texts[k])
    return share * (len(marked) / len(rows)) ** 0.5, Layout(separator, width, numeric)


def _first_row(lines: list[str], layout: Layout) -> int:
    """Return the index of the first row. A line above it that is a row but for some fields is a row with a fault."""

    def values_in(line: str) -> tuple[int, bool]:
        row = split_line(line, layout.separator)
        if len(row) != layout.fields:
            return 0, False
        values = [is_value(row[k]) for k in layout.numeric]
        whole = all(v or is_blank(row[k]) for k, v in zip(layout.numeric, values, strict=True))
        return sum(values), whole

    start = next(k for k, line in enumerate(lines) if all(values_in(line)))
    above = start
    while above > 0 and not lines[above - 1].strip():
        above -= 1
    values = values_in(lines[above - 1])[0] if above > 0 else 0
    broken = values > 0 and 2 * values >= len(layout.numeric)
    return above - 1 if broken and above > 1 and lines[above - 2].strip() else start


def _find_header(lines: list[str], start: int, layout: Layout, path: Path) -> Header:
    """Return the names and units in the lines right above the first row that have as many fields; of repeated names
    those get their branch that another line says."""
    found: list[tuple[int, list[str]]] = []
    other: list[tuple[int, int]] = []
    for k in range(start - 1, -1, -1):
        line = lines[k]
        if len(found) == HEADER_LINES:
            break
        if not line.strip():
            continue
        comment = COMMENT.match(line)
        row = _header_fields(line[comment.end() :] if comment else line, layout)
        if row is None:
            other.append((k, len(split_line(line, layout.separator))))
            if comment:
                continue
            break
        if any(is_number(field) for field in row) and found:
            break
        found.append((k, row))
        if len(row) != layout.fields:
            break
    if not found:
        for line_index, fields in other if layout.separator else []:
            if fields >= 2:  # names in another number are a fault, and no title
                hint = " (a decimal comma in a comma-separated file?)" if layout.separator == "," else ""
                text = f"{_fields_text(layout.fields)}, expected {fields}, the names in line {line_index + 1}{hint}"
                raise fault(path, f"line {start + 1}", text)
        return Header([""] * layout.fields, [""] * layout.fields, start)
    named = [each for each in found if not _is_unit_line(each[1])] or found

    def known(line: tuple[int, list[str]]) -> tuple[int, int]:
        """Return how many names of a line are known, and how many there are."""
        return sum(interpret_name(name).ours is not None for name in line[1] if name), sum(map(bool, line[1]))

    place, names = max(named, key=known)
    others = [row for _, row in found if row is not names]
    names = names if len(names) == layout.fields else ["", *names]  # as R writes above numbered rows
    units = next((row for row in others if _is_unit_line(row) and len(row) == layout.fields), [""] * layout.fields)
    for row in others if has_repeated_names(names) else []:
        senses = [branch_in_name(field)[0] for field in row]
        if len(row) == len(names) and senses[0] and {"heating", "cooling"} <= set(senses):
            for k, field in enumerate(row):  # it may stand above the first column of each branch only
                senses[k] = senses[k] if field or not k else senses[k - 1]
            names = [f"{name} {sense}".strip() for name, sense in zip(names, senses, strict=True)]
            break
    units = [unit if parse_unit(unit) is not None else "" for unit in units]
    return Header(names, units, place, frozenset(lines[k].strip() for k, _ in found))


def _header_fields(line: str, layout: Layout) -> list[str] | None:
    """Return a line of names in as many fields as the rows have, or one less, as R writes above numbered rows."""
    if layout.separator:
        row = split_line(line, layout.separator)
        while len(row) > layout.fields and not row[-1]:
            row.pop()
        if len(row) < layout.fields and line.endswith(layout.separator):
            row += [""] * (layout.fields - len(row))
        choices = [row]
    else:  # a unit in brackets belongs to the name before it
        joined = re.sub(r"\s+(?=[\[(][^\[\]()]*[\])])", "\u2007", line.strip())
        joined_fields = [f.replace("\u2007", " ") for f in joined.split()]
        choices = [re.split(r"\s{2,}|\t", line.strip()), joined_fields, line.split()]
    whole = [row for row in choices if len(row) == layout.fields and not all(map(is_value, row))]
    less = [row for row in choices if len(row) == layout.fields - 1 and row and not any(map(is_value, row))]
    found = next(iter(whole + (less if 0 in layout.numeric else [])), None)
    return [field.strip().strip('"') for field in found] if found is not None else None


def _fields_text(count: int) -> str:
    return f"{count} field{'s' * (count != 1)}"


def _is_unit_line(row: Sequence[str]) -> bool:
    """Return True if at least two fields of a line, and half of those that are filled, are units."""
    filled = [field for field in row if field]
    units = sum(1 for field in filled if parse_unit(field) is not None or field in ("%", "1", "-"))
    return units >= 2 and 2 * units >= len(filled)


def _read_rows(
    lines: list[str], start: int, layout: Layout, header: Header, text: str, path: Path
) -> tuple[list[Fields], Sequence[int], list[str]]:
    """Return the fields by column, the line of each row, and notes on what was left out. Raises Faults."""
    body = lines[start:]
    if _ends_within_a_number(body, layout, text):
        whole, places, notes = _read_rows(lines[:-1], start, layout, header, text + "\n", path)
        return whole, places, [*notes, f"line {len(lines)} left out, it may have been cut off: {body[-1][-SHOWN:]!r}"]
    if len(body) > SAMPLED_LINES and '"' not in text and len(layout.numeric) == layout.fields:
        numbers = _read_plain_numbers(body, layout)
        if numbers is not None:
            return numbers, range(start + 1, start + 1 + len(body)), []
    rows, line_of = [], []
    try:
        reader: Any = csv.reader(body, delimiter=layout.separator or " ", skipinitialspace=True)
        for number, row in enumerate(reader if layout.separator else map(str.split, body), 1):
            rows.append(tuple(row))  # Python's garbage collector does not go through tuples of texts again and again
            line_of.append(start + (reader.line_num if layout.separator else number))
    except csv.Error as error:
        raise fault(path, f"from line {start + 1}", f"{error}; expected a table with a field's end in sight") from None
    raw = body if len(rows) == len(body) else None
    cut_off = not text.endswith(("\n", "\r"))
    kept, places, notes = _clean_rows(rows, line_of, raw, layout, header, cut_off, path)
    return [list(column) for column in zip(*kept, strict=True)] or [[] for _ in range(layout.fields)], places, notes


def _ends_within_a_number(body: list[str], layout: Layout, text: str) -> bool:
    """Return True if the last line has no end and a shorter last field than all other rows: '15' of 156.5501 is a
    number, too."""
    if text.endswith(("\n", "\r")) or len(body) <= FEW_ROWS:
        return False
    rows = [split_line(line, layout.separator) for line in body[-SAMPLED_LINES:]]
    if len(rows[-1]) != layout.fields or not is_number(rows[-1][-1]):
        return False
    others = [len(row[-1]) for row in rows[:-1] if len(row) == layout.fields and row[-1]]
    return len(rows[-1][-1]) < min(others, default=0)


def _read_plain_numbers(body: list[str], layout: Layout) -> list[Fields] | None:
    """Return a long table of numbers with points at once; None if it holds anything else."""
    sample = [split_line(line, layout.separator) for line in body[:SAMPLED_LINES]]
    if any(map(is_time, sample[0])):  # 20241020235500 is a date, and a number of no unit
        return None
    decimal = find_decimal_sign(list(zip(*sample, strict=False)), layout.separator)
    if decimal.sign == "," or decimal.ambiguous_points:
        return None
    try:
        matrix = np.loadtxt(body, delimiter=layout.separator or None, comments=None, ndmin=2)
    except ValueError:
        return None
    if matrix.shape != (len(body), layout.fields) or np.any(np.isinf(matrix)):  # 'inf', or too many digits
        return None
    return [np.ascontiguousarray(column) for column in matrix.T]


def _clean_rows(
    rows: list[tuple[str, ...]],
    line_of: Sequence[int],
    raw: list[str] | None,
    layout: Layout,
    header: Header,
    cut_off: bool,
    path: Path,
) -> tuple[list[tuple[str, ...]], Sequence[int], list[str]]:
    """Return rows without comments, blank lines, repeated names, closing words and a last line that was cut off."""
    kept, places, wrong, notes = [], [], [], []
    repeated, end = 0, len(rows)

    def is_closing(row: Sequence[str]) -> bool:
        """Return True for a line without digits, or with other fields than a row and no number among them."""
        digits = any(char.isdigit() for field in row for char in field)
        return not digits or (len(row) != layout.fields and not any(map(is_number, row)))

    while end > max(len(rows) - MOST_CLOSING_LINES, 0) and is_closing(rows[end - 1]):
        end -= 1
    closing = [text for row in rows[end:] if (text := " ".join(" ".join(row).split()))]
    if words := [text for text in closing if text[0] not in COMMENT_SIGNS]:
        notes.append(f"words after the last row left out: {words[0][:SHOWN]!r}{' and more' if len(words) > 1 else ''}")
    for k, row in enumerate(rows[:end]):
        first = row[0].lstrip() if row else ""
        if first.startswith(COMMENT_SIGNS) or (not first and not any(map(str.strip, row))):
            continue
        if raw is not None and raw[k].strip() in header.raw:
            repeated += 1
            continue
        while len(row) > layout.fields and not row[-1].strip():
            row = row[:-1]
        if len(row) == layout.fields:
            kept.append(row)
            places.append(line_of[k])
        elif k == len(rows) - 1 and len(row) < layout.fields and cut_off:
            notes.append(f"line {line_of[k]} left out, it was cut off")
        else:
            wrong.append((line_of[k], len(row)))
    if wrong:
        line, fields = wrong[0]
        more = f" ({len(wrong)} such lines, to line {wrong[-1][0]})" if len(wrong) > 1 else ""
        raise fault(path, f"line {line}", f"{_fields_text(fields)}, expected {layout.fields}{more}")
    if repeated:
        notes.append(f"names again among the rows ({repeated} lines)")
    return kept, places, notes


def _igor_rows(lines: list[str]) -> list[str]:
    """Return an Igor text with the names after its first WAVES and the rows between BEGIN and END, in their lines."""
    kept: list[str] = []
    inside = named = False
    for line in map(str.strip, lines):
        if line == "END" and named:
            break
        names = re.split(r"[\s,]+", line)[1:] if not named and line.upper().startswith("WAVES") else []
        kept.append("\t".join(names) or (line if inside else ""))
        inside, named = inside or line == "BEGIN", named or bool(names)
    return kept


def _join_quoted_names(lines: list[str]) -> list[str]:
    """Return lines with a name in quotes that goes over several lines, as spreadsheets write it, in one line."""
    for k, line in enumerate(lines[: HEADER_LINES + 40]):
        if line.count('"') % 2 and k + 1 < len(lines) and len(line) < 2000:
            for end in range(k + 1, min(k + 4, len(lines))):
                if lines[end].count('"') % 2:
                    joined = " ".join(lines[k : end + 1])
                    return lines[:k] + [""] * (end - k) + [joined] + lines[end + 1 :]
    return lines
