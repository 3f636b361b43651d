"""The columns of a record that a run of ours has written, a part of the file at a time.

What the reader of texts makes of the same file (`rig.records.text_table`), without a text for every field: a week at 10
Hz is 1.2 GB of text, and would be ten times that as fields. A file that is anything else than what a run writes is left
to that reader, which says what is wrong with it.

    run_columns     the columns, numbers and texts
    run_table       the same as a table, from which `rig.records.record_file` makes a record as from any other
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rig.records.plausibility import ABSOLUTE_ZERO_DEGC, HOT_DEGC, MOST_A, MOST_OHM
from rig.records.table import Column, Table

PART = 1 << 20  # bytes of text that are numbers at once; ten times that is slower, by Python's collector
TELLING = ("time_s", "tick", "phase")  # columns that every run has, and together nobody else
WORDS = "phase"  # the one column of texts, and the last
BOUNDS = {  # beyond which a number is none of the quantity
    "temperature_degC": (ABSOLUTE_ZERO_DEGC, HOT_DEGC),
    "current_A": (-MOST_A, MOST_A),
    "resistance_ohm": (0.0, MOST_OHM),
}


def run_columns(path: Path) -> dict[str, Any] | None:
    """The columns by name, numbers and texts; None where the file is not plainly a run's. Raises OSError."""
    return _read(path)[0]


def _read(path: Path) -> tuple[dict[str, Any] | None, bool]:
    """The same, and whether the last line was cut off and left out."""
    with path.open("rb") as file:
        names = file.readline().decode("utf-8", "replace").rstrip("\n").split(",")
        if not set(TELLING) <= set(names) or len(set(names)) != len(names) or names[-1] != WORDS:
            return None, False
        parts, rest = [], b""
        while data := file.read(PART):
            whole, found, rest = (rest + data).rpartition(b"\n")
            if found and (part := _columns(whole, names)) is None:
                return None, False
            if found:
                parts.append(part)
    whole_row = rest.count(b",") == len(names) - 1  # without a line's end; with fewer fields it was cut off
    if whole_row:
        parts.append(_columns(rest, names))
    if not parts or parts[-1] is None:
        return None, False
    columns = {name: np.concatenate([part.pop(name) for part in parts if part is not None]) for name in names}
    return (columns if _credible(columns) else None), bool(rest) and not whole_row


def run_table(path: Path) -> Table | None:
    """The table of a file; None where it is not plainly a run's, or none that can be read twice. Raises OSError."""
    if not path.is_file():  # a pipe would have lost its first lines
        return None
    columns, cut_off = _read(path)
    if columns is None:
        return None
    words, index = np.unique(columns.pop(WORDS), return_inverse=True)
    shared = list(map(words.tolist().__getitem__, index.tolist()))  # a name's text once, not once a row
    table = [*(Column(name, values) for name, values in columns.items()), Column(WORDS, shared)]
    said = [f"line {2 + len(shared)} left out, it was cut off"] if cut_off else []
    return Table(str(path), "line 1", table, range(2, 2 + len(shared)), said=said)


def _columns(text: bytes, names: list[str]) -> dict[str, Any] | None:
    """Of whole lines; None where a row has another number of fields, or a field is no plain number."""
    numbers = names[:-1]
    try:
        lines = text.decode("ascii").split("\n")
        if text.count(b",") != len(lines) * len(numbers) or b'"' in text:
            return None
        filled = text.replace(b",,", b",nan,").replace(b",,", b",nan,").decode("ascii").split("\n")
        values = np.loadtxt(filled, delimiter=",", comments=None, usecols=range(len(numbers)), ndmin=2)
    except ValueError:  # UnicodeDecodeError is one
        return None
    if len(values) != len(lines):  # one was empty
        return None
    columns: dict[str, Any] = {name: values[:, k].copy() for k, name in enumerate(numbers)}
    return {**columns, WORDS: np.array([line[line.rindex(",") + 1 :] for line in lines])}


def _credible(columns: dict[str, Any]) -> bool:
    """Whether nothing in it would be refused, or be read as something else than it says."""
    time = columns["time_s"]
    if time.size < 2 or not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0.0):
        return False
    for name, (low, high) in BOUNDS.items():
        if name in columns:
            values = columns[name][~np.isnan(columns[name])]
            beyond = np.isinf(values) if name == "resistance_ohm" else np.zeros(values.size, dtype=np.bool_)
            if not np.all((values > low) & (values < high) | beyond):
                return False
    return True
