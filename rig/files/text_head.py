"""The names of a table in text, and their units: in a line right above the first row, in one below it, or far above.

Instruments write pages of settings above a table; what has as many fields as the rows and none that is a number may be
its names. Of several such lines the one that says most of what is known here is taken.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.core.faults import fault
from rig.files.column_meaning import meaning_of
from rig.files.field_numbers import number_like
from rig.files.text_form import Form, divided_line, is_value
from rig.files.units import spelled

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
    """Names and units by column; both '' where there are none. Units may stand far above (LabVIEW's Y_Unit_Label)."""
    empty = [""] * form.fields
    if not head.rows:
        return empty, empty
    names = ["", *head.rows[0]] if head.index_column else head.rows[0]
    units = next((row for row in head.rows[1:] if _is_units(row) and len(row) == form.fields), empty)
    if above and above[0].startswith("LabVIEW Measurement"):
        labels = [divided_line(line, form.separator) for line in above if line.startswith("Y_Unit_Label")]
        units = (labels[-1] + empty)[: form.fields] if labels else units
        in_seconds = any(line.startswith("X_Dimension") and "Time" in line for line in above)
        names = ["Time (s)" if name == "X_Value" and in_seconds else name for name in names]
        units = ["" if name == "Time (s)" else unit for name, unit in zip(names, units, strict=True)]
    units = [unit if spelled(unit) is not None else "" for unit in units]
    return list(names), units
