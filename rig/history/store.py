"""Writing the history: rows, jobs and trips, each committed when the call returns; roll-ups and retention."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.history.damage import opened
from rig.history.tables import BUCKETS_S, QUANTITIES, RAW_COLUMNS

DAY_S = 86400.0
DELETED_AT_ONCE = 5000  # rows: a deletion must not hold up the next row for long
KEPT_JOBS = 2000
_INSERT = f"INSERT INTO raw ({', '.join(RAW_COLUMNS)}) VALUES ({', '.join('?' * len(RAW_COLUMNS))})"


@dataclass(frozen=True)
class Retention:
    """How long rows, minutes and hours are kept, days."""

    raw_days: float = 30.0
    minute_days: float = 400.0
    hour_days: float = 4000.0


class Store:
    """The history's one writer. Every method raises sqlite3.Error where the disk is full or gone."""

    def __init__(self, path: Path, retention: Retention) -> None:
        self.path = path
        self._retention = retention
        self._connection, self.damage = opened(path)
        self._rolled: dict[str, int] = {}  # bucket that is open now

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        """Commit rows, {column: value} each; columns that a row lacks are NULL."""
        values = [tuple(_plain(row.get(name)) for name in RAW_COLUMNS) for row in rows]
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            self._connection.executemany(_INSERT, values)
            self._connection.execute("COMMIT")
        except BaseException:
            self._roll_back()
            raise

    def save_job(self, job: dict[str, Any]) -> None:
        """A job as it is now, by its id."""
        self._connection.execute(
            "INSERT INTO job (id, queued_s, document) VALUES (?, ?, ?) "
            "ON CONFLICT (id) DO UPDATE SET document = excluded.document",
            (job["id"], job["queued_s"], json.dumps(job)),
        )

    def save_trip(self, trip: dict[str, Any], number: int | None = None) -> int:
        """A trip with the rows around it, or how it was cleared; returns its number."""
        cursor = self._connection.execute(
            "INSERT INTO trip (id, at_s, document) VALUES (?, ?, ?) "
            "ON CONFLICT (id) DO UPDATE SET document = excluded.document",
            (number, trip["at_s"], json.dumps(trip)),
        )
        return number if number is not None else int(cursor.lastrowid or 0)

    def jobs(self, count: int = 200) -> list[dict[str, Any]]:
        """The last jobs, the oldest first."""
        found = self._connection.execute("SELECT document FROM job ORDER BY queued_s DESC LIMIT ?", (count,))
        return [json.loads(row[0]) for row in found][::-1]

    def last_trip(self) -> tuple[int, dict[str, Any]] | None:
        """The newest trip with its number."""
        row = self._connection.execute("SELECT id, document FROM trip ORDER BY id DESC LIMIT 1").fetchone()
        return (int(row[0]), json.loads(row[1])) if row else None

    def roll_up(self, now_s: float, everything: bool = False) -> None:
        """Bring minutes and hours up to date; buckets are computed anew from raw rows, so that a kill loses none."""
        for table, width_s in BUCKETS_S.items():
            bucket = int(now_s // width_s) * width_s
            if self._rolled.get(table) == bucket and not everything:
                continue
            self._roll(table, width_s)
            self._rolled[table] = bucket

    def _roll(self, table: str, width_s: int) -> None:
        last = self._connection.execute(f"SELECT max(start_s) FROM {table}").fetchone()[0]
        first = self._connection.execute("SELECT min(time_s) FROM raw").fetchone()[0]
        if first is None:
            return
        start = last if last is not None and last >= first else first
        parts = ", ".join(f"avg({q}), min({q}), max({q})" for q in QUANTITIES)
        self._connection.execute(
            f"INSERT OR REPLACE INTO {table} SELECT cast(time_s / {width_s} AS INTEGER) * {width_s} AS start, "
            f"count(*), {parts} FROM raw WHERE time_s >= ? GROUP BY start",
            (int(start // width_s) * width_s,),
        )

    def retain(self, now_s: float) -> int:
        """Delete what is older than it is kept, a part at a time; returns how many rows went."""
        keep = self._retention
        gone = 0
        for table, column, days in (
            ("raw", "time_s", keep.raw_days),
            ("minute", "start_s", keep.minute_days),
            ("hour", "start_s", keep.hour_days),
        ):
            gone += self._connection.execute(
                f"DELETE FROM {table} WHERE rowid IN (SELECT rowid FROM {table} WHERE {column} < ? LIMIT ?)",
                (now_s - days * DAY_S, DELETED_AT_ONCE),
            ).rowcount
        self._connection.execute(
            "DELETE FROM job WHERE id IN (SELECT id FROM job ORDER BY queued_s DESC LIMIT -1 OFFSET ?)", (KEPT_JOBS,)
        )
        return gone

    def limit_size(self, pages: int) -> None:
        """Let the file grow to so many pages of 4 KiB and no further, as a full disk would (for tests)."""
        self._connection.execute(f"PRAGMA max_page_count = {pages}")

    def close(self) -> None:
        """Close the file; never raises."""
        try:
            self._connection.close()
        except sqlite3.Error:
            return

    def _roll_back(self) -> None:
        if self._connection.in_transaction:
            try:
                self._connection.execute("ROLLBACK")
            except sqlite3.Error:
                return


def _plain(value: Any) -> Any:
    """Not-a-number is NULL."""
    if isinstance(value, float) and math.isnan(value):
        return None
    return value
