"""The tables of the history: one wide table of rows as they were measured, and roll-ups of it.

    raw           a row a control cycle: about one a second while idle, as the experiment's period says in a run
    minute, hour  mean, low and high of every quantity in a bucket; start_s is the bucket's beginning
    job, trip     what was asked and what ended it, as JSON

Times are Unix seconds: a label, never a basis of control. Not-a-number is NULL; an overrange resistance is infinite.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

QUANTITIES = (
    "temperature_degC",
    "resistance_ohm",
    "current_A",
    "meter_current_A",
    "setpoint_degC",
    "reference_degC",
    "target_ohm",
    "predicted_ohm",
)
WORDS = ("quality", "phase", "job")
RAW_COLUMNS = ("time_s", *QUANTITIES, *WORDS)
BUCKETS_S = {"minute": 60, "hour": 3600}
VERSION = 1  # PRAGMA user_version
BUSY_S = 5.0


def create(connection: sqlite3.Connection) -> None:
    """Make the tables where they are missing. Raises sqlite3.Error."""
    quantities = ", ".join(f"{name} REAL" for name in QUANTITIES)
    words = ", ".join(f"{name} TEXT" for name in WORDS)
    rolled = ", ".join(f"{name}_{of} REAL" for name in QUANTITIES for of in ("mean", "low", "high"))
    connection.execute(
        f"CREATE TABLE IF NOT EXISTS raw (id INTEGER PRIMARY KEY, time_s REAL NOT NULL, {quantities}, {words})"
    )
    connection.execute("CREATE INDEX IF NOT EXISTS raw_time ON raw (time_s)")
    for name in BUCKETS_S:
        connection.execute(
            f"CREATE TABLE IF NOT EXISTS {name} (start_s INTEGER PRIMARY KEY, count INTEGER NOT NULL, {rolled})"
        )
    connection.execute("CREATE TABLE IF NOT EXISTS job (id TEXT PRIMARY KEY, queued_s REAL NOT NULL, document TEXT)")
    connection.execute("CREATE TABLE IF NOT EXISTS trip (id INTEGER PRIMARY KEY, at_s REAL NOT NULL, document TEXT)")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def connect_to_write(path: Path) -> sqlite3.Connection:
    """A connection for the one who writes: WAL, every statement its own transaction unless one is begun.

    synchronous = NORMAL: what is committed survives the end of the process at any moment; the end of the computer's
    power may take the last second.
    """
    connection = sqlite3.connect(path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA journal_size_limit = 33554432")
    return connection


def connect_to_read(path: Path) -> sqlite3.Connection:
    """A connection that cannot write; a writer at the same time is fine."""
    address = f"{path.absolute().as_uri()}?mode=ro"  # a folder's name may hold ?, # and %
    return sqlite3.connect(address, uri=True, timeout=BUSY_S, check_same_thread=False)
