"""Writing the history: rows, jobs and trips, each committed when the call returns; roll-ups and retention.

`aged_s` is the clock by which rows grow old (`rig.history.aging`), in Unix seconds.
"""

from __future__ import annotations

import json
import math
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.core.clock import DAY_S
from rig.core.columns import KEPT
from rig.history.damage import opened
from rig.history.tables import BUCKETS_S, RAW_COLUMNS, ROLLED, VERSION_LATCHED, version
from rig.history.trouble import stat_of

DELETED_AT_ONCE = 5000  # rows: a deletion must not hold up the next row for long
KEPT_JOBS = 2000
AGED = "aged_s"
_INSERT = f"INSERT INTO raw ({', '.join(RAW_COLUMNS)}, written_s) VALUES ({', '.join('?' * (len(RAW_COLUMNS) + 1))})"


@dataclass(frozen=True)
class Retention:
    """How long rows, minutes and hours are kept, days."""

    raw_days: float = 30.0
    minute_days: float = 400.0
    hour_days: float = 4000.0


class Store:
    """The history's one writer. Every method raises sqlite3.Error where the disk is full or gone.

    damage: what was wrong with the file that was there, None where it was whole; has_latch: whether the latch has had a
    file of its own since this history was begun, or was last written by a program that knew of it.
    """

    def __init__(self, path: Path, retention: Retention) -> None:
        self.path = path
        self._retention = retention
        self._connection, self.damage = opened(path)
        self._files = self._stats()
        self.has_latch = version(self._connection) >= VERSION_LATCHED
        self._rolled: dict[str, int] = {}  # bucket that is open now

    def in_place(self) -> bool:
        """Whether its file and its log still are those of their names: one that was moved or deleted takes rows without
        a word."""
        pairs = zip(self._files, self._stats(), strict=True)
        return all(was is None or (now is not None and os.path.samestat(was, now)) for was, now in pairs)

    def _stats(self) -> list[os.stat_result | None]:
        return [stat_of(Path(f"{self.path}{ending}")) for ending in ("", "-wal")]

    def log_bytes(self) -> int:
        """The size of its log; 0 where it has none."""
        log = self._stats()[1]
        return log.st_size if log is not None else 0

    def add(self, rows: Iterable[dict[str, Any]], aged_s: float | None = None) -> None:
        """Commit rows, {column: value} each; columns that a row lacks are NULL."""
        values = [(*(_plain(row.get(name)) for name in RAW_COLUMNS), aged_s) for row in rows]
        with self._transaction():
            self._connection.executemany(_INSERT, values)

    def mark_latch(self) -> None:
        """The latch has a file of its own from now on."""
        self._connection.execute(f"PRAGMA user_version = {VERSION_LATCHED}")
        self.has_latch = True

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
        found = self._connection.execute("SELECT document FROM job ORDER BY rowid DESC LIMIT ?", (count,))
        return [json.loads(row[0]) for row in found][::-1]

    def last_trip(self) -> tuple[int, dict[str, Any]] | None:
        """The newest trip with its number."""
        row = self._connection.execute("SELECT id, document FROM trip ORDER BY id DESC LIMIT 1").fetchone()
        return (int(row[0]), json.loads(row[1])) if row else None

    def last_label_s(self) -> float | None:
        """The label of the row that was written last, by whatever clock; None where there is none."""
        row = self._connection.execute("SELECT time_s FROM raw ORDER BY id DESC LIMIT 1").fetchone()
        return float(row[0]) if row else None

    def aged_s(self) -> float | None:
        """The aged clock when it was last kept; None in a history that has none yet."""
        return self._number(AGED)

    def roll_up(self, now_s: float, everything: bool = False, aged_s: float | None = None) -> None:
        """Bring minutes and hours up to date; buckets are computed anew from raw rows, so that a kill loses none."""
        for table, width_s in BUCKETS_S.items():
            bucket = int(now_s // width_s) * width_s
            if self._rolled.get(table) == bucket and not everything:
                continue
            with self._transaction():
                self._roll(table, width_s, aged_s)
            self._rolled[table] = bucket

    def _roll(self, table: str, width_s: int, aged_s: float | None) -> None:
        """Every bucket that got a row since the last time, wherever a clock that jumped has put it.

        A bucket from which retention may have taken rows stays as it is: computed anew it would lose them.
        """
        last = self._connection.execute("SELECT max(id) FROM raw").fetchone()[0]
        if last is None:
            return
        done = self._rolled_up_to(table)
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

    def _rolled_up_to(self, table: str) -> int:
        """The id of the last row that is in this roll-up."""
        known = self._number(f"rolled_{table}")
        if known is not None:
            return int(known)
        first = self._connection.execute(  # of an older program, which went by the labels
            f"SELECT min(id) FROM raw WHERE time_s >= (SELECT coalesce(max(start_s), -1e300) FROM {table})"
        ).fetchone()[0]
        return int(first) - 1 if first is not None else 0

    def retain(self, now_s: float, aged_s: float | None = None) -> int:
        """Delete what is older than it is kept, a part at a time; returns how many rows went.

        Older by its label and by when it was written, at the earlier of the two clocks: the time of day, now_s, and the
        aged one.
        """
        keep = self._retention
        earlier_s = now_s if aged_s is None else min(now_s, aged_s)
        gone = 0
        with self._transaction():
            for table, column, days in (
                ("raw", "time_s", keep.raw_days),
                ("minute", "start_s", keep.minute_days),
                ("hour", "start_s", keep.hour_days),
            ):
                gone += self._connection.execute(
                    f"DELETE FROM {table} WHERE rowid IN (SELECT rowid FROM {table} "
                    f"WHERE {column} < :from AND coalesce(written_s, {column}) < :from LIMIT :most)",
                    {"from": earlier_s - days * DAY_S, "most": DELETED_AT_ONCE},
                ).rowcount
            self._connection.execute(
                "DELETE FROM job WHERE id IN (SELECT id FROM job ORDER BY rowid DESC LIMIT -1 OFFSET ?)", (KEPT_JOBS,)
            )
            if aged_s is not None:
                self._keep_number(AGED, aged_s)
        return gone

    def limit_size(self, pages: int) -> None:
        """Let the file grow to so many pages of 4 KiB and no further, as a full disk would (for tests)."""
        self._connection.execute(f"PRAGMA max_page_count = {pages}")

    def close(self) -> None:
        """Close the file; never raises. Its log is emptied before: SQLite leaves that of a file that was moved where it
        is, with rows in it that are nowhere else."""
        with suppress(sqlite3.Error):
            self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        with suppress(sqlite3.Error):
            self._connection.close()

    def _number(self, name: str) -> float | None:
        row = self._connection.execute("SELECT value FROM kept WHERE name = ?", (name,)).fetchone()
        return float(row[0]) if row else None

    def _keep_number(self, name: str, value: float) -> None:
        self._connection.execute("INSERT OR REPLACE INTO kept (name, value) VALUES (?, ?)", (name, value))

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All of it, or nothing where it fails."""
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            self._roll_back()
            raise

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
