"""A table in text: what parts its fields, which line has the names and their units, and the rows below.

The form is learned from the first thousand lines that say something: the separator with which most fields are numbers,
the number of fields that most lines have, and the fields that are numbers in most of them. Instruments write pages of
settings above a table; what has as many fields as the rows and none that is a number may be its names. Of several such
lines the one that says most of what is known here is taken. Blank lines, comments, names that stand again after a
restart, words behind the last row and a last line that was cut off are left out; a row with another number of fields is
a fault.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.branches import names_twice, sense_in
from rig.records.column_names import meaning_of
from rig.records.numbers import Signs, blank_like, number_like, signs_of
from rig.records.table import Column, Table
from rig.records.times import time_like
from rig.records.units import spelled

SAMPLE = 1000  # lines
FEW_VALUES = 2  # that make a row: meters write more words than numbers beside a reading
SEPARATORS = ("\t", ";", ",", "|", "")  # "" is blanks
LONGEST_LINE = 200_000  # characters
MOST_CHARACTERS = 1_000_000  # of a sample: it is looked at with every separator


@dataclass(frozen=True)
class Form:
    """How a table is written: what parts its fields, how many there are, and which of them are numbers or times."""

    separator: str
    fields: int
    numeric: frozenset[int]


def divided_line(line: str, separator: str) -> list[str]:
    """A line's fields. Quotes hold a field together."""
    if separator == "":
        return line.split()
    if '"' not in line:
        return [field.strip() for field in line.split(separator)]
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])]
    except csv.Error:
        return []


def is_value(field: str) -> bool:
    return number_like(field) or time_like(field)


def sample_of(lines: list[str], path: Path) -> list[str]:
    """Lines of the beginning that say something, as many as can be looked at in no time. Raises Faults."""
    sample: list[str] = []
    characters = 0
    for k, line in enumerate(lines[: 4 * SAMPLE]):
        if len(line) > LONGEST_LINE:
            raise fault(path, f"line {k + 1}", f"{len(line)} characters; expected a table, a row a line")
        characters += len(line)
        if len(sample) >= SAMPLE or characters > MOST_CHARACTERS:
            break
        if line.strip() and not line.lstrip().startswith(("#", "%", "!")):
            sample.append(line)
    return sample


def form_of(sample: list[str]) -> Form | None:
    """What most lines of the beginning have in common; None where there are no rows of numbers."""
    best: tuple[float, Form] | None = None
    for separator in SEPARATORS:
        if separator and not any(separator in line for line in sample):
            continue
        found = _form_with([divided_line(line, separator) for line in sample], separator)
        if found is not None and (best is None or found[0] > best[0]):
            best = found
    return best[1] if best is not None else None


def _form_with(rows: list[list[str]], separator: str) -> tuple[float, Form] | None:
    """The form that rows have, and the share of fields that it makes numbers of, times the share of rows."""
    marked = []
    for row in rows:
        values = [is_value(field) for field in row]
        filled = sum(1 for field, value in zip(row, values, strict=True) if value or not blank_like(field))
        if len(row) >= 2 and any(values) and (sum(values) >= FEW_VALUES or 2 * sum(values) >= filled):
            marked.append((row, values, filled))
    if not marked:
        return None
    counts = Counter(len(row) for row, _, _ in marked)
    width = max(counts, key=lambda n: (counts[n], n))
    marked = [each for each in marked if len(each[0]) == width]
    share = sum(sum(values) for _, values, _ in marked) / max(1, sum(filled for _, _, filled in marked))
    texts = [sum(1 for row, v, _ in marked if not v[k] and not blank_like(row[k])) for k in range(width)]
    numbers = [sum(1 for _, v, _ in marked if v[k]) for k in range(width)]
    numeric = frozenset(k for k in range(width) if numbers[k] > texts[k])
    return share * (len(marked) / len(rows)) ** 0.5, Form(separator, width, numeric)


def _fits(row: Sequence[str], form: Form) -> bool:
    """Whether fields are a row of the table: numbers, times or nothing where the others have numbers."""
    if len(row) != form.fields:
        return False
    values = [is_value(row[k]) for k in form.numeric]
    return any(values) and all(v or blank_like(row[k]) for k, v in zip(form.numeric, values, strict=True))


def first_row(lines: list[str], form: Form) -> int:
    """The line of the first row. A line above it that is a row but for one field belongs to it: it has a fault."""
    start = next(k for k, line in enumerate(lines) if _fits(divided_line(line, form.separator), form))
    above = start
    while above > 0 and not lines[above - 1].strip():
        above -= 1
    row = divided_line(lines[above - 1], form.separator) if above > 0 else []
    values = sum(is_value(row[k]) for k in form.numeric) if len(row) == form.fields else 0
    broken = values > 0 and 2 * values >= len(form.numeric)
    return above - 1 if broken and above > 1 and lines[above - 2].strip() else start


HEADER_LINES = 6  # names, units, comments and what else stands above the first row
COMMENT = re.compile(r"\s*(#|%|!|//|;)+\s*")


@dataclass(frozen=True)
class Head:
    """The lines of names above the first row, the nearest first, in fields; line: the names'; raw: as they stand."""

    rows: list[list[str]]
    line: int
    raw: frozenset[str]
    index_column: bool = False


def head_of(lines: list[str], start: int, form: Form, igor_names: list[str] | None, path: Path) -> Head:
    """What stands right above the first row and has as many fields."""
    if igor_names is not None:
        return Head([igor_names] if len(igor_names) == form.fields else [], 0, frozenset())
    found: list[tuple[int, list[str]]] = []
    other: list[tuple[int, int]] = []
    k = start
    while k > 0 and len(found) < HEADER_LINES:
        k -= 1
        line = lines[k]
        if not line.strip():
            continue
        comment = COMMENT.match(line)
        row = _header_fields(line[comment.end() :] if comment else line, form)
        if row is None:
            other.append((k, len(divided_line(line, form.separator))))
            if comment:
                continue
            break
        if any(number_like(field) for field in row) and found:
            break
        found.append((k, row))
        if len(row) != form.fields:
            break
    if not found:
        _told_apart(other, start, form, path)
        return Head([], start, frozenset())
    named = [(line, row) for line, row in found if not _is_units(row)] or found
    place, names = max(named, key=lambda each: (_recognised(each[1]), sum(map(bool, each[1]))))
    rows = [names, *(row for _, row in found if row is not names)]
    return Head(rows, place, frozenset(lines[k].strip() for k, _ in found), len(names) != form.fields)


def _header_fields(line: str, form: Form) -> list[str] | None:
    """A line of names in as many fields as the rows have; R writes one less where the first column counts them."""
    if form.separator:
        row = divided_line(line, form.separator)
        while len(row) > form.fields and not row[-1]:
            row.pop()
        if len(row) < form.fields and line.endswith(form.separator):
            row += [""] * (form.fields - len(row))
        choices = [row]
    else:
        joined = re.sub(r"\s+(?=[\[(][^\[\]()]*[\])])", "\u2007", line.strip())
        choices = [
            re.split(r"\s{2,}|\t", line.strip()),
            [f.replace("\u2007", " ") for f in joined.split()],
            line.split(),
        ]
    for row in choices:
        if len(row) == form.fields and not all(map(is_value, row)):
            return [field.strip().strip('"') for field in row]
    for row in choices:
        if len(row) == form.fields - 1 and row and not any(map(is_value, row)) and 0 in form.numeric:
            return [field.strip().strip('"') for field in row]
    return None


def _told_apart(other: list[tuple[int, int]], start: int, form: Form, path: Path) -> None:
    """A line of names right above the rows that has another number of fields is a fault, not a title."""
    for line, fields in other:
        if fields >= 2 and form.separator:
            hint = " (a decimal comma in a comma-separated file?)" if form.separator == "," else ""
            text = (
                f"{form.fields} field{'s' * (form.fields != 1)}, expected {fields}, the names in line {line + 1}{hint}"
            )
            raise fault(path, f"line {start + 1}", text)


def _recognised(row: Sequence[str]) -> int:
    return sum(1 for field in row if field and meaning_of(field).ours is not None)


def _is_units(row: Sequence[str]) -> bool:
    """Whether a line is one of units: half of what it says is, and at least two fields are."""
    filled = [field for field in row if field]
    units = sum(1 for field in filled if spelled(field) is not None or field in ("%", "1", "-"))
    return units >= 2 and 2 * units >= len(filled)


def names_and_units(head: Head, above: Sequence[str], form: Form) -> tuple[list[str], list[str]]:
    """Names and units by column; both '' where there are none."""
    empty = [""] * form.fields
    if not head.rows:
        return empty, empty
    names = ["", *head.rows[0]] if head.index_column else head.rows[0]
    units = next((row for row in head.rows[1:] if _is_units(row) and len(row) == form.fields), empty)
    units = [unit if spelled(unit) is not None else "" for unit in units]
    return _with_senses(list(names), head), units


def _with_senses(names: list[str], head: Head) -> list[str]:
    """Names that stand twice, with heating or cooling behind them where another line above the rows says which is
    which; it may do so at the first column of each only."""
    for row in head.rows[1:] if names_twice(names) else []:
        senses = [sense_in(field)[0] for field in row]
        if len(row) == len(names) and senses[0] and {"heating", "cooling"} <= set(senses):
            last, named = "", []
            for name, sense, field in zip(names, senses, row, strict=True):
                last = sense if field else last
                named.append(f"{name} {last}".strip())
            return named
    return names


COMMENTED_ROW = re.compile(r"[\r\n]\s*[#%!]")
COMMENT_SIGNS = ("#", "%", "!")
DIGIT = re.compile(r"\d")
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
    if any(map(time_like, sample[0])):  # 20241020235500 is a number, and none of seconds
        return None
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


def _wrong_widths(path: Path, wrong: Sequence[tuple[int, int]], expected: int) -> Faults:
    """The fault of rows, by line and number of fields, that have not as many fields as expected."""
    line, fields = wrong[0]
    more = f" ({len(wrong)} such lines, to line {wrong[-1][0]})" if len(wrong) > 1 else ""
    return Faults([f"{path}: line {line}: {fields} field{'s' * (fields != 1)}, expected {expected}{more}"])


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
    wrong: list[tuple[int, int]] = []
    said: list[str] = []
    again, end = 0, _end_of_numbers(rows, form)
    closing = [text for row in rows[end:] if (text := " ".join(" ".join(row).split()))]
    if words := [text for text in closing if text[0] not in COMMENT_SIGNS]:
        said.append(f"words after the last row left out: {words[0][:SHOWN]!r}{' and more' if len(words) > 1 else ''}")
    for k, row in enumerate(rows[:end]):
        if not any(field.strip() for field in row) or row[0].lstrip()[:1] in COMMENT_SIGNS:
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
        else:
            wrong.append((line_of[k], len(row)))
    if wrong:
        raise _wrong_widths(path, wrong, form.fields)
    if again:
        said.append(f"names again among the rows ({again} lines)")
    return kept, places, said


MOST_COLUMNS = 2000  # a logger's hundreds of channels and to spare; more is a picture or another separator


def text_table(text: str, path: Path, decimal: str = "") -> Table:
    """The table in a text. decimal: '.' or ',' where somebody typed it. Raises Faults."""
    lines = text.rstrip("\x1a\0").splitlines()
    lines, igor_names = _igor(lines) if lines and lines[0].strip() == "IGOR" else (lines, None)
    if not any(line.strip() and not line.startswith("#") for line in lines):
        raise fault(path, "line 1", "expected a header line with column names, the file is empty")
    lines = _joined_head(lines)
    sample = sample_of(lines, path)
    form = form_of(sample)
    if form is None:
        return _no_rows(lines, path)
    if form.fields > MOST_COLUMNS:
        raise fault(path, "", f"{form.fields} columns; expected at most {MOST_COLUMNS}")
    start = first_row(lines, form)
    head = head_of(lines, start, form, igor_names, path)
    names, units = names_and_units(head, lines[:start], form)
    columns, line_of, said = columns_of(lines, start, form, head, text, path)
    signs = Signs(decimal, False, True) if decimal else _signs(columns, form)
    if signs.decimal == "," and not signs.asked:
        said.append("decimal comma")
    kept = [k for k in range(form.fields) if names[k] or _holds(columns[k])]
    place = f"line {head.line + 1 if head.rows else start + 1}"
    table = [Column(names[k], columns[k], units[k]) for k in kept]
    return Table(str(path), place, table, line_of, named=any(names), signs=signs, said=said)


def _igor(lines: list[str]) -> tuple[list[str], list[str] | None]:
    """Igor Text: names after WAVES, rows between BEGIN and END; other lines are left empty, so that lines count on."""
    kept, names, inside, done = [], None, False, False
    for line in lines:
        word = line.strip()
        if word.upper().startswith("WAVES") and names is None:
            names = re.split(r"[\s,]+", word)[1:]
        inside = inside and word != "END"
        kept.append(line.strip() if inside and not done else "")
        done = done or (word == "END" and names is not None)
        inside = inside or word == "BEGIN"
    return kept, names


def _joined_head(lines: list[str]) -> list[str]:
    """Names with a line's end within quotes, as spreadsheets write wrapped headings, in one line."""
    for k, line in enumerate(lines[: HEADER_LINES + 40]):
        if line.count('"') % 2 and k + 1 < len(lines) and len(line) < 2000:
            for end in range(k + 1, min(k + 4, len(lines))):
                if lines[end].count('"') % 2:
                    joined = " ".join(lines[k : end + 1])
                    return lines[:k] + [""] * (end - k) + [joined] + lines[end + 1 :]
    return lines


def _signs(columns: Sequence[Fields], form: Form) -> Signs:
    """How the file writes decimals; columns that are numbers already had points."""
    return signs_of([column for column in columns if isinstance(column, list)], form.separator)


def _holds(column: Fields) -> bool:
    return any(field.strip() for field in column) if isinstance(column, list) else True


def _no_rows(lines: list[str], path: Path) -> Table:
    """Names without a row of numbers."""
    number, line = next((k, line) for k, line in enumerate(lines) if line.strip() and not line.startswith("#"))
    separator = max("\t;,", key=line.count)
    names = divided_line(line, separator)
    rows = [divided_line(each, separator) for each in lines[number + 1 :] if each.strip() and not each.startswith("#")]
    wrong = [(number + 2 + k, len(row)) for k, row in enumerate(rows) if len(row) != len(names)]
    if wrong:
        raise _wrong_widths(path, wrong, len(names))
    if not rows and any(meaning_of(name).ours is not None for name in names):
        raise fault(path, f"line {number + 1}", "names, and no row of numbers below them; expected rows")
    columns = [Column(name, [row[k] for row in rows]) for k, name in enumerate(names)]
    return Table(str(path), f"line {number + 1}", columns, range(number + 2, number + 2 + len(rows)))
