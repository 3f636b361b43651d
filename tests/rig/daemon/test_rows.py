"""Rows of the history: beside those of the job's own record, and after it; gaps and jumps of the clock."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from rig.config.configuration import read_configuration
from rig.daemon.command_queue import Gaps
from rig.daemon.status_text import status_rows
from rig.history.store import connect_to_read
from rig.records.record_file import read_record
from tests.rig.daemon.benches import SERVE, running, until, write_current

THROUGH_THE_RANGES = '["start 0.5 A", "hold 2 s", "ramp to 3 A in 3 s", "hold 8 s"]'


def test_the_test_current_is_that_of_the_rows_own_reading(tmp_path: Path) -> None:
    """Though the next reading, in another range maybe, has been begun when the row is written."""
    path = write_current(tmp_path, THROUGH_THE_RANGES, more=SERVE)
    with running(path) as bench:
        job = bench.commands.submit(read_configuration(path))
        until(lambda: job.ended_s is not None, "the job's end")
        assert job.state == "done", job.reason
        assert job.folder is not None
        bench.commands.writer.settle()
        with connect_to_read(bench.commands.folder / "history.sqlite") as connection:
            kept = connection.execute("SELECT resistance_ohm, meter_current_A FROM raw").fetchall()
        record = read_record(job.folder / "record.csv")
    in_history = dict(kept)
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0)
    assert rows.size
    for row in (*rows, *(rows + 1)):
        ohm = record["resistance_ohm"][row]
        if np.isfinite(ohm):
            assert in_history[ohm] == record["meter_current_A"][row]


def test_gaps_are_counted() -> None:
    gaps = Gaps(100.0)
    for now_s in (100.1, 101.0, 131.0, 132.0, 142.0):
        gaps.cycle(now_s, 3.0)
    assert gaps.table() == {"count": 2, "longest_s": 30.0, "total_s": 40.0}


def test_a_jump_of_the_clock_and_a_gap_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(write_current(tmp_path, more=SERVE)) as bench:
        logged: list[str] = []
        bench.commands._log = logged.append
        uptime_s, real = bench.state()["uptime_s"], time.time
        monkeypatch.setattr("rig.daemon.command_queue.time.time", lambda: real() + 400 * 86400.0)
        until(lambda: any("jumped" in line for line in bench.state()["warnings"]), "the warning")
        assert "jumped forward by 400.0 days" in logged[0]
        assert bench.state()["uptime_s"] < uptime_s + 3600.0
        monkeypatch.undo()
        until(lambda: any("jumped back by 400.0 days" in line for line in bench.state()["warnings"]), "the way back")
        gaps = bench.state()["gaps"]["count"]
        bench.commands.gaps.cycle(bench.commands.clock.now_s() + 35.0, 3.0)
        assert bench.state()["gaps"]["count"] == gaps + 1
        told = dict(status_rows(bench.state()))
        assert "the longest 3" in told["gaps"]
