"""Opening a history that may have been damaged: what is broken is put aside, told, and a new one begun."""

from __future__ import annotations

import contextlib
import datetime
import json
import sqlite3
from pathlib import Path

from rig.history.tables import COLUMNS, connect_to_write, create
from rig.history.trouble import SIDE_FILES, trouble_of


def opened(path: Path) -> tuple[sqlite3.Connection, str | None]:
    """A connection to write with, and what was wrong with the file that was there; None where it was whole.

    Raises sqlite3.Error or OSError where not even a new file can be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fault = what_is_wrong(path)
    if fault is not None:
        aside = _put_aside(path)
        fault = f"history: {path.name} was damaged ({fault}); it is kept as {aside.name} and a new one was begun"
    try:
        connection = connect_to_write(path)
        create(connection)
    except sqlite3.Error as error:
        if fault is None:
            raise
        raise sqlite3.OperationalError(f"{fault}, which failed: {error}") from None
    return connection, fault


def what_is_wrong(path: Path) -> str | None:
    """What SQLite's quick check says of a file; None where all is well or no file is there."""
    if not path.exists():
        return None
    connection: sqlite3.Connection | None = None
    try:
        connection = connect_to_write(path)  # recovers what a killed writer left in the log
        connection.execute("BEGIN IMMEDIATE")  # a lock is met before the long check
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
    """What a whole database of SQLite lacks to be a history: columns, or documents that can be read (ValueError)."""
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
