"""A thread that commits rows and only then tells of them, so that no disk holds up the control loop.

A row is published after its commit. Where a commit fails, nothing of it is published, and `on_failure` is called at
once, in this thread: the output goes off first. Rows that come while the disk is full are dropped and counted; a try a
second finds out when there is room again.
"""

from __future__ import annotations

import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rig.history.store import Store

TRY_AGAIN_S = 1.0
WAITING = 5000  # rows; beyond, who brings them waits
RETAIN_EVERY_S = 60.0


class Writer:
    """Owns a store. publish: called with each committed row; on_failure: with what went wrong, once a failure."""

    def __init__(
        self,
        store: Store,
        publish: Callable[[dict[str, Any]], None],
        on_failure: Callable[[str], None],
    ) -> None:
        self.store = store
        self.failure: str | None = None
        self.committed = 0
        self.dropped = 0
        self._publish, self._on_failure = publish, on_failure
        self._queue: queue.Queue[dict[str, Any] | Callable[[Store], object] | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._work, name="history", daemon=True)
        self._failed_at_s = 0.0
        self._retained_s = -RETAIN_EVERY_S

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def row(self, row: dict[str, Any]) -> None:
        """A row to commit and publish, in order."""
        self._queue.put(row)

    def do(self, work: Callable[[Store], object]) -> None:
        """Something else to write, in order with the rows."""
        self._queue.put(work)

    def settle(self, timeout_s: float = 10.0) -> bool:
        """Wait until what was given so far is committed or dropped; False where that takes longer."""
        done = threading.Event()
        self._queue.put(lambda _: done.set())
        return done.wait(timeout_s)

    def stop(self) -> None:
        """Commit what is there, roll up, close."""
        self._queue.put(None)
        self._thread.join(10.0)

    def _work(self) -> None:
        while True:
            rows: list[dict[str, Any]] = []
            item = self._queue.get()
            while isinstance(item, dict):
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
                self._guarded(lambda: self.store.roll_up(0.0, everything=True))
                self.store.close()
                return
            if callable(item):
                self._guarded(partial(item, self.store))

    def _commit(self, rows: list[dict[str, Any]]) -> None:
        if self.failure is not None and time.monotonic() - self._failed_at_s < TRY_AGAIN_S:
            self.dropped += len(rows)
            return
        if not self._guarded(lambda: self.store.add(rows)):
            self.dropped += len(rows)
            return
        self.failure = None
        self.committed += len(rows)
        for row in rows:
            self._publish(row)
        now_s = float(rows[-1]["time_s"])
        if self._guarded(lambda: self.store.roll_up(now_s)) and abs(now_s - self._retained_s) >= RETAIN_EVERY_S:
            self._retained_s = now_s
            self._guarded(lambda: self.store.retain(now_s))

    def _guarded(self, work: Callable[[], object]) -> bool:
        """Do it; False where it failed, after the failure was told."""
        try:
            work()
        except (sqlite3.Error, OSError) as error:
            first = self.failure is None
            self.failure = f"{self.store.path}: {error}"
            self._failed_at_s = time.monotonic()
            if first:
                self._on_failure(self.failure)
            return False
        return True


def _nothing(store: Store) -> None:
    """There is nothing else to do."""
