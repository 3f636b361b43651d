"""Rows of the history; gaps and jumps of the clock."""

from __future__ import annotations

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rig.control.decision import Tick, Ticks
from rig.core.reading import Reading
from rig.daemon.command_queue import Gaps
from rig.daemon.job_run import JobRun
from rig.daemon.status_text import status_rows
from tests.rig.daemon.benches import SERVE, running, until, write_current


def test_the_test_current_is_that_of_the_rows_own_reading() -> None:
    """Though the next reading, in another range maybe, has been begun when the row is written."""
    rows: list[dict[str, Any]] = []
    commands = SimpleNamespace(label_s=lambda: 7.0, ticks=Ticks(), row=rows.append)
    valid, clock = SimpleNamespace(check_void=lambda: None), SimpleNamespace(latest_s=0.0)
    job = SimpleNamespace(_commands=commands, _pass=valid, _clock=clock, _job=SimpleNamespace(id="1"), _last=None)
    wanted = dict.fromkeys(("setpoint_degC", "reference_degC", "target_ohm", "predicted_ohm"), 1.0)
    decision = SimpleNamespace(done=False, **wanted)
    readings = {"temperature": Reading(60.0, 0.0), "resistance": Reading(1e4, 0.0), "test_current_A": 1e-4}
    tick = SimpleNamespace(decision=decision, current_A=1.5, watch=None, phase="profile", **readings)
    JobRun.tick(cast(JobRun, job), cast(Tick, tick))
    assert (rows[0]["resistance_ohm"], rows[0]["meter_current_A"], rows[0]["job"]) == (1e4, 1e-4, "1")


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
