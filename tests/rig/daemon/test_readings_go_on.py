"""Somebody always reads: after a job, with gaps and jumps of the clock counted and told."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from rig.config.configuration import read_configuration
from rig.daemon.command_queue import Gaps
from rig.daemon.status_text import status_rows
from tests.rig.daemon.benches import SERVE, running, until, write_current


def test_after_a_job_the_idle_loop_goes_on_reading(tmp_path: Path) -> None:
    with running(write_current(tmp_path, '["start 0 A", "hold 0.2 s"]', more=SERVE)) as bench:
        job = bench.commands.submit(read_configuration(bench.file.path))
        until(lambda: job.ended_s, "the job's end")
        ended_s = job.ended_s or 0.0
        until(lambda: [row for row in list(bench.commands.recent) if row["time_s"] > ended_s][5:], "rows after it")
        phases = [row["phase"] for row in list(bench.commands.recent)]
        assert phases.index("profile") < len(phases) - 1 - phases[::-1].index("idle")
        assert bench.state()["output_confirmed"] is True


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
        bench.commands.gaps.cycle(bench.commands.steady_s() + 35.0, 3.0)
        assert bench.state()["gaps"]["count"] == gaps + 1
        told = dict(status_rows(bench.state()))
        assert "the longest 3" in told["gaps"]
