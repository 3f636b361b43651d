"""A daemon that starts on a full disk: the output off, the page there, everything told, no job until there is room."""

from __future__ import annotations

import contextlib
import errno
import sqlite3
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.config.configuration import read_configuration
from rig.daemon import latch
from rig.daemon.latch import LATCH, read
from rig.history.store import Store
from rig.records.run_folder import RunFolder
from tests.rig.daemon.benches import RunningBench, until, write_current

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from benchmarks._small_disk import small_disk

DISK_MB = 64


@contextlib.contextmanager
def closing(bench: RunningBench) -> Iterator[RunningBench]:
    try:
        yield bench
    finally:
        bench.close()


def bench_in(folder: Path, kept: Path) -> Path:
    serve = f'[serve]\nport = 0\nfolder = "{kept}"\nidle_period_s = 0.1\n'
    return write_current(folder, '["start 0 A", "hold 0.2 s"]', more=serve)


def starts_and_waits_for_room(path: Path, make_room: Callable[[], None]) -> None:
    with closing(RunningBench(path, path.parent / "bench.sock")) as bench:
        state = bench.until_state("idle")
        assert (state["output"], state["output_confirmed"]) == ("off", True)
        until(lambda: bench.state()["reading"]["temperature_degC"], "a reading")
        assert bench.state()["reading"]["quality"] == "not recorded"
        for what in ("the history", "the latch"):
            assert any(line.startswith(f"{what} cannot be written") for line in bench.state()["warnings"])
        bench.serve()
        shown = bench.ask("GET", "/api/state")[1]["warnings"]
        assert [line.split(": ")[0] for line in shown] == [line.split(": ")[0] for line in bench.state()["warnings"]]
        assert bench.ask("GET", "/health")[0] == 503
        job = bench.commands.submit(read_configuration(path))
        done = bench.state()["ticks"]["done"]
        until(lambda: bench.state()["ticks"]["done"] > done + 10, "more readings")
        assert job.state == "queued"
        make_room()
        until(lambda: job.state == "done", "the job")
        assert bench.state()["no_job_because"] == []
        assert not any("cannot be written" in line for line in bench.state()["warnings"])
        assert read(bench.commands.folder / LATCH) is not None


def test_a_first_start_without_room_for_latch_and_history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = [True]

    def unless_full(real: Callable[..., Any], error: Exception) -> Callable[..., Any]:
        def called(*given: Any) -> Any:
            if full:
                raise error
            return real(*given)

        return called

    no_room = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(latch, "write", unless_full(latch.write, no_room))
    full_database = sqlite3.OperationalError("database or disk is full")
    monkeypatch.setattr("rig.history.store.opened", unless_full(sys.modules["rig.history.store"].opened, full_database))
    starts_and_waits_for_room(bench_in(tmp_path, tmp_path / "kept"), full.clear)


def test_a_trip_on_a_full_disk_finds_the_room_that_was_taken_before(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", DISK_MB) as disk:
        if disk is None:
            pytest.skip("no small file system can be mounted here: that needs root")
        path = bench_in(tmp_path, disk.folder / "kept")
        with closing(RunningBench(path, tmp_path / "bench.sock")) as bench:
            until(lambda: bench.commands.recent, "rows")
            disk.fill()
            bench.commands.trip("temperature_limit", "too hot")
            assert bench.state()["state"] == "tripped"
            assert bench.commands.latch_store.on_disk
        with closing(RunningBench(path, tmp_path / "bench.sock")) as bench:
            assert bench.state()["trip"]["text"] == "too hot"
            assert bench.commands.latch_store.on_disk
            disk.free()
            assert bench.commands.reset("there is room again")


def test_a_disk_that_becomes_full_in_a_job_and_at_rest_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full: list[bool] = []

    def refusing(real: Callable[..., Any], error: Exception, after: int) -> Callable[..., Any]:
        calls: list[Any] = []

        def called(*given: Any, **more: Any) -> Any:
            calls.append(given)
            if full or len(calls) > after > 0:
                raise error
            return real(*given, **more)

        return called

    no_room = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(RunFolder, "flush", refusing(RunFolder.flush, no_room, after=1))
    monkeypatch.setattr(
        Store, "add", refusing(Store.add, sqlite3.OperationalError("database or disk is full"), after=0)
    )
    path = bench_in(tmp_path, tmp_path / "kept")
    with closing(RunningBench(path, tmp_path / "bench.sock")) as bench:
        bench.until_state("idle")
        job = bench.commands.submit(read_configuration(path))
        until(lambda: job.ended_s, "the job's end")
        assert job.state == "failed", (job.state, job.reason)
        assert job.reason is not None
        assert job.reason.startswith("OSError: [Errno 28] No space left on device; ")
        assert job.reason.endswith(".part is not whole")
        assert (bench.state()["output"], bench.state()["output_confirmed"]) == ("off", True)
        logged: list[str] = []
        monkeypatch.setattr(bench.commands, "_log", logged.append)
        full.append(True)
        until(lambda: any("the history cannot be written: " in line for line in logged), "a line in the log")
        full.clear()
