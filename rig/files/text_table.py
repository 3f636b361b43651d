"""A table in text: names, units and columns of fields, with the line of each row for messages."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from rig.core.faults import Faults, fault
from rig.files.column_meaning import meaning_of
from rig.files.field_numbers import Signs, signs_of
from rig.files.table import Column, Table
from rig.files.text_form import Form, divided_line, first_row, form_of, sample_of
from rig.files.text_head import HEADER_LINES, head_of, names_and_units
from rig.files.text_rows import MOST_FAULTS, Fields, columns_of, wrong_width

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
        faults = [wrong_width(path, line, fields, len(names)) for line, fields in wrong[:MOST_FAULTS]]
        more = len(wrong) - len(faults)
        raise Faults([*faults, *([f"{path}: and {more} more lines like these"] if more else [])])
    if not rows and any(meaning_of(name).ours is not None for name in names):
        raise fault(path, f"line {number + 1}", "names, and no row of numbers below them; expected rows")
    columns = [Column(name, [row[k] for row in rows]) for k, name in enumerate(names)]
    return Table(str(path), f"line {number + 1}", columns, range(number + 2, number + 2 + len(rows)))
