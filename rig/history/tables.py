"""The tables of the history: one wide table of rows as they were measured, and roll-ups of it.

    raw           a row a control cycle: about one a second while idle, as the experiment's period says in a run
    minute, hour  mean, low and high of every quantity in a bucket; start_s is the bucket's beginning
    job, trip     what was asked and what ended it, as JSON
    kept          numbers that a restart needs: where the roll-ups are, and the clock by which rows grow old

Times are Unix seconds: a label, never a basis of control. Not-a-number is NULL; an overrange resistance is infinite.
`written_s` is when a row was written, by the clock of `rig.history.aging`; NULL in rows from before there was one.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from rig.core.columns import KEPT

WORDS = ("quality", "phase", "job")
RAW_COLUMNS = ("time_s", *KEPT, *WORDS)
BUCKETS_S = {"minute": 60, "hour": 3600}  # s of a roll-up's bucket
ROLLED = tuple(f"{name}_{of}" for name in KEPT for of in ("mean", "low", "high"))
COLUMNS = {  # without written_s, which an older program's tables lack
    "raw": ("id", *RAW_COLUMNS),
    **dict.fromkeys(BUCKETS_S, ("start_s", "count", *ROLLED)),
    "job": ("id", "queued_s", "document"),
    "trip": ("id", "at_s", "document"),
    "kept": ("name", "value"),
}
VERSION = 1  # PRAGMA user_version
VERSION_LATCHED = 2  # the same tables, and the latch's file was beside them
BUSY_S = 5.0  # that a question waits for a lock
WRITER_BUSY_S = 0.5  # that a try to write does; there is another one soon


def create(connection: sqlite3.Connection) -> None:
    """Make the tables where they are missing. Raises sqlite3.Error."""
    quantities = ", ".join(f"{name} REAL" for name in KEPT)
    words = ", ".join(f"{name} TEXT" for name in WORDS)
    rolled = ", ".join(f"{name} REAL" for name in ROLLED)
    connection.execute(
        f"CREATE TABLE IF NOT EXISTS raw "
        f"(id INTEGER PRIMARY KEY, time_s REAL NOT NULL, {quantities}, {words}, written_s REAL)"
    )
    connection.execute("CREATE INDEX IF NOT EXISTS raw_time ON raw (time_s)")
    for name in BUCKETS_S:
        connection.execute(
            f"CREATE TABLE IF NOT EXISTS {name} "
            f"(start_s INTEGER PRIMARY KEY, count INTEGER NOT NULL, {rolled}, written_s REAL)"
        )
    for name in ("raw", *BUCKETS_S):
        if "written_s" not in {row[1] for row in connection.execute(f"PRAGMA table_info({name})")}:
            connection.execute(f"ALTER TABLE {name} ADD COLUMN written_s REAL")  # of an older program
    connection.execute("CREATE TABLE IF NOT EXISTS job (id TEXT PRIMARY KEY, queued_s REAL NOT NULL, document TEXT)")
    connection.execute("CREATE TABLE IF NOT EXISTS trip (id INTEGER PRIMARY KEY, at_s REAL NOT NULL, document TEXT)")
    connection.execute("CREATE TABLE IF NOT EXISTS kept (name TEXT PRIMARY KEY, value REAL NOT NULL)")
    if version(connection) < VERSION:
        connection.execute(f"PRAGMA user_version = {VERSION}")


def version(connection: sqlite3.Connection) -> int:
    """Of the tables; 0 where there are none."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def connect_to_write(path: Path) -> sqlite3.Connection:
    """A connection for the one who writes: WAL, every statement its own transaction unless one is begun.

    synchronous = NORMAL: what is committed survives the end of the process at any moment; the end of the computer's
    power may take the last second.
    """
    connection = sqlite3.connect(path, timeout=WRITER_BUSY_S, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA journal_size_limit = 33554432")
    return connection


def connect_to_read(path: Path) -> sqlite3.Connection:
    """A connection that cannot write; a writer at the same time is fine."""
    address = f"{path.absolute().as_uri()}?mode=ro"  # a folder's name may hold ?, # and %
    return sqlite3.connect(address, uri=True, timeout=BUSY_S, check_same_thread=False)
