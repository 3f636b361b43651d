"""The rows that a run folder keeps in memory: few bytes, and what comes out is what went in, to the letter."""

from __future__ import annotations

import math
import random
import shutil
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import netcdf_file

from rig.core.reading import OF_A_RUN
from rig.records.run_folder import PackedRows, RunFolder

SPECIAL = (0.1, -0.0, 1e-300, 1e22, 3.0, math.nan, math.inf, np.float64(1) / 3, 0)
BYTES_A_ROW = 130  # 8 for each of 15 values, and what is allocated ahead
BLOCK = 4096


def rows(count: int) -> list[tuple[Any, ...]]:
    """Of a run: numbers, a whole one, a word."""
    draw = random.Random(1)
    width = len(OF_A_RUN) - 2
    first = [draw.random() for _ in range(width)]
    more = [[draw.choice((*SPECIAL, draw.random())) for _ in range(width)] for _ in range(count - 1)]
    return [(*row, k, "settle" if k < 5 else "track") for k, row in enumerate([first, *more])]


def test_what_comes_out_is_what_went_in() -> None:
    packed, given = PackedRows(len(OF_A_RUN)), rows(2 * BLOCK + 3)
    assert list(packed) == []
    assert packed.column(0).size == 0
    for row in given:
        packed.append(row)
    assert len(packed) == len(given)
    assert repr(list(packed)) == repr([(*map(float, row[:-2]), *row[-2:]) for row in given])
    for k in (0, BLOCK - 1, BLOCK, -1):
        assert repr(packed[k]) == repr((*map(float, given[k][:-2]), *given[k][-2:]))
    for k in range(len(OF_A_RUN)):
        expected = np.array([row[k] for row in given])
        assert packed.column(k).dtype == expected.dtype
        np.testing.assert_array_equal(packed.column(k), expected)
    with pytest.raises(IndexError):
        packed[len(given)]
    with pytest.raises(ValueError, match="14 values"):
        packed.append(given[0][1:])


def test_a_folder_that_was_deleted_is_written_again_to_the_letter(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run", {}, "", [*OF_A_RUN])
    for row in rows(BLOCK + 10):
        folder.row(row)
    folder.flush()
    written = (folder.part / "record.csv").read_bytes()
    shutil.rmtree(folder.part)
    folder.flush()
    assert (folder.part / "record.csv").read_bytes() == written
    whole = folder.finish()
    with netcdf_file(whole / "record.nc", mmap=False) as file:
        assert file.variables["phase"].flag_meanings == b"settle track"
        assert list(file.variables["phase"][:7]) == [0, 0, 0, 0, 0, 1, 1]
        np.testing.assert_array_equal(file.variables["tick"][:], np.arange(BLOCK + 10))


def test_a_week_fits_into_memory(tmp_path: Path) -> None:
    """The page offers to hold for a week: six million rows, that took 3 GB as tuples."""
    folder, given = RunFolder(tmp_path / "run", {}, "", [*OF_A_RUN]), rows(4 * BLOCK)
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for row in given:
        folder.row((*(value + 0.5 for value in row[:-2]), *row[-2:]))
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (after - before) / len(given) < BYTES_A_ROW
    folder.abandon()
