"""The history: roll-ups that agree with the rows, retention, damage, a full disk, a kill, a clock that jumps."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.core.errors import PortHeld
from rig.history import reading
from rig.history.store import DAY_S, WRITER_BUSY_S, FolderLock, Retention, Store, connect_to_read, trouble_of
from rig.history.writer import Writer
from tests.rig.daemon.benches import until

NOON_S = 1_790_000_000.0 // 3600 * 3600


def row(time_s: float, temperature_degC: float = 25.0, **more: Any) -> dict[str, Any]:
    return {"time_s": time_s, "temperature_degC": temperature_degC, "phase": "idle", "quality": "good", **more}


def stored(path: Path, rows: list[dict[str, Any]], retention: Retention | None = None) -> Store:
    store = Store(path, retention or Retention())
    store.add(rows)
    return store


def asked(path: Path, question: str) -> list[tuple[Any, ...]]:
    """What the file answers, by a reader of its own."""
    with contextlib.closing(connect_to_read(path)) as connection:
        return connection.execute(question).fetchall()


def test_roll_ups_hold_mean_low_and_high_of_their_rows(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    rows = [row(NOON_S + 0.5 * k, 25.0 + math.sin(k), resistance_ohm=math.nan) for k in range(2 * 3600 * 2)]
    store = stored(path, rows)
    store.roll_up(NOON_S + 7200.0)
    store.close()
    columns = "count, temperature_degC_mean, temperature_degC_low, temperature_degC_high, resistance_ohm_mean"
    for table, width in (("minute", 120), ("hour", 7200)):
        found = asked(path, f"SELECT {columns} FROM {table} ORDER BY start_s")
        assert len(found) == len(rows) // width
        for k, (count, mean, low, high, ohm) in enumerate(found):
            part = [r["temperature_degC"] for r in rows[k * width : (k + 1) * width]]
            assert count == width
            assert mean == pytest.approx(sum(part) / width, abs=1e-12)
            assert (low, high, ohm) == (min(part), max(part), None)


@settings(max_examples=15, deadline=None)
@given(steps=st.lists(st.floats(0.05, 400.0), min_size=5, max_size=60), cuts=st.sets(st.integers(1, 50), max_size=4))
def test_roll_ups_survive_kills(tmp_path_factory: pytest.TempPathFactory, steps: list[float], cuts: set[int]) -> None:
    folder = tmp_path_factory.mktemp("cut")
    found = []
    for name, at in (("whole", set()), ("cut", cuts)):
        store, time_s = Store(folder / name, Retention()), NOON_S
        for k, step in enumerate(steps):
            time_s += step
            store.add([row(time_s, float(k))])
            store.roll_up(time_s)
            if k in at:  # as after a kill: nothing is closed, another begins
                store = Store(folder / name, Retention())
        store.roll_up(time_s, everything=True)
        found.append([asked(folder / name, f"SELECT * FROM {t} ORDER BY 1") for t in ("minute", "hour")])
        store.close()
    assert found[0] == found[1]


def test_a_long_stretch_comes_from_the_roll_ups_and_keeps_its_extremes(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    rows = [row(NOON_S + 40.0 * k, 25.0) for k in range(20 * 2160)]
    rows[25_000]["temperature_degC"] = 90.0
    store = stored(path, rows, Retention(raw_days=1.0))
    end = rows[-1]["time_s"]
    store.roll_up(end, everything=True)
    while store.retain(end):
        pass
    store.close()
    found = reading.span(path, NOON_S, end, 300)
    column = found["columns"]["temperature_degC"]
    assert found["bucket_s"] >= 60
    assert len(found["time_s"]) <= 301
    assert max(column["high"]) == 90.0
    assert min(column["low"]) == 25.0
    assert reading.span(path, end - 600.0, end, 300)["bucket_s"] == 0


def test_retention_deletes_what_is_older_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    rows = [row(NOON_S + 3600.0 * k) for k in range(24 * 20)]
    end = rows[-1]["time_s"]
    store = stored(path, rows, Retention(raw_days=2.0, minute_days=5.0, hour_days=10.0))
    store.roll_up(end, everything=True)
    while store.retain(end):
        pass
    store.close()
    for table, column, days in (("raw", "time_s", 2), ("minute", "start_s", 5), ("hour", "start_s", 10)):
        ((count, oldest),) = asked(path, f"SELECT count(*), min({column}) FROM {table}")
        assert count == 24 * days + 1
        assert oldest >= end - days * DAY_S


@pytest.mark.parametrize("how", ["header", "middle", "empty", "text"])
def test_a_damaged_file_is_put_aside_and_told(tmp_path: Path, how: str) -> None:
    path = tmp_path / "history.sqlite"
    stored(path, [row(NOON_S + k, resistance_ohm=float(k)) for k in range(5000)]).close()
    data = bytearray(path.read_bytes())
    if how == "header":
        data[:50] = b"\xff" * 50
    elif how == "middle":
        data[20_000:60_000] = os.urandom(40_000)
    path.write_bytes(b"" if how == "empty" else b"no database" * 99 if how == "text" else bytes(data))
    store = Store(path, Retention())
    if how == "empty":
        assert store.damage is None  # as a new one
    else:
        assert "damaged" in str(store.damage)
        assert len(list(tmp_path.glob("history.sqlite.damaged-*"))) >= 1
    store.add([row(NOON_S)])
    store.close()
    assert reading.span(path, NOON_S - 1, NOON_S + 1, 10)["time_s"] == [NOON_S]


def test_rows_are_published_after_their_commit_and_on_a_full_disk_wait_for_room(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    shown: list[float] = []
    told: list[str] = []
    missing: list[float] = []

    def publish(one: dict[str, Any]) -> None:
        if not asked(path, f"SELECT 1 FROM raw WHERE time_s = {one['time_s']!r}"):
            missing.append(one["time_s"])
        shown.append(one["time_s"])

    writer = Writer(path, lambda: Store(path, Retention()), publish, told.append)
    writer.open()
    writer.start()
    for k in range(50):
        writer.row(row(NOON_S + k), float(k))
    assert writer.settle()
    assert shown == [NOON_S + k for k in range(50)]
    assert not missing
    writer.do(lambda store: store.limit_size(1))
    for k in range(50, 2000):
        writer.row(row(NOON_S + k), float(k))
    until(lambda: writer.failure, "the failure")
    writer.do(lambda store: store.limit_size(100_000))  # behind the rows: it is not reached while they wait
    assert not writer.settle(0.5)
    assert len(told) == 1
    assert "full" in told[0]
    assert "make room" in told[0]
    assert set(shown) > stored_times(path)
    lacks = writer.stop()
    assert lacks is not None
    assert "record.csv" in lacks
    assert f"{2000 - len(stored_times(path))} rows" in lacks
    assert asked(path, "PRAGMA integrity_check") == [("ok",)]


def stored_times(path: Path) -> set[float]:
    return {time_s for (time_s,) in asked(path, "SELECT time_s FROM raw")}


@pytest.mark.parametrize("how", ["deleted", "moved", "replaced", "the file alone"])
def test_a_history_that_is_gone_is_begun_anew(how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite goes on writing into a file without a name."""
    monkeypatch.setattr("rig.history.writer.TRY_AGAIN_S", 0.0)
    monkeypatch.setattr("rig.history.writer.PART_OF_TIME", 0.0)
    path, told, shown = tmp_path / "kept" / "h.sqlite", [], []
    writer = Writer(path, lambda: Store(path, Retention()), lambda one: shown.append(one["time_s"]), told.append)
    writer.open()
    writer.start()
    writer.row(row(NOON_S), 0.0)
    assert writer.settle()
    if how == "deleted":
        shutil.rmtree(path.parent)
    elif how == "the file alone":
        path.rename(tmp_path / "old.sqlite")  # without its log, in which all the rows are
    else:
        path.parent.rename(tmp_path / "elsewhere")
    if how == "replaced":
        shutil.copytree(tmp_path / "elsewhere", path.parent)
    for k in (1, 2):
        writer.row(row(NOON_S + k), float(k))
        assert writer.settle()
    writer.stop()
    assert len(told) == 1
    assert "moved or deleted" in told[0]
    assert shown == [NOON_S, NOON_S + 1, NOON_S + 2]
    assert writer.dropped == 0
    kept = [time_s for (time_s,) in asked(path, "SELECT time_s FROM raw ORDER BY id")]
    if how == "the file alone":
        assert stored_times(tmp_path / "old.sqlite") == {NOON_S}
    assert kept == [*([NOON_S] if how == "replaced" else []), NOON_S + 1, NOON_S + 2]


TEN_MINUTES = 6000  # rows, ten a second


@contextlib.contextmanager
def locked(path: Path, how: str = "BEGIN IMMEDIATE") -> Iterator[Callable[[], None]]:
    """Another program's process that has the history locked; what ends it."""
    code = (
        "import sqlite3, sys\n"
        "connection = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        f"for line in {how!r}.split(';'): connection.execute(line).fetchone()\n"
        "print(flush=True); sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", code, str(path), "a_database_browser"]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdin is not None
    assert child.stdout is not None

    def let_go() -> None:
        child.communicate()

    try:
        assert child.stdout.readline()
        yield let_go
    finally:
        if child.returncode is None:
            let_go()


@dataclass
class Told:
    """What a writer says."""

    shown: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)

    def writer(self, path: Path) -> Writer:
        return Writer(
            path,
            lambda: Store(path, Retention()),
            lambda one: self.shown.append(one["time_s"]),
            self.failures.append,
            report=lambda line, stays: self.lines.append(line),
        )

    def begun(self, path: Path) -> Writer:
        writer = self.writer(path)
        writer.open()
        writer.start()
        return writer


@pytest.mark.parametrize(
    ("when", "how"),
    [
        ("in mid run", "BEGIN IMMEDIATE"),
        ("at the start", "BEGIN IMMEDIATE"),
        ("at the start", "PRAGMA locking_mode = EXCLUSIVE;PRAGMA user_version = 1"),  # keeps readers out, too
    ],
)
def test_no_row_is_lost_to_a_long_lock(when: str, how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A database browser that is left open with an edit in it ended runs of hours."""
    monkeypatch.setattr("rig.history.writer.UNREPORTED_S", 0.0)
    path, told = tmp_path / "h.sqlite", Told()
    stored(path, [row(NOON_S)]).close()
    writer = told.writer(path)
    if when == "in mid run":
        writer.open()
    with locked(path, how) as let_go:
        writer.open()
        writer.start()
        for k in range(1, TEN_MINUTES + 1):
            writer.row(row(NOON_S + k), float(k))
        writer.do(lambda store: store.save_job({"id": "1", "queued_s": 1.0}))
        until(lambda: len(told.shown) == TEN_MINUTES, "rows that are shown meanwhile")
        text = until(writer.delay, "a word")
        assert "a_database_browser" in text
        assert "close it there" in text
        assert writer.failure is None
        let_go()
    assert writer.settle()
    assert writer.delay() is None
    assert told.failures == []
    waits, again = told.lines
    assert waits.startswith("the history has to wait: ")
    assert again.startswith("the history is written again; ")
    assert writer.stop() is None
    assert asked(path, "SELECT time_s FROM raw ORDER BY id") == [(NOON_S + k,) for k in range(TEN_MINUTES + 1)]
    assert asked(path, "SELECT count(*) FROM job") == [(1,)]


def test_a_backup_of_a_moment_is_not_worth_a_word(tmp_path: Path) -> None:
    path, told = tmp_path / "h.sqlite", Told()
    writer = told.begun(path)
    with locked(path) as let_go:
        for k in range(10):
            writer.row(row(NOON_S + k), float(k))
        time.sleep(3.0 * WRITER_BUSY_S)  # until it has met the lock
        assert writer.trouble is not None
        assert writer.delay() is None
        let_go()
    assert writer.settle()
    writer.stop()
    assert (told.failures, told.lines) == ([], [])
    assert len(stored_times(path)) == 10


def test_what_a_lock_at_the_end_keeps_out_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.history.writer.LEAVE_S", 1.0)
    path, told = tmp_path / "h.sqlite", Told()
    writer = told.begun(path)
    with locked(path):
        for k in range(70):
            writer.row(row(NOON_S + k), float(k))
        lacks = writer.stop()
    assert lacks is not None
    assert lacks.startswith("the history lacks 70 rows, ")
    assert "record.csv" in lacks
    assert "locked by process" in lacks


def test_a_memory_that_is_full_is_told_and_holds_up_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rig.history.writer.MOST_WAITING", 100)
    path, told = tmp_path / "h.sqlite", Told()
    writer = told.begun(path)
    with locked(path) as let_go:
        writer.row(row(NOON_S), 0.0)
        until(lambda: writer.trouble, "the lock")
        begin_s = time.monotonic()
        for k in range(1, 140):
            writer.row(row(NOON_S + k), float(k))
        assert time.monotonic() - begin_s < 0.5
        assert writer.failure is not None
        assert writer.dropped == 40
        let_go()
    assert writer.settle()
    assert writer.failure is None
    writer.stop()
    assert told.failures == []
    assert [line for line in told.lines if "lacks 40 rows" in line]
    assert stored_times(path) == {NOON_S + k for k in range(100)}


def test_a_history_moved_before_the_end_ends_in_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fallen: list[Any] = []
    monkeypatch.setattr("threading.excepthook", fallen.append)
    path, told = tmp_path / "h.sqlite", Told()
    writer = told.begun(path)
    writer.row(row(NOON_S), 0.0)
    assert writer.settle()
    path.rename(tmp_path / "moved.sqlite")
    writer.stop()
    assert fallen == []
    assert ["moved or deleted" in text for text in told.failures] == [True]


def test_what_comes_while_nothing_waits_in_a_rest_is_written_after_it(tmp_path: Path) -> None:
    """While the instruments are away no row comes that would wake the thread: a trip or a job has to be kept."""
    writer = Told().writer(tmp_path / "h.sqlite")
    writer.open()
    writer._rests_until_s = time.monotonic() + 0.5  # as it gathers rows
    writer.start()
    time.sleep(0.1)
    try:
        assert writer.settle(10.0)
    finally:
        writer.stop()


def test_rows_that_a_slow_disk_has_cost_are_told_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is slow and does not fail: a gap in the history must not be news at the daemon's end alone."""
    monkeypatch.setattr("rig.history.writer.MOST_WAITING", 10)
    monkeypatch.setattr("rig.history.writer.ROOM_S", 0.05)
    answers, add = threading.Event(), Store.add
    monkeypatch.setattr(Store, "add", lambda *given: (answers.wait(60.0), add(*given))[1])
    told = Told()
    writer = told.begun(tmp_path / "h.sqlite")
    for k in range(30):
        writer.row(row(NOON_S + k), float(k))
    answers.set()
    try:
        assert writer.settle()
        assert writer.trouble is None
        assert ["lacks 20 rows" in line for line in told.lines] == [True]
    finally:
        writer.stop()


def test_an_endless_reader_is_named_and_the_log_grows_slowly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SQLite cannot begin its log anew while somebody reads: at ten rows a second it takes gigabytes a day."""
    monkeypatch.setattr("rig.history.writer.MUCH_LOG_BYTES", 100_000)
    monkeypatch.setattr("rig.history.writer.RETAIN_EVERY_S", 0.0)
    path, told = tmp_path / "h.sqlite", Told()
    stored(path, [row(NOON_S)]).close()
    writer = told.begun(path)
    with locked(path, "BEGIN;SELECT * FROM raw") as let_go:
        for k in range(1, 40):
            writer.row(row(NOON_S + k), float(k))
            if writer.delay():
                break
            writer.settle(0.5)
        text = writer.delay()
        assert text is not None
        assert "a_database_browser" in text
        assert "-wal has grown" in text
        before = path.with_name("h.sqlite-wal").stat().st_size
        for k in range(100, 200):
            writer.row(row(NOON_S + k), float(k))
            time.sleep(0.005)
        until(lambda: NOON_S + 199 in told.shown, "rows that are shown at once")
        assert path.with_name("h.sqlite-wal").stat().st_size == before
        let_go()
    writer.stop()
    assert NOON_S + 199 in stored_times(path)


def code_error(code: int, text: str) -> sqlite3.OperationalError:
    error = sqlite3.OperationalError(text)
    error.sqlite_errorcode = code
    return error


@pytest.mark.parametrize(
    ("code", "text", "passes", "says"),
    [
        (sqlite3.SQLITE_BUSY, "database is locked", True, "close it there"),
        (sqlite3.SQLITE_BUSY_SNAPSHOT, "database is locked", True, "close it there"),
        (sqlite3.SQLITE_LOCKED, "database table is locked", True, "close it there"),
        (sqlite3.SQLITE_PROTOCOL, "locking protocol", True, "serve.folder"),
        (sqlite3.SQLITE_IOERR_LOCK, "disk I/O error", True, "serve.folder"),
        (sqlite3.SQLITE_IOERR_SHMMAP, "disk I/O error", True, "serve.folder"),
        (sqlite3.SQLITE_IOERR_WRITE, "disk I/O error", False, "disk I/O error"),
        (sqlite3.SQLITE_FULL, "database or disk is full", False, "make room"),
        (sqlite3.SQLITE_READONLY, "attempt to write a readonly database", False, "let this user write"),
        (sqlite3.SQLITE_CORRUPT, "database disk image is malformed", False, "put aside"),
        (None, "database or disk is full", False, "make room"),
        (None, "database is locked", True, "close it there"),
    ],
)
def test_a_lock_is_told_from_what_does_not_pass(code: int | None, text: str, passes: bool, says: str) -> None:
    error = code_error(code, text) if code is not None else sqlite3.OperationalError(text)
    trouble = trouble_of(error, Path("/bench/history.sqlite"))
    assert trouble.passes is passes
    assert says in trouble.text
    assert trouble.text.startswith("/bench/history.sqlite")


def test_a_history_damaged_in_mid_run_loses_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a backup that is copied back over it."""
    monkeypatch.setattr("rig.history.writer.TRY_AGAIN_S", 0.0)
    monkeypatch.setattr("rig.history.writer.PART_OF_TIME", 0.0)
    path, told = tmp_path / "h.sqlite", Told()
    writer = told.begun(path)
    broken = [True]

    def damaged(store: Store) -> None:
        if broken.pop():
            broken.append(False)
            raise code_error(sqlite3.SQLITE_CORRUPT, "database disk image is malformed")

    writer.do(damaged)
    writer.row(row(NOON_S), 0.0)
    assert writer.settle()
    writer.stop()
    assert len(told.failures) == 1
    assert stored_times(path) == {NOON_S}


CHILD = """
import sys
from pathlib import Path
from rig.history.store import Retention, Store
from rig.history.writer import Writer
def show(row):
    sys.stdout.write(f"{row['time_s']}\\n"); sys.stdout.flush()
path = Path(sys.argv[1])
writer = Writer(path, lambda: Store(path, Retention()), show, print)
writer.open()
writer.start()
k = 0
while True:
    writer.row({"time_s": float(sys.argv[2]) + k, "temperature_degC": 1.0 * k}, float(k)); k += 1
    if k % 1000 == 0:
        writer.settle()
"""


def test_nothing_that_was_shown_is_lost_by_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    shown: set[float] = set()
    for life in range(3):
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, str(path), str(1e6 * life)], stdout=subprocess.PIPE, text=True
        )
        assert child.stdout is not None
        for _ in range(300 + 200 * life):
            shown.add(float(child.stdout.readline()))
        child.send_signal(signal.SIGKILL)
        rest = child.stdout.read()
        shown |= {float(line) for line in rest.splitlines(keepends=True) if line.endswith("\n")}
        child.stdout.close()
        child.wait()
    store = Store(path, Retention())
    assert store.damage is None
    store.close()
    assert shown <= stored_times(path)


def test_a_reader_cannot_write(tmp_path: Path) -> None:
    store = stored(tmp_path / "h.sqlite", [row(NOON_S)])
    with pytest.raises(sqlite3.OperationalError, match="readonly"):
        asked(tmp_path / "h.sqlite", "DELETE FROM raw")
    store.close()


def test_a_folder_has_one_writer_room_for_its_lock_or_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = FolderLock(tmp_path / "kept"), FolderLock(tmp_path / "kept")
    first.take()
    first.take()  # it has it already
    with pytest.raises(PortHeld, match=f"process {os.getpid()}"):
        second.take()
    first.close()
    (tmp_path / "kept" / "history.lock").unlink()
    plain = os.open

    def full(path: str | Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_CREAT:
            raise OSError(errno.ENOSPC, "No space left on device")
        return plain(path, flags, mode)

    monkeypatch.setattr("rig.core.file_writing.os.open", full)
    second.take()
    monkeypatch.undo()  # there is room by now
    with pytest.raises(PortHeld):
        first.take()
    second.close()
    first.take()
    (tmp_path / "kept").rename(tmp_path / "elsewhere")
    first.take()  # of the folder that has the name now
    with pytest.raises(PortHeld):
        second.take()
    first.close()


RETENTION = Retention(raw_days=2.0, minute_days=5.0, hour_days=10.0)
BATCH_S = 200 * 60.0  # the writer deletes after a batch of rows, and here they come as fast as it takes them
Moments = list[tuple[float, float]]  # time of day and time that has passed, s


def life(path: Path, moments: Moments) -> list[float]:
    """A daemon that writes a row at each moment; the jumps that it told of."""
    told: list[float] = []
    writer = Writer(path, lambda: Store(path, RETENTION), lambda row: None, lambda text: None, told.append)
    writer.open()
    writer.start()
    for wall_s, clock_s in moments:
        writer.row({"time_s": wall_s, "temperature_degC": 25.0}, clock_s)
    assert writer.settle(60.0)
    assert writer.failure is None
    writer.stop()
    return told


def even(begin_s: float, lasts_s: float, step_s: float, clock_s: float = 0.0, off_s: float = 0.0) -> Moments:
    """Moments of an even course; off_s: by how much the time of day is wrong."""
    count = int(lasts_s / step_s)
    return [(begin_s + off_s + k * step_s, clock_s + k * step_s) for k in range(count)]


def labels(path: Path, table: str = "raw", column: str = "time_s") -> list[float]:
    connection = connect_to_read(path)
    found = [row[0] for row in connection.execute(f"SELECT {column} FROM {table} ORDER BY {column}")]
    connection.close()
    return found


@pytest.mark.parametrize("off_days", [4000.0, -20000.0])
@pytest.mark.parametrize("restarts", [False, True])
def test_a_clock_wrong_for_75_s_deletes_nothing_and_is_told(tmp_path: Path, off_days: float, restarts: bool) -> None:
    path, off_s = tmp_path / "h.sqlite", off_days * DAY_S
    before = even(NOON_S, 1.5 * DAY_S, 60.0)
    end_s, clock_s = NOON_S + 1.5 * DAY_S, 1.5 * DAY_S
    wrong = even(end_s, 75.0, 1.0, clock_s, off_s)
    after = even(end_s + 75.0, 600.0, 1.0, clock_s + 75.0)
    if restarts:
        life(path, before)
        jumps = [*life(path, wrong), *life(path, after)]
        assert jumps[0] < 0.0  # forward the daemon may have been away; back it was not
        assert len(jumps) == 1
    else:
        jumps = life(path, [*before, *wrong, *after])
        assert jumps == [pytest.approx(off_s), pytest.approx(-off_s)]
    everything = sorted(wall_s for wall_s, _ in [*before, *wrong, *after])
    assert labels(path) == everything
    for table, width in (("minute", 60), ("hour", 3600)):  # and every row is in a roll-up
        assert labels(path, table, "start_s") == sorted({wall_s // width * width for wall_s in everything})


def test_after_a_jump_retention_goes_on_as_if_there_had_been_none(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    wrong = even(NOON_S + 6 * 3600.0, 75.0, 1.0, 6 * 3600.0, -900.0 * DAY_S)
    later = even(NOON_S + 6 * 3600.0 + 100.0, 3.0 * DAY_S, 60.0, 6 * 3600.0 + 100.0)
    life(path, [*even(NOON_S, 6 * 3600.0, 60.0), *wrong, *later])
    end_s = later[-1][0]
    assert labels(path)[0] == pytest.approx(end_s - 2.0 * DAY_S, abs=BATCH_S)
    assert labels(path, "hour", "start_s")[0] < NOON_S - 899.0 * DAY_S  # what was measured then is kept as long as all


def test_a_clock_that_stays_wrong_and_a_bench_that_was_off_age_nothing(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    wrong = even(NOON_S + 1.0 * DAY_S, 0.8 * DAY_S, 60.0, 1.0 * DAY_S, 400.0 * DAY_S)
    life(path, [*even(NOON_S, 1.0 * DAY_S, 60.0), *wrong])
    again_s = NOON_S + 900.0 * DAY_S
    assert life(path, even(again_s, 3600.0, 60.0)) == []  # forward: it was off
    assert labels(path)[0] == NOON_S
    life(path, even(again_s + 3600.0, 1.0 * DAY_S, 60.0))
    assert labels(path)[0] > NOON_S + 0.5 * DAY_S  # two days of running are kept


def test_a_jump_back_into_hours_whose_rows_are_gone_leaves_their_roll_ups(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    life(path, even(NOON_S, 4.0 * DAY_S, 60.0))
    hours = labels(path, "hour", "count")
    back = even(NOON_S + 4.0 * DAY_S, 600.0, 1.0, 4.0 * DAY_S, -3.5 * DAY_S)
    assert life(path, back) == [pytest.approx(-3.5 * DAY_S, abs=100.0)]
    assert labels(path, "hour", "count") == hours
    assert set(labels(path, "hour", "count")) == {60}


def test_a_server_that_slews_and_a_busy_computer_are_no_jump(tmp_path: Path) -> None:
    moments = [(NOON_S + 1.0005 * k + (4.0 if k % 100 == 50 else 0.0), float(k)) for k in range(2000)]
    assert life(tmp_path / "h.sqlite", moments) == []
