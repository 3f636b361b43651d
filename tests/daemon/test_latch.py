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
from rig.core.clock import RealClock
from rig.daemon import latching
from rig.daemon.answers import Answers, Refusal
from rig.daemon.bench_state import no_job_because, warnings
from rig.daemon.desk import HISTORY, Desk
from rig.daemon.gate import Off
from rig.daemon.latch import CLEAR, TRIPPED, Kept, Latch
from rig.daemon.latch_file import LATCH, read, write
from rig.daemon.latching import Latching, NotCleared
from rig.daemon.serving import bench_of
from rig.guard.left_behind import DIED
from rig.history import reading
from tests.daemon.benches import SERVE, until, write_current

ROW = {"temperature_degC": 25.0, "phase": "idle", "quality": "good"}


@pytest.fixture
def file(tmp_path: Path) -> ConfigurationFile:
    return bench_of(read_configuration(write_current(tmp_path, more=SERVE)))[0]


@contextlib.contextmanager
def life(file: ConfigurationFile) -> Iterator[Desk]:
    """A daemon's desk, without instruments."""
    desk = Desk(file, RealClock(), [])
    desk.writer.start()
    try:
        yield desk
    finally:
        desk.writer.stop()
        desk.latching.close()


def rows(desk: Desk, count: int = 3) -> None:
    for _ in range(count):
        desk.row({"time_s": desk.label_s(), **ROW})
    assert desk.writer.settle()


def word(desk: Desk) -> str:
    desk.online = True
    return str(desk.state()["state"])


def tripped_life(file: ConfigurationFile) -> Path:
    """The folder of a bench that has tripped, and ended."""
    with life(file) as desk:
        rows(desk)
        desk.trip("temperature_limit", "61.6 degC, limit 61.5 degC")
        rows(desk, 25)
        return desk.folder


def damaged(folder: Path, how: str) -> None:
    path = folder / HISTORY
    if how == "deleted":
        path.unlink()
    elif how == "truncated":
        os.truncate(path, path.stat().st_size // 2)
    elif how == "random bytes":
        path.write_bytes(path.read_bytes()[:500] + os.urandom(path.stat().st_size - 500))
    elif how == "trips deleted":
        connection = sqlite3.connect(path)
        connection.execute("DELETE FROM trip")
        connection.commit()
        connection.close()
    elif how == "documents":
        connection = sqlite3.connect(path)
        connection.execute("UPDATE trip SET document = 'no JSON'")
        connection.commit()
        connection.close()


@pytest.mark.parametrize("how", ["whole", "deleted", "truncated", "random bytes", "trips deleted", "documents"])
def test_a_trip_survives_whatever_becomes_of_the_history(file: ConfigurationFile, how: str) -> None:
    damaged(tripped_life(file), how)
    with life(file) as desk:
        assert word(desk) == "tripped"
        assert desk.state()["trip"]["cause"] == "temperature_limit"
        rows(desk)
        kept = reading.trips(desk.folder / HISTORY)
        assert [trip["cause"] for trip in kept] == ["temperature_limit"]
        assert len(kept[0]["rows"]) == (23 if how == "whole" else 0)  # the rows are the history's alone
        assert desk.reset("looked at it")
        desk.writer.settle()
        assert reading.trips(desk.folder / HISTORY)[0]["cleared_because"] == "looked at it"
    with life(file) as desk:
        assert word(desk) == "idle"


def test_a_stop_survives_a_restart_too(file: ConfigurationFile) -> None:
    with life(file) as desk:
        assert word(desk) == "idle"
        desk.stop("a test")
    with life(file) as desk:
        assert word(desk) == "stopped"
        assert desk.state()["stop"]["text"] == "stopped by a test"
        desk.trip("temperature_limit", "a trip takes the place of a stop")
        desk.stop("a test, again")
        assert word(desk) == "tripped"
    with life(file) as desk:
        assert word(desk) == "tripped"


def test_a_new_bench_is_clear_and_stays_so(file: ConfigurationFile) -> None:
    for _ in range(3):
        with life(file) as desk:
            assert word(desk) == "idle"
            rows(desk)


@pytest.mark.parametrize("how", ["truncated", "one slot", "deleted", "deleted, and no history can be read"])
def test_a_latch_that_cannot_be_read_is_a_trip(
    file: ConfigurationFile, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with life(file) as desk:
        rows(desk)
        path = desk.folder / LATCH
    if how.startswith("deleted"):
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:4096] + (b"" if how == "truncated" else b"x" * 4096))
    if how.endswith("read"):
        monkeypatch.setattr("rig.daemon.desk.Store", no_room)
    with life(file) as desk:
        assert word(desk) == "tripped"
        assert desk.state()["trip"]["cause"] == "latch"
        assert "is not known: look at the bench" in desk.state()["trip"]["text"]
        assert (read(path) or Kept("", "", "", 0.0)).state == TRIPPED
        assert desk.reset("looked at it")
    with life(file) as desk:
        assert word(desk) == "idle"


@pytest.mark.parametrize("cleared_s", [None, 1.79e9])
def test_a_trip_in_a_history_from_before_the_file_is_taken_over(
    file: ConfigurationFile, cleared_s: float | None
) -> None:
    with life(file) as desk:
        rows(desk)
        store, folder = desk.writer.store, desk.folder
        assert store is not None
        trip = {"state": TRIPPED, "cause": "runaway", "text": "of before", "at_s": 1.78e9, "rows": [{"time_s": 1.78e9}]}
        desk.writer.do(lambda store: store.save_trip({**trip, "cleared_s": cleared_s}))
    (folder / LATCH).unlink()
    connection = sqlite3.connect(folder / HISTORY)
    connection.execute("PRAGMA user_version = 1")
    connection.close()
    with life(file) as desk:
        assert word(desk) == ("tripped" if cleared_s is None else "idle")
        if cleared_s is None:
            assert desk.state()["trip"] == {"cause": "runaway", "text": "of before", "at_s": 1.78e9, "rows": 1}
        rows(desk)
    with life(file) as desk:
        assert word(desk) == ("tripped" if cleared_s is None else "idle")
    (folder / LATCH).unlink()
    with life(file) as desk:  # by now it has had a file, which is missing
        assert desk.state()["trip"]["cause"] == "latch"


def test_a_trip_is_on_disk_before_it_is_told_and_a_reset_before_a_job_may_start(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[tuple[str, str, str]] = []

    def slowly(path: Path, kept: Kept) -> None:
        found.append((kept.state, word(desk), "held" if no_job_because(desk) else "free"))
        write(path, kept)

    with life(file) as desk:
        desk.output_now("off")
        assert not no_job_because(desk)
        monkeypatch.setattr(latching, "write", slowly)
        tell = desk.announcer.tell
        told: list[tuple[str, str]] = []

        def telling(event: str, data: Any) -> None:
            kept = read(desk.folder / LATCH)
            told.append((event, kept.state if kept is not None else ""))
            tell(event, data)

        monkeypatch.setattr(desk.announcer, "tell", telling)
        desk.trip("temperature_limit", "too hot")
        desk.reset("looked at it")
        desk.output_now("off")
        assert not no_job_because(desk)
    assert found == [("tripped", "idle", "held"), ("clear", "tripped", "held")]
    assert told[0] == ("trip", "tripped")


def test_an_off_that_the_temperature_contradicted_is_not_believed_by_a_stop_either(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    with life(file) as desk:
        monkeypatch.setattr(desk.gate, "stop", lambda why: Off(True, 0.0))
        desk.contradicted = True
        assert desk.stop("a test").confirmed  # by the controller
        assert (desk.state()["output"], desk.state()["output_confirmed"]) == ("unknown", False)
        desk.reset("looked at it")
        assert desk.stop("a test").confirmed
        assert (desk.state()["output"], desk.state()["output_confirmed"]) == ("off", True)


def no_room(*_: object) -> None:
    raise sqlite3.OperationalError("database or disk is full")


def broken(path: Path, kept: Kept) -> None:
    raise OSError(5, "Input/output error")


def test_a_latch_that_cannot_be_written_holds_is_told_and_is_not_reset(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latching, "TRY_AGAIN_S", 0.02)
    with life(file) as desk:
        desk.output_now("off")
        monkeypatch.setattr(latching, "write", broken)
        desk.trip("temperature_limit", "too hot")
        assert word(desk) == "tripped"
        assert any("the latch cannot be written" in line and "Input/output" in line for line in warnings(desk))
        with pytest.raises(Refusal) as refusal:
            Answers(desk).answer({"do": "reset", "reason": "looked at it"})
        assert refusal.value.status == 503
        assert "Input/output error" in refusal.value.lines[0]
        assert word(desk) == "tripped"
        monkeypatch.setattr(latching, "write", write)
        until(lambda: desk.latching.on_disk, "the latch on disk")
        assert (read(desk.folder / LATCH) or Kept("", "", "", 0.0)).text == "too hot"
        assert not any("the latch" in line for line in warnings(desk))


def test_a_disk_that_hangs_holds_up_neither_stop_nor_trip(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on = threading.Event()

    def hanging(path: Path, kept: Kept) -> None:
        goes_on.wait(60.0)
        write(path, kept)

    monkeypatch.setattr(latching, "PATIENCE_S", 0.05)
    with life(file) as desk:
        until(lambda: desk.latching.on_disk)
        monkeypatch.setattr(latching, "write", hanging)
        desk.stop("a test")
        assert word(desk) == "stopped"
        assert any("has not answered yet" in line for line in no_job_because(desk))
        with pytest.raises(NotCleared, match="has not answered yet"):
            desk.reset("looked at it")
        goes_on.set()
        until(lambda: desk.latching.on_disk)
        assert word(desk) == "stopped"
        assert (read(desk.folder / LATCH) or Kept("", "", "", 0.0)).state == "stopped"


def test_a_trip_during_a_reset_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / LATCH
    first = Latch(TRIPPED, "one", "the first", 1.0)
    kept = Latching(path, first.kept(), first)

    def tripping(path: Path, said: Kept) -> None:
        monkeypatch.setattr(latching, "write", write)
        assert said.state == CLEAR
        assert kept.hold(Latch(TRIPPED, "two", "the second", 2.0))
        write(path, said)

    monkeypatch.setattr(latching, "write", tripping)
    with pytest.raises(NotCleared, match="the second"):
        kept.clear("looked at the first", 3.0)
    kept.keep()
    assert kept.told is not None
    assert (kept.told.cause, (read(path) or first.kept()).cause) == ("two", "two")
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
def test_stop_switches_off_whatever_the_disk_with_the_runs_does(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Runs on a network's disk that is gone: whoever presses STOP must not wait for it with the heater on."""
    with life(file) as desk:
        output = Output()
        desk.gate.attach(output)  # type: ignore[arg-type]
        desk.queue.remember([ended_job("old", file.path.parent)])
        disk = Disk(monkeypatch, how == "hangs")
        waiting = desk.submit(file).id if how == "fails" else None
        stops = threading.Thread(target=desk.stop, args=("a test",), daemon=True)
        stops.start()
        assert output.is_off.wait(5.0)
        disk.answers.set()
        stops.join(20.0)
        assert not stops.is_alive()
        assert (desk.output, len(desk.queue)) == ("off", 0)
        if waiting is not None:
            assert [job["state"] for job in desk.queue.tables() if job["id"] == waiting] == ["stopped"]


def test_the_state_asks_no_disk(file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is told from the loop's thread at each phase: a disk that hangs would leave the heater on unwatched."""
    with life(file) as desk:
        desk.queue.remember([ended_job("old", file.path.parent)])
        disk = Disk(monkeypatch, hangs=False)
        assert desk.state()["last_job"]["id"] == "old"
        desk.changed()
        desk.queue.tables()
        assert disk.asked == 0


def test_a_report_that_was_written_after_the_daemon_ended_is_found(file: ConfigurationFile) -> None:
    """Its guard wrote it: the page and `peltier status` have to show where the report of that run is."""
    folder = file.path.parent / "left.part"
    folder.mkdir()
    with life(file) as desk:
        desk.writer.do(lambda store: store.save_job(ended_job("old", folder)))
        assert desk.writer.settle()
    (folder / "report.html").write_text("a report")
    with life(file) as desk:
        until(lambda: desk.state()["last_job"]["report"] == "/runs/old/report.html", "the report")
        assert desk.writer.settle()
    (folder / "report.html").unlink()
    with life(file) as desk:  # what was found is kept
        assert (desk.queue.last_ended() or {})["report"] == "/runs/old/report.html"


def test_no_job_starts_between_finding_and_latching_that_an_output_was_left_on(
    file: ConfigurationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The history could not be read at the start: what it says is latched with the next rows, and a job that waits
    would begin before them."""
    folder = file.path.parent / "left.part"
    folder.mkdir()
    stop = {"reason": DIED, "text": "the temperature goes on", "output_off_confirmed": False}
    (folder / "run.json").write_text(json.dumps({"stop": stop}))
    with life(file) as desk:
        desk.writer.do(lambda store: store.save_job(ended_job("old", folder, state="running", ended_s=None)))
        assert desk.writer.settle()
    with monkeypatch.context() as patched:
        patched.setattr("rig.daemon.desk.Store", no_room)
        desk = Desk(file, RealClock(), [])
    desk.output_now("off")
    desk.writer.start()
    until(lambda: desk.had_history, "the history")
    assert any("the temperature goes on" in line for line in no_job_because(desk))
    rows(desk)
    assert desk.latch is not None
    assert any("the temperature goes on" in line for line in no_job_because(desk))
    desk.close()
