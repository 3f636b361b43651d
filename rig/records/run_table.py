"""The record of a run of ours, read a part of the file at a time.

The columns are those that `rig.records.text_table` reads, without a text for every field: a week at 10 Hz is 1.2 GB of
text, and would be ten times that as fields. A file that a run would not write is left to that reader, which says what
is wrong with it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rig.records.plausibility import ABSOLUTE_ZERO_DEGC, HOT_DEGC, MOST_A, MOST_OHM
from rig.records.table import Column, Table

PART = 1 << 20  # bytes that are read at once; ten times as many are slower, by Python's garbage collector
SIGNATURE = {"time_s", "tick", "phase"}  # columns of every run, and together of no other file
WORDS = "phase"  # the only column of words, and the last
BOUNDS = {
    "temperature_degC": (ABSOLUTE_ZERO_DEGC, HOT_DEGC),
    "current_A": (-MOST_A, MOST_A),
    "resistance_ohm": (0.0, MOST_OHM),
}


def read_run_columns(path: Path) -> dict[str, Any] | None:
    """Return numbers and words by column; None if the file is not clearly a run's. Raises OSError."""
    return _read(path)[0]


def read_run_table(path: Path) -> Table | None:
    """Return the file's table; None if it is not clearly a run's, or a pipe. Raises OSError."""
    if not path.is_file():  # a pipe would lose its first lines
        return None
    columns, cut_off = _read(path)
    if columns is None:
        return None
    words, index = np.unique(columns.pop(WORDS), return_inverse=True)
    phases = list(map(words.tolist().__getitem__, index.tolist()))  # one text a phase, not one a row
    table = [*(Column(name, values) for name, values in columns.items()), Column(WORDS, phases)]
    notes = [f"line {2 + len(phases)} left out, it was cut off"] if cut_off else []
    return Table(str(path), "line 1", table, range(2, 2 + len(phases)), notes=notes)


def _read(path: Path) -> tuple[dict[str, Any] | None, bool]:
    """Return the columns, and True if the last line was cut off and left out."""
    with path.open("rb") as file:
        names = file.readline().decode("utf-8", "replace").rstrip("\n").split(",")
        if not set(names) >= SIGNATURE or len(set(names)) != len(names) or names[-1] != WORDS:
            return None, False
        parts, rest = [], b""
        while data := file.read(PART):
            whole, found, rest = (rest + data).rpartition(b"\n")
            if found:
                parts.append(_parse(whole, names))
                if parts[-1] is None:
                    return None, False
    whole_row = rest.count(b",") == len(names) - 1  # a last row without a line's end; with fewer fields it was cut off
    if whole_row:
        parts.append(_parse(rest, names))
    if not parts or parts[-1] is None:
        return None, False
    columns = {name: np.concatenate([part.pop(name) for part in parts if part is not None]) for name in names}
    return (columns if _is_plausible(columns) else None), bool(rest) and not whole_row


def _parse(text: bytes, names: list[str]) -> dict[str, Any] | None:
    """Return the columns of whole lines; None if a row has other fields, or one that is no plain number."""
    numbers = names[:-1]
    try:
        lines = text.decode("ascii").split("\n")
        if text.count(b",") != len(lines) * len(numbers) or b'"' in text:
            return None
        filled = text.replace(b",,", b",nan,").replace(b",,", b",nan,").decode("ascii").split("\n")
        values = np.loadtxt(filled, delimiter=",", comments=None, usecols=range(len(numbers)), ndmin=2)
    except ValueError:  # a UnicodeDecodeError too
        return None
    if len(values) != len(lines):  # one was empty
        return None
    columns: dict[str, Any] = {name: values[:, k].copy() for k, name in enumerate(numbers)}
    return {**columns, WORDS: np.array([line[line.rindex(",") + 1 :] for line in lines])}


def _is_plausible(columns: dict[str, Any]) -> bool:
    """Return True if the reader of text would refuse nothing, and read nothing in another way."""
    time = columns["time_s"]
    if time.size < 2 or not np.all(np.isfinite(time)) or not np.all(np.diff(time) > 0.0):
        return False
    for name, (low, high) in BOUNDS.items():
        values = columns.get(name, np.empty(0))
        within = np.isnan(values) | ((values > low) & (values < high))
        if not np.all(within | np.isinf(values) if name == "resistance_ohm" else within):
            return False
    return True
