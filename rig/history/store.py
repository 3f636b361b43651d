"""The history database: its tables, its one writer, and what happens to a damaged file.

    raw           one row a control cycle: about one a second while idle, one every `period_s` in a run
    minute, hour  mean, low and high of every quantity in a bucket; start_s is the bucket's begin
    job, trip     JSON documents
    kept          numbers that a restart needs: how far the roll-ups are, and the aging clock

Times are Unix seconds: a label, never a basis of control. Not-a-number is NULL; an overrange resistance is infinite.
`written_s` is the clock by which rows grow old, `aged_s` its present value (`rig.history.writer`).

Sources: SQLite's result codes, https://www.sqlite.org/rescode.html; the bytes locked in `-shm`,
https://www.sqlite.org/walformat.html#wal_locks; the lines of /proc/locks, proc_locks(5).
"""

from __future__ import annotations

import contextlib
import datetime
import json
import math
import os
import sqlite3
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.clock import DAY_S
from rig.core.errors import PortHeld
from rig.core.file_writing import command_of, locked, tell_holder
from rig.core.reading import KEPT

SIDE_FILES = ("", "-wal", "-shm")
# SQLITE_IOERR_RDLOCK, _UNLOCK, _BLOCKED, _CHECKRESERVEDLOCK, _LOCK, _SHMOPEN, _SHMLOCK, _SHMMAP: the file system's
# locks and shared memory, as on a network folder
NO_LOCKS = {sqlite3.SQLITE_IOERR | number << 8 for number in (8, 9, 11, 14, 15, 18, 20, 21)} | {sqlite3.SQLITE_PROTOCOL}
READ_MARKS = range(123, 128)  # bytes of -shm that are locked by whoever reads
PLAIN_CODE = 0xFF  # of an extended result code
BY_TEXT = {"locked": sqlite3.SQLITE_BUSY, "full": sqlite3.SQLITE_FULL, "readonly": sqlite3.SQLITE_READONLY}


@dataclass(frozen=True)
class Trouble:
    """An error of the history. text: what, where, what to do; passes: rows wait, and no run is ended; anew: the file
    has to be opened again; damage: it is no readable history."""

    text: str
    passes: bool = False
    anew: bool = False
    damage: bool = False


def trouble_of(error: sqlite3.Error | OSError, path: Path) -> Trouble:
    """Return the trouble behind an error of the history at `path`."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:  # an exception of Python's own
        code = next((number for word, number in BY_TEXT.items() if word in str(error)), None)
    if code in NO_LOCKS:
        do = "set serve.folder to a folder on a disk of this computer"
        return Trouble(f"{path}: its file system does not lock files as it should ({error}); {do}", passes=True)
    if code is None or isinstance(error, OSError):
        return Trouble(f"{path}: {error}")
    match code & PLAIN_CODE:
        case sqlite3.SQLITE_BUSY | sqlite3.SQLITE_LOCKED:
            who = who_locks(path) or "another program, such as a database browser or a backup"
            return Trouble(f"{path} is locked by {who}; close it there", passes=True)
        case sqlite3.SQLITE_FULL:
            return Trouble(f"{path}: {error}: make room on that disk")
        case sqlite3.SQLITE_READONLY:
            return Trouble(f"{path}: {error}: let this user write it and its folder", anew=True)
        case sqlite3.SQLITE_CORRUPT | sqlite3.SQLITE_NOTADB | sqlite3.SQLITE_ERROR | sqlite3.SQLITE_FORMAT:
            return Trouble(f"{path}: {error}: it is put aside, and a new one begun", anew=True, damage=True)
    return Trouble(f"{path}: {error}", anew=True)


def who_locks(path: Path) -> str:
    """Return the other processes that have the history locked for writing, in words; "" if none is found (Linux)."""
    return _in_words(path, SIDE_FILES, "WRITE", range(1 << 62))


def who_reads(path: Path) -> str:
    """Return the other processes that are reading the history, in words; "" if none is found (Linux)."""
    return _in_words(path, ("-shm",), "READ", READ_MARKS)


def _in_words(path: Path, endings: tuple[str, ...], how: str, at: range) -> str:
    inodes = {there.st_ino for ending in endings if (there := stat_of(Path(f"{path}{ending}"))) is not None}
    found = dict.fromkeys(
        process
        for process, kind, inode, first in _locks()
        if kind == how and inode in inodes and first in at and process > 0 and process != os.getpid()
    )
    return ", ".join(f"process {number} ({command_of(number)})".replace(" ()", "") for number in found)


def _locks() -> Iterator[tuple[int, str, int, int]]:
    """Yield (process, "READ" or "WRITE", inode, first byte) of each lock on this computer."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if "->" not in words:  # those with an arrow wait for the lock
                yield int(words[4]), words[3], int(words[5].rsplit(":", 1)[1]), int(words[6])


def stat_of(path: Path) -> os.stat_result | None:
    """Return the status of a file; None if there is none."""
    try:
        return os.stat(path)
    except OSError:
        return None


WORDS = ("quality", "phase", "job")
RAW_COLUMNS = ("time_s", *KEPT, *WORDS)
BUCKETS_S = {"minute": 60, "hour": 3600}  # width of a roll-up's bucket, s
ROLLED = tuple(f"{name}_{of}" for name in KEPT for of in ("mean", "low", "high"))
COLUMNS = {
    "raw": ("id", *RAW_COLUMNS, "written_s"),
    **dict.fromkeys(BUCKETS_S, ("start_s", "count", *ROLLED, "written_s")),
    "job": ("id", "queued_s", "document"),
    "trip": ("id", "at_s", "document"),
    "kept": ("name", "value"),
}
VERSION = 2  # PRAGMA user_version
BUSY_S, WRITER_BUSY_S = 5.0, 0.5  # for which a question waits for a lock, and a write, which is tried again soon
DELETED_AT_ONCE = 5000  # rows: a deletion must not hold up the next row for long
KEPT_JOBS = 2000
AGED = "aged_s"
LOCK = "history.lock"  # in the folder; it contains the process number of its holder
READABLE = 0o644  # by other users too, whose daemon then reports the holder
_INSERT = f"INSERT INTO raw ({', '.join(RAW_COLUMNS)}, written_s) VALUES ({', '.join('?' * (len(RAW_COLUMNS) + 1))})"


@dataclass(frozen=True)
class Retention:
    """Days for which rows, minutes and hours are kept."""

    raw_days: float = 30.0
    minute_days: float = 400.0
    hour_days: float = 4000.0


class FolderLock:
    """The right to write into a folder, from `take` to `close`.

    There are two locks, because each may be impossible: a full disk has no room for the file, and some network file
    systems lock no folders. One that somebody else holds is enough for a refusal.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptors: list[int] = []
        self._locked: os.stat_result | None = None  # the folder

    def take(self) -> None:
        """Take the locks, unless they are held and the folder is still the same. Raises PortHeld, or OSError if no lock
        is possible."""
        self._folder.mkdir(parents=True, exist_ok=True)
        folder = os.stat(self._folder)
        if self._descriptors and self._locked is not None and os.path.samestat(folder, self._locked):
            return
        self.close()
        self._locked = folder
        failure: OSError | None = None
        for path in (self._folder, self._folder / LOCK):
            try:
                self._descriptors.append(locked(path, str(self._folder), self._folder / LOCK, READABLE))
            except PortHeld:
                self.close()
                raise
            except OSError as error:
                failure = error
        if not self._descriptors and failure is not None:
            raise failure
        tell_holder(self._folder / LOCK)

    def close(self) -> None:
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = []


class Store:
    """The history's one writer. Every method raises sqlite3.Error if the disk is full or gone.

    damage: what was wrong with the file, None if it was whole.
    """

    def __init__(self, path: Path, retention: Retention) -> None:
        self.path = path
        self._retention = retention
        self._connection, self.damage = opened(path)
        self._files = self._stats()
        self._rolled: dict[str, int] = {}  # bucket that is open now

    def in_place(self) -> bool:
        """Return True if file and log are still those of their names: a moved or deleted one takes rows silently."""
        pairs = zip(self._files, self._stats(), strict=True)
        return all(was is None or (now is not None and os.path.samestat(was, now)) for was, now in pairs)

    def _stats(self) -> list[os.stat_result | None]:
        return [stat_of(Path(f"{self.path}{ending}")) for ending in ("", "-wal")]

    def log_bytes(self) -> int:
        """Return the size of the write-ahead log; 0 if there is none."""
        log = self._stats()[1]
        return log.st_size if log is not None else 0

    def add(self, rows: Iterable[dict[str, Any]], aged_s: float | None = None) -> None:
        """Commit rows, {column: value} each; missing columns are NULL."""
        values = [(*(_plain(row.get(name)) for name in RAW_COLUMNS), aged_s) for row in rows]
        with self._transaction():
            self._connection.executemany(_INSERT, values)

    def save_job(self, job: dict[str, Any]) -> None:
        self._connection.execute(
            "INSERT INTO job (id, queued_s, document) VALUES (?, ?, ?) "
            "ON CONFLICT (id) DO UPDATE SET document = excluded.document",
            (job["id"], job["queued_s"], json.dumps(job)),
        )

    def save_trip(self, trip: dict[str, Any], number: int | None = None) -> int:
        """Save a trip, new or (by its number) changed; return its number."""
        cursor = self._connection.execute(
            "INSERT INTO trip (id, at_s, document) VALUES (?, ?, ?) "
            "ON CONFLICT (id) DO UPDATE SET document = excluded.document",
            (number, trip["at_s"], json.dumps(trip)),
        )
        return number if number is not None else int(cursor.lastrowid or 0)

    def jobs(self, count: int = 200) -> list[dict[str, Any]]:
        """Return the last jobs, the oldest first."""
        found = self._connection.execute("SELECT document FROM job ORDER BY rowid DESC LIMIT ?", (count,))
        return [json.loads(row[0]) for row in found][::-1]

    def last_trip(self) -> tuple[int, dict[str, Any]] | None:
        row = self._connection.execute("SELECT id, document FROM trip ORDER BY id DESC LIMIT 1").fetchone()
        return (int(row[0]), json.loads(row[1])) if row else None

    def last_label_s(self) -> float | None:
        """Return the time of the row that was written last; None if there is none."""
        row = self._connection.execute("SELECT time_s FROM raw ORDER BY id DESC LIMIT 1").fetchone()
        return float(row[0]) if row else None

    def aged_s(self) -> float | None:
        """Return the aging clock as last saved; None in a history that has none yet."""
        return self._number(AGED)

    def roll_up(self, now_s: float, everything: bool = False, aged_s: float | None = None) -> None:
        """Bring minutes and hours up to date. Buckets are computed from raw rows again, so that a kill loses none."""
        for table, width_s in BUCKETS_S.items():
            bucket = int(now_s // width_s) * width_s
            if self._rolled.get(table) == bucket and not everything:
                continue
            with self._transaction():
                self._roll(table, width_s, aged_s)
            self._rolled[table] = bucket

    def _roll(self, table: str, width_s: int, aged_s: float | None) -> None:
        """Compute every bucket that got a row since the last time, wherever a clock that jumped has put it.

        A bucket from which retention may have deleted rows stays as it is: computed again it would lose them.
        """
        last = self._connection.execute("SELECT max(id) FROM raw").fetchone()[0]
        if last is None:
            return
        done = self._number(f"rolled_{table}") or 0
        starts = self._connection.execute(
            f"SELECT DISTINCT cast(time_s / {width_s} AS INTEGER) * {width_s} FROM raw WHERE id > ?",
            (done if done <= last else 0,),
        ).fetchall()
        names = ["start_s", "count", *ROLLED, "written_s"]
        parts = ", ".join(f"avg({q}), min({q}), max({q})" for q in KEPT)
        whole_s = -math.inf if aged_s is None else aged_s - self._retention.raw_days * DAY_S
        self._connection.executemany(
            f"INSERT INTO {table} ({', '.join(names)}) SELECT :start, count(*), {parts}, :aged FROM raw "
            f"WHERE time_s >= :start AND time_s < :start + {width_s} "
            f"ON CONFLICT (start_s) DO UPDATE SET {', '.join(f'{n} = excluded.{n}' for n in names[1:])} "
            f"WHERE coalesce({table}.written_s, {table}.start_s) >= :whole",
            [{"start": start, "aged": aged_s, "whole": whole_s} for (start,) in starts],
        )
        self._keep_number(f"rolled_{table}", last)

    def retain(self, aged_s: float) -> int:
        """Delete some of the rows that are too old by the aging clock, and keep its value; return how many."""
        keep, gone = self._retention, 0
        with self._transaction():
            for table, column, days, oldest in (
                ("raw", "time_s", keep.raw_days, "ORDER BY rowid"),  # the order of writing, which needs no index
                ("minute", "start_s", keep.minute_days, "WHERE coalesce(written_s, start_s) < :from"),
                ("hour", "start_s", keep.hour_days, "WHERE coalesce(written_s, start_s) < :from"),
            ):
                gone += self._connection.execute(
                    f"DELETE FROM {table} WHERE coalesce(written_s, {column}) < :from "
                    f"AND rowid IN (SELECT rowid FROM {table} {oldest} LIMIT :most)",
                    {"from": aged_s - days * DAY_S, "most": DELETED_AT_ONCE},
                ).rowcount
            self._connection.execute(
                "DELETE FROM job WHERE id IN (SELECT id FROM job ORDER BY rowid DESC LIMIT -1 OFFSET ?)", (KEPT_JOBS,)
            )
            self._keep_number(AGED, aged_s)
        return gone

    def limit_size(self, pages: int) -> None:
        """Let the file grow to so many pages of 4 KiB, as on a full disk (for tests)."""
        self._connection.execute(f"PRAGMA max_page_count = {pages}")

    def close(self) -> None:
        """Close the file; never raises. The log is emptied first: SQLite would leave that of a moved file behind, with
        rows that are nowhere else."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()

    def _number(self, name: str) -> float | None:
        row = self._connection.execute("SELECT value FROM kept WHERE name = ?", (name,)).fetchone()
        return float(row[0]) if row else None

    def _keep_number(self, name: str, value: float) -> None:
        self._connection.execute("INSERT OR REPLACE INTO kept (name, value) VALUES (?, ?)", (name, value))

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        """Commit all of it, or nothing."""
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                with contextlib.suppress(sqlite3.Error):
                    self._connection.execute("ROLLBACK")
            raise


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value


def opened(path: Path) -> tuple[sqlite3.Connection, str | None]:
    """Return a connection to write with, and what was wrong with the file; None if it was whole.

    A damaged file is put aside and a new one begun. Raises sqlite3.Error or OSError if not even that is possible.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fault = what_is_wrong(path)
    if fault is not None:
        aside = _put_aside(path)
        fault = f"history: {path.name} was damaged ({fault}); it is kept as {aside.name} and a new one was begun"
    try:
        connection = connect_to_write(path)
        _create_tables(connection)
    except sqlite3.Error as error:
        if fault is None:
            raise
        raise sqlite3.OperationalError(f"{fault}, which failed: {error}") from None
    return connection, fault


def what_is_wrong(path: Path) -> str | None:
    """Return the fault that SQLite's quick check finds; None if the file is whole or missing."""
    if not path.exists():
        return None
    connection: sqlite3.Connection | None = None
    try:
        connection = connect_to_write(path)  # recovers a log that a killed writer left
        connection.execute("BEGIN IMMEDIATE")  # a lock is found before the long check
        connection.execute("ROLLBACK")
        lines = [str(row[0]) for row in connection.execute("PRAGMA quick_check(5)")]
        return _not_ours(connection) if lines == ["ok"] else "; ".join(lines)[:300]
    except (sqlite3.DatabaseError, ValueError) as error:
        if isinstance(error, sqlite3.DatabaseError) and not trouble_of(error, path).damage:
            raise
        return str(error)
    finally:
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()


def _not_ours(connection: sqlite3.Connection) -> str | None:
    """Return the columns that a whole database lacks to be a history. Raises ValueError for a broken document."""
    for table, expected in COLUMNS.items():
        there = {str(row[1]) for row in connection.execute(f"PRAGMA table_info({table})")}
        if there and not there.issuperset(expected):
            return f"its table {table} lacks {', '.join(sorted(set(expected) - there))}"
        if there and "document" in expected:
            for (document,) in connection.execute(f"SELECT document FROM {table}"):
                json.loads(document)
    return None


def _put_aside(path: Path) -> Path:
    now = datetime.datetime.now(datetime.UTC)
    aside = path.with_name(f"{path.name}.damaged-{now:%Y%m%dT%H%M%S%f}Z")
    for ending in SIDE_FILES:
        part = path.with_name(path.name + ending)
        if part.exists():
            part.rename(aside.with_name(aside.name + ending))
    return aside


def _create_tables(connection: sqlite3.Connection) -> None:
    """Create missing tables. Raises sqlite3.Error."""
    quantities, words, rolled = (
        ", ".join(f"{name} {kind}" for name in names)
        for names, kind in ((KEPT, "REAL"), (WORDS, "TEXT"), (ROLLED, "REAL"))
    )
    tables = {
        "raw": f"id INTEGER PRIMARY KEY, time_s REAL NOT NULL, {quantities}, {words}, written_s REAL",
        **dict.fromkeys(BUCKETS_S, f"start_s INTEGER PRIMARY KEY, count INTEGER NOT NULL, {rolled}, written_s REAL"),
        "job": "id TEXT PRIMARY KEY, queued_s REAL NOT NULL, document TEXT",
        "trip": "id INTEGER PRIMARY KEY, at_s REAL NOT NULL, document TEXT",
        "kept": "name TEXT PRIMARY KEY, value REAL NOT NULL",
    }
    for name, columns in tables.items():
        connection.execute(f"CREATE TABLE IF NOT EXISTS {name} ({columns})")
    connection.execute("CREATE INDEX IF NOT EXISTS raw_time ON raw (time_s)")
    for name in BUCKETS_S:
        connection.execute(f"CREATE INDEX IF NOT EXISTS {name}_age ON {name} (coalesce(written_s, start_s))")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def connect_to_write(path: Path) -> sqlite3.Connection:
    """Return the writer's connection: WAL, every statement its own transaction unless one is begun.

    synchronous = NORMAL: a commit survives the end of the process at any moment; a power cut may take the last second.
    """
    connection = sqlite3.connect(path, timeout=WRITER_BUSY_S, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA journal_size_limit = 33554432")
    return connection


def connect_to_read(path: Path) -> sqlite3.Connection:
    """Return a connection that cannot write; a writer at the same time is fine."""
    address = f"{path.absolute().as_uri()}?mode=ro"  # a folder's name may contain ?, # and %
    return sqlite3.connect(address, uri=True, timeout=BUSY_S, check_same_thread=False)
