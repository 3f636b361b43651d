"""When the ohmmeter's test current came on is recorded: at the change of range, not when the row before was read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from rig.records.record_file import read_record
from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]


def test_a_row_has_the_current_that_its_reading_was_taken_with(peltier: Peltier, tmp_path: Path) -> None:
    """Though the next one, in another range maybe, has been begun by then."""
    status, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert status == 0, err
    record = read_record(tmp_path / "run" / "record.csv")
    row_s, read_s, on_s = (record[name] for name in ("time_s", "resistance_time_s", "meter_current_time_s"))
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0) + 1
    assert rows.size
    assert np.all(on_s[rows] < read_s[rows])
    assert np.all(on_s[rows] > row_s[rows - 1] - 0.1)  # since then, and not since the change before
