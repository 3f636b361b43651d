"""A thread that commits rows and only then tells of them, so that no disk holds up the control loop.

A row is published after its commit. Where a commit fails, nothing of it is published, and `on_failure` is called at
once, in this thread: the output goes off first. Rows that come while the disk is full are dropped and counted; a try a
second finds out when there is room again. A history that cannot even be opened, or was moved or deleted, is a failure
of the same kind.
"""

from __future__ import annotations

import math
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rig.history.aging import AgedClock
from rig.history.store import Store

TRY_AGAIN_S = 1.0  # a full disk is not emptied faster
PART_OF_TIME = 10.0  # a try that takes long, as the check of a large file does, comes that many times its length later
WAITING = 5000  # rows; beyond, who brings them waits
RETAIN_EVERY_S = 60.0
Row = tuple[dict[str, Any], float]  # and when it was made, by a clock that does not jump


class Writer:
    """Owns a store, from `open` on. failure: why nothing is recorded, None where all is well.

    opened: opens the store; publish: called with each committed row; on_failure: with what went wrong, once a failure;
    on_jump: with the seconds by which the time of day jumped between two rows.
    """

    def __init__(
        self,
        path: Path,
        opened: Callable[[], Store],
        publish: Callable[[dict[str, Any]], None],
        on_failure: Callable[[str], None],
        on_jump: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        self.path = path
        self.store: Store | None = None
        self.failure: str | None = None
        self.committed = 0
        self.dropped = 0
        self._opened, self._publish, self._on_failure, self._on_jump = opened, publish, on_failure, on_jump
        self._queue: queue.Queue[Row | Callable[[Store], object] | threading.Event | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._work, name="history", daemon=True)
        self._try_at_s = -math.inf
        self._aged = AgedClock()
        self._retained_s = -math.inf

    def open(self) -> None:
        """Open the store; where that fails `failure` says why, and it is tried again with the rows that come."""
        try:
            self._open()
        except (sqlite3.Error, OSError) as error:
            self.failure = f"{self.path}: {error}"

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def row(self, row: dict[str, Any], clock_s: float) -> None:
        """A row to commit and publish, in order. clock_s: when it was made, by a clock that does not jump."""
        self._queue.put((row, clock_s))

    def do(self, work: Callable[[Store], object]) -> None:
        """Something else to write, in order with the rows; nothing is done where the store is not open."""
        self._queue.put(work)

    def settle(self, timeout_s: float = 10.0) -> bool:
        """Wait until what was given so far is committed or dropped; False where that takes longer."""
        done = threading.Event()
        self._queue.put(done)
        return done.wait(timeout_s)

    def stop(self) -> None:
        """Commit what is there, roll up, close."""
        self._queue.put(None)
        self._thread.join(10.0)

    def _work(self) -> None:
        while True:
            rows: list[Row] = []
            item = self._queue.get()
            while isinstance(item, tuple):
                rows.append(item)
                if len(rows) >= 200:
                    item = _nothing
                    break
                try:
                    item = self._queue.get_nowait()
                except queue.Empty:
                    item = _nothing
            if rows:
                self._commit(rows)
            if item is None:
                self._close()
                return
            if isinstance(item, threading.Event):
                item.set()
            elif self.store is not None:
                self._guarded(partial(item, self.store))

    def _commit(self, rows: list[Row]) -> None:
        self._follow(rows)
        if (self.failure is not None and time.monotonic() < self._try_at_s) or not self._written(rows):
            self.dropped += len(rows)
            return
        self.failure = None
        self.committed += len(rows)
        for row, _ in rows:
            self._publish(row)
        self._tidy(*rows[-1])

    def _follow(self, rows: list[Row]) -> None:
        """Let the aged clock follow; where the time of day jumped before one of the rows, that is told."""
        for row, clock_s in rows:
            if jumped_s := self._aged.row(float(row["time_s"]), clock_s):
                self._on_jump(jumped_s)

    def _written(self, rows: list[Row]) -> bool:
        """Whether they are committed now."""
        if self.store is not None and not self._guarded(self._look):
            return False
        if self.store is None and not self._guarded(self._open):
            return False
        store = self._there()
        return self._guarded(lambda: store.add((row for row, _ in rows), self._aged.aged_s()))

    def _tidy(self, row: dict[str, Any], clock_s: float) -> None:
        """Roll up, and now and then delete what is old."""
        store, now_s, aged_s = self._there(), float(row["time_s"]), self._aged.aged_s()
        rolled = self._guarded(lambda: store.roll_up(now_s, aged_s=aged_s))
        if rolled and abs(clock_s - self._retained_s) >= RETAIN_EVERY_S:
            self._retained_s = clock_s
            self._guarded(lambda: store.retain(now_s, aged_s))

    def _open(self) -> None:
        store = self._opened()
        try:
            self._aged.begin(store.aged_s(), store.last_label_s())
        except BaseException:
            store.close()
            raise
        self.store = store

    def _look(self) -> None:
        """Raises OSError where the file has gone from its place; the next try begins a new one there."""
        store = self._there()
        if not store.in_place():
            store.close()
            self.store = None
            raise OSError("was moved or deleted, and is begun anew")

    def _there(self) -> Store:
        assert self.store is not None
        return self.store

    def _close(self) -> None:
        store = self.store
        if store is not None:
            self._guarded(lambda: store.roll_up(0.0, everything=True, aged_s=self._aged.aged_s()))
            store.close()

    def _guarded(self, work: Callable[[], object]) -> bool:
        """Do it; False where it failed, after the failure was told."""
        begin_s = time.monotonic()
        try:
            work()
        except (sqlite3.Error, OSError) as error:
            first = self.failure is None
            self.failure = f"{self.path}: {error}"
            end_s = time.monotonic()
            self._try_at_s = end_s + max(TRY_AGAIN_S, PART_OF_TIME * (end_s - begin_s))
            if first:
                self._on_failure(self.failure)
            return False
        return True


def _nothing(store: Store) -> None:
    """There is nothing else to do."""
