"""What is latched: on disk before it is told, over restarts, whatever became of the history."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.config.configuration import ConfigurationFile, read_configuration
from rig.daemon import latch
from rig.daemon.command_queue import HISTORY, CommandQueue
from rig.daemon.http_server import Refusal, Requests
from rig.daemon.latch import CLEAR, LATCH, TRIPPED, Entry, Latch, LatchStore, NotCleared, read, write
from rig.daemon.output_lock import Off
from rig.daemon.serving import bench_of
from rig.guard.stale_run import DIED
from rig.history import reading
from tests.rig.daemon.benches import SERVE, until, write_current

CHANGED = {"trips deleted": "DELETE FROM trip", "documents": "UPDATE trip SET document = 'no JSON'"}
ROW = {"temperature_degC": 25.0, "phase": "idle", "quality": "good"}


@pytest.fixture
def file(tmp_path: Path) -> ConfigurationFile:
    return bench_of(read_configuration(write_current(tmp_path, more=SERVE)))[0]


@contextlib.contextmanager
def life(file: ConfigurationFile) -> Iterator[CommandQueue]:
    """A daemon's commands, without instruments."""
    commands = CommandQueue(file, [])
    commands.writer.start()
    try:
        yield commands
    finally:
        commands.writer.stop()
        commands.latch_store.close()


def rows(commands: CommandQueue, count: int = 3) -> None:
    for _ in range(count):
        commands.row({"time_s": commands.label_s(), **ROW})
    assert commands.writer.settle()


def word(commands: CommandQueue) -> str:
    commands.online = True
    return str(commands.state()["state"])


def tripped_life(file: ConfigurationFile) -> Path:
    """The folder of a bench that has tripped, and ended."""
    with life(file) as commands:
        rows(commands)
        commands.trip("temperature_limit", "61.6 degC, limit 61.5 degC")
        rows(commands, 25)
        return commands.folder


def damaged(folder: Path, how: str) -> None:
    path = folder / HISTORY
    if how == "deleted":
        path.unlink()
    elif how == "truncated":
        os.truncate(path, path.stat().st_size // 2)
    elif how == "random bytes":
        path.write_bytes(path.read_bytes()[:500] + os.urandom(path.stat().st_size - 500))
    elif how in CHANGED:
        with contextlib.closing(sqlite3.connect(path)) as connection, connection:
            connection.execute(CHANGED[how])


@pytest.mark.parametrize("how", ["whole", "deleted", "truncated", "random bytes", "trips deleted", "documents"])
def test_a_trip_survives_whatever_becomes_of_the_history(file: ConfigurationFile, how: str) -> None:
    damaged(tripped_life(file), how)
    with life(file) as commands:
        assert word(commands) == "tripped"
        assert commands.state()["trip"]["cause"] == "temperature_limit"
        rows(commands)
        kept = reading.trips(commands.folder / HISTORY)
        assert [trip["cause"] for trip in kept] == ["temperature_limit"]
        assert len(kept[0]["rows"]) == (23 if how == "whole" else 0)  # the rows are the history's alone
        assert commands.reset("looked at it")
        commands.writer.settle()
        assert reading.trips(commands.folder / HISTORY)[0]["cleared_because"] == "looked at it"
    with life(file) as commands:
        assert word(commands) == "idle"


def test_a_stop_survives_a_restart_too(file: ConfigurationFile) -> None:
    with life(file) as commands:
        assert word(commands) == "idle"
        commands.stop("a test")
    with life(file) as commands:
        assert word(commands) == "stopped"
        assert commands.state()["stop"]["text"] == "stopped by a test"
        commands.trip("temperature_limit", "a trip takes the place of a stop")
        commands.stop("a test, again")
        assert word(commands) == "tripped"
    with life(file) as commands:
        assert word(commands) == "tripped"


@pytest.mark.parametrize("how", ["truncated", "a sector", "deleted", "deleted, and no history can be read"])
def test_an_unreadable_latch_is_a_trip(file: ConfigurationFile, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with life(file) as commands:
        rows(commands)
        path = commands.folder / LATCH
    if how.startswith("deleted"):
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-512] + (b"" if how == "truncated" else b"x" * 512))
    if how.endswith("read"):
        monkeypatch.setattr("rig.daemon.command_queue.Store", no_room)
    with life(file) as commands:
        assert word(commands) == "tripped"
        assert commands.state()["trip"]["cause"] == "latch"
        assert "is not known: look at the bench" in commands.state()["trip"]["text"]
        assert (read(path) or Entry("", "", "", 0.0)).state == TRIPPED
        assert commands.reset("looked at it")
    with life(file) as commands:
        assert word(commands) == "idle"


def test_a_trip_and_a_reset_are_on_disk_before_told(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[tuple[str, str, str]] = []

    def slowly(path: Path, kept: Entry) -> None:
        found.append((kept.state, word(commands), "held" if commands.no_job_because() else "free"))
        write(path, kept)

    with life(file) as commands:
        commands.output_now("off")
        assert not commands.no_job_because()
        monkeypatch.setattr(latch, "write", slowly)
        tell = commands.announcer.announce
        told: list[tuple[str, str]] = []

        def telling(event: str, data: Any) -> None:
            kept = read(commands.folder / LATCH)
            told.append((event, kept.state if kept is not None else ""))
            tell(event, data)

        monkeypatch.setattr(commands.announcer, "announce", telling)
        commands.trip("temperature_limit", "too hot")
        commands.reset("looked at it")
        commands.output_now("off")
        assert not commands.no_job_because()
    assert found == [("tripped", "idle", "held"), ("clear", "tripped", "held")]
    assert told[0] == ("trip", "tripped")


def test_a_contradicted_off_is_not_believed_by_stop(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    with life(file) as commands:
        monkeypatch.setattr(commands.output_lock, "stop", lambda why: Off(True, 0.0))
        commands.contradicted = True
        assert commands.stop("a test").confirmed  # by the controller
        assert (commands.state()["output"], commands.state()["output_confirmed"]) == ("unknown", False)
        commands.reset("looked at it")
        assert commands.stop("a test").confirmed
        assert (commands.state()["output"], commands.state()["output_confirmed"]) == ("off", True)


def no_room(*_: object) -> None:
    raise sqlite3.OperationalError("database or disk is full")


def broken(path: Path, kept: Entry) -> None:
    raise OSError(5, "Input/output error")


def test_an_unwritable_latch_holds_and_is_not_reset(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latch, "TRY_AGAIN_S", 0.02)
    with life(file) as commands:
        commands.output_now("off")
        monkeypatch.setattr(latch, "write", broken)
        commands.trip("temperature_limit", "too hot")
        assert word(commands) == "tripped"
        assert any("the latch cannot be written" in line and "Input/output" in line for line in commands.warnings())
        with pytest.raises(Refusal) as refusal:
            Requests(commands).answer("POST", "/api/reset", {"reason": "looked at it"})[1]
        assert refusal.value.status == 503
        assert "Input/output error" in refusal.value.lines[0]
        assert word(commands) == "tripped"
        monkeypatch.setattr(latch, "write", write)
        until(lambda: commands.latch_store.on_disk, "the latch on disk")
        assert (read(commands.folder / LATCH) or Entry("", "", "", 0.0)).text == "too hot"
        assert not any("the latch" in line for line in commands.warnings())


def test_a_hanging_disk_holds_up_no_stop_or_trip(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on = threading.Event()

    def hanging(path: Path, kept: Entry) -> None:
        goes_on.wait(60.0)
        write(path, kept)

    monkeypatch.setattr(latch, "PATIENCE_S", 0.05)
    with life(file) as commands:
        until(lambda: commands.latch_store.on_disk)
        monkeypatch.setattr(latch, "write", hanging)
        commands.stop("a test")
        assert word(commands) == "stopped"
        assert any("has not answered yet" in line for line in commands.no_job_because())
        with pytest.raises(NotCleared, match="has not answered yet"):
            commands.reset("looked at it")
        goes_on.set()
        until(lambda: commands.latch_store.on_disk)
        assert word(commands) == "stopped"
        assert (read(commands.folder / LATCH) or Entry("", "", "", 0.0)).state == "stopped"


def test_a_trip_during_a_reset_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / LATCH
    first = Latch(TRIPPED, "one", "the first", 1.0)
    kept = LatchStore(path, first, 1.0)

    def tripping(path: Path, said: Entry) -> None:
        monkeypatch.setattr(latch, "write", write)
        assert said.state == CLEAR
        assert kept.hold(Latch(TRIPPED, "two", "the second", 2.0))
        write(path, said)

    monkeypatch.setattr(latch, "write", tripping)
    with pytest.raises(NotCleared, match="the second"):
        kept.clear("looked at the first", 3.0)
    kept.save()
    assert kept.reported is not None
    assert (kept.reported.cause, (read(path) or first.entry()).cause) == ("two", "two")
    kept.close()


class Disk:
    """A folder of runs that fails (EIO), or hangs until it is released. asked: how often a report was looked for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, hangs: bool) -> None:
        self.asked, self.answers = 0, threading.Event()
        whole = Path.is_file

        def is_file(path: Path) -> bool:
            if path.name != "report.html":
                return whole(path)
            self.asked += 1
            if not hangs:
                raise OSError(errno.EIO, "Input/output error", str(path))
            return self.answers.wait(20.0)

        monkeypatch.setattr(Path, "is_file", is_file)


class Output:
    """A controller that knows whether it was told "off"."""

    def __init__(self) -> None:
        self.is_off = threading.Event()

    def off(self) -> bool:
        self.is_off.set()
        return True


def ended_job(number: str, folder: Path, **more: Any) -> dict[str, Any]:
    table = {"id": number, "name": "one", "kind": "track", "state": "failed", "queued_s": 1.0, "started_s": 2.0}
    return {**table, "ended_s": 3.0, "reason": "x", "folder": str(folder), "report": None, "exit_status": 1, **more}


@pytest.mark.parametrize("how", ["fails", "hangs"])
def test_stop_switches_off_on_a_dead_disk(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    """Runs on a network's disk that is gone: whoever presses STOP must not wait for it with the heater on."""
    with life(file) as commands:
        output = Output()
        commands.output_lock.attach(output)  # type: ignore[arg-type]
        commands.queue.remember([ended_job("old", file.path.parent)])
        disk = Disk(monkeypatch, how == "hangs")
        waiting = commands.submit(file).id if how == "fails" else None
        stops = threading.Thread(target=commands.stop, args=("a test",), daemon=True)
        stops.start()
        assert output.is_off.wait(5.0)
        disk.answers.set()
        stops.join(20.0)
        assert not stops.is_alive()
        assert (commands.output, len(commands.queue)) == ("off", 0)
        if waiting is not None:
            assert [job["state"] for job in commands.queue.tables() if job["id"] == waiting] == ["stopped"]


def test_the_state_asks_no_disk(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told from the loop's thread at each phase: a disk that hangs would leave the heater on unwatched."""
    with life(file) as commands:
        commands.queue.remember([ended_job("old", file.path.parent)])
        disk = Disk(monkeypatch, hangs=False)
        assert commands.state()["last_job"]["id"] == "old"
        commands.changed()
        commands.queue.tables()
        assert disk.asked == 0


def test_a_report_that_was_written_after_the_daemon_ended_is_found(file: ConfigurationFile) -> None:
    """Its guard wrote it: the page and `peltier status` have to show where the report of that run is."""
    folder = file.path.parent / "left.part"
    folder.mkdir()
    with life(file) as commands:
        commands.writer.do(lambda store: store.save_job(ended_job("old", folder)))
        assert commands.writer.settle()
    (folder / "report.html").write_text("a report")
    with life(file) as commands:
        until(lambda: commands.state()["last_job"]["report"] == "/runs/old/report.html", "the report")
        assert commands.writer.settle()
    (folder / "report.html").unlink()
    with life(file) as commands:  # what was found is kept
        assert (commands.queue.last_ended() or {})["report"] == "/runs/old/report.html"


def test_no_job_starts_before_a_left_output_latches(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """The history could not be read at the start: what it says is latched with the next rows, and a job that waits
    would begin before them."""
    folder = file.path.parent / "left.part"
    folder.mkdir()
    stop = {"reason": DIED, "text": "the temperature goes on", "output_off_confirmed": False}
    (folder / "run.json").write_text(json.dumps({"stop": stop}))
    with life(file) as commands:
        commands.writer.do(lambda store: store.save_job(ended_job("old", folder, state="running", ended_s=None)))
        assert commands.writer.settle()
    with monkeypatch.context() as patched:
        patched.setattr("rig.daemon.command_queue.Store", no_room)
        commands = CommandQueue(file, [])
    commands.output_now("off")
    commands.writer.start()
    until(lambda: commands.had_history, "the history")
    assert any("the temperature goes on" in line for line in commands.no_job_because())
    rows(commands)
    assert commands.latch is not None
    assert any("the temperature goes on" in line for line in commands.no_job_because())
    commands.close()
