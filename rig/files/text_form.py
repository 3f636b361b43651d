"""How a table in text is written: what parts its fields, how many there are, and which of them are numbers.

It is learned from the first thousand lines that say something: the separator with which most fields are numbers, the
number of fields that most such lines have, and the fields that are numbers in most of them.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.core.faults import fault
from rig.files.field_numbers import blank_like, number_like
from rig.files.field_times import time_like

SAMPLE = 1000  # lines
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
        if len(row) >= 2 and any(values) and 2 * sum(values) >= filled:
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
