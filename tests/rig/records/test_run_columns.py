"""A run's own record, read line by line, is what the reader of records makes of it; all else is left to that."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from rig.records.conversion import record_from_table
from rig.records.record import Record
from rig.records.record_file import read_record, read_run_table
from rig.records.text_table import text_table

HEAD = "time_s,temperature_degC,resistance_ohm,current_A,setpoint_degC,reference_degC,tick,phase\n"


def rows(count: int) -> str:
    """Of a run: fields are empty, one beside the other, and a resistance is beyond the range now and then."""
    return "".join(
        f"{0.1 * k + 0.01!r},{20.0 + k % 7 / 3!r},{'inf' if k % 50 == 9 else 1e3 + k},-0.5,,"
        f"{'' if k % 3 else 41.5},{k},{'approach' if k < 20 else 'track'}\n"
        for k in range(count)
    )


def read_as_text(path: Path) -> Record:
    """By the reader of texts, which knows no run."""
    return record_from_table(text_table(path.read_text(), path), options=False)


@pytest.mark.parametrize("cut", [0, 1, 20, 47])
@pytest.mark.parametrize("name", ["resistance_ohm", "R [kOhm]"])
def test_it_is_what_the_reader_of_records_makes_of_it(tmp_path: Path, cut: int, name: str) -> None:
    """With our names, and one that has to be guessed; cut off at its end, too, as by a kill."""
    path = tmp_path / "record.csv"
    text = HEAD.replace("resistance_ohm", name) + rows(100)
    path.write_text(text[: len(text) - cut])
    table, lean, record = read_run_table(path), read_record(path, options=False), read_as_text(path)
    assert table is not None
    found = {one.name: one.fields for one in table.columns}
    assert len(found) == len(record.columns) + len(record.text_columns)
    assert found["phase"] == lean.text_columns["phase"] == record.text_columns["phase"]
    assert (lean.source, lean.drive, lean.notes) == (record.source, record.drive, record.notes)
    assert list(lean.columns) == list(record.columns)
    for column, values in record.columns.items():
        np.testing.assert_array_equal(lean[column], values)
        if column in found:  # all but a name that was guessed
            np.testing.assert_array_equal(found[column], values)


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    os.mkfifo(pipe := tmp_path / "pipe")
    assert read_run_table(pipe) is None


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ("\n0.51", "\n0.11"),  # time goes back
        (",-0.5,", ",-0.5A,"),
        (",-0.5,", ",-0.5,,"),
        ("\n0.51", "\n# a comment\n0.51"),
        ("\n0.51", "\n\n0.51"),
        ("tick", "tock"),
        ("phase", "phase,more"),
        ("approach", '"approach"'),
        ("approach", "n\N{LATIN SMALL LETTER A WITH DIAERESIS}her"),
    ],
)
def test_anything_else_is_left_to_the_reader_of_records(tmp_path: Path, was: str, becomes: str) -> None:
    path = tmp_path / "record.csv"
    text = HEAD + rows(100)
    assert was in text
    path.write_text(text.replace(was, becomes, 1))
    assert read_run_table(path) is None


def test_memory_is_that_of_the_numbers(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(HEAD + rows(40_000))
    tracemalloc.start()
    table = read_run_table(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert table is not None
    numbers = 8 * len(table.columns) * len(table.line_of)
    assert peak < 3 * numbers
