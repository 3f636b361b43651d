"""A thread that commits rows before it publishes them, so that no disk holds up the control loop.

Rows and other work wait in memory, in order, until they are in the file, whatever the trouble: another program's lock,
a full disk, a disk that hangs, a file that was moved or damaged. The thread tries again every second. Rows that have to
wait are published at once, as not recorded yet. Only trouble that does not pass by itself calls `on_failure`, at once
and in this thread: the output goes off first.

Rows are labelled with the time of day, which a person, a time server or a flat battery may set. Deleted rows are lost,
so rows grow old by the time for which the daemon has run since, on a monotonic clock that the history keeps over
restarts: a clock that jumps, or is wrong for days, deletes nothing.
"""

from __future__ import annotations

import itertools
import math
import sqlite3
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.history.store import Store, Trouble, trouble_of, who_reads

JUMP_S = 5.0  # between two rows: more than a time server's slewing or a busy computer causes
TRY_AGAIN_S = 1.0  # a lock is not released, and a full disk not emptied, faster
PART_OF_TIME = 10.0  # rest after a try that takes long, such as the check of a large file, over its length
MOST_WAITING = 36_000  # rows, an hour at ten a second: some 40 MB
ROOM_S = 1.0  # for room in memory before a row is dropped: simulated rows come faster than disks write
AT_ONCE = 200  # rows in a transaction
UNREPORTED_S = 3.0  # a shorter lock, such as a backup's, is not reported
SLOW_S = 5.0  # a card or a disk under load answers within a second or two
LEAVE_S = 5.0  # at the end, for the rows that wait
RETAIN_EVERY_S = 60.0
MUCH_LOG_BYTES = 64 << 20  # of -wal, which restarts at 4 MB unless somebody reads without a pause
GATHER_S = 10.0  # of rows a transaction while the log only grows: each takes whole pages in it


@dataclass(slots=True)
class _Row:
    """A row with its monotonic time, its time of arrival (time.monotonic), and True if it was published."""

    row: dict[str, Any]
    clock_s: float
    came_s: float
    shown: bool = False


Work = Callable[[Store], object]


class Writer:
    """Owns a store, from `open` on. trouble: the present trouble; None if all is well.

    Parameters
    ----------
    opened
        Opens the store.
    publish
        Gets each row, after it was committed or has to wait.
    on_failure
        Gets the fault, once a failure.
    on_jump
        Gets the seconds by which the time of day jumped between two rows.
    after_rows
        Writes what belongs to committed rows.
    report
        Gets a line for people, and True if it is to stay among the warnings.
    """

    def __init__(
        self,
        path: Path,
        opened: Callable[[], Store],
        publish: Callable[[dict[str, Any]], None],
        on_failure: Callable[[str], None],
        on_jump: Callable[[float], None] = lambda seconds: None,
        after_rows: Work = lambda store: None,
        report: Callable[[str, bool], None] = lambda line, stays: None,
    ) -> None:
        self.path = path
        self.store: Store | None = None
        self.trouble: Trouble | None = None
        self.committed = 0
        self.dropped = 0  # rows without room in memory
        self._lost: tuple[int, float, float] | None = None  # their number, and the labels of the first and the last
        self._opened, self._publish, self._on_failure, self._on_jump = opened, publish, on_failure, on_jump
        self._after_rows, self._report = after_rows, report
        self._changed = threading.Condition()
        self._waiting: deque[_Row | Work] = deque()
        self._rows = 0  # among them
        self._full = False
        self._ends_s: float | None = None  # time.monotonic
        self._thread = threading.Thread(target=self._work, name="history", daemon=True)
        self._rests_until_s = self._troubled_s = -math.inf  # time.monotonic
        self._reported = False
        self._aged_s: float | None = None  # clock by which rows grow old; None in a new history before its first row
        self._last: tuple[float, float] | None = None  # label and monotonic time of the last row
        self._last_label_s: float | None = None  # of the last row before this start
        self._tidied_s = -math.inf
        self._log_bytes = 0

    # -- for any thread ------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Open the store; if that fails, set `trouble`, and try again from `start` on."""
        try:
            self._there()
        except (sqlite3.Error, OSError) as error:
            self.trouble, self._troubled_s = trouble_of(error, self.path), time.monotonic()
            self.do(_no_work)  # so that it is tried again

    def start(self) -> None:
        self._thread.start()

    def row(self, row: dict[str, Any], clock_s: float) -> None:
        """Commit and publish a row, in order. clock_s: its monotonic time."""
        with self._changed:
            if self._rows >= MOST_WAITING:  # waits once, not for each row: the caller may be a control loop
                patience_s = 0.0 if self._full or self.trouble is not None else ROOM_S
                self._full = not self._changed.wait_for(lambda: self._rows < MOST_WAITING, patience_s)
                if self._full:
                    lost, first_s, _ = self._lost or (0, row["time_s"], 0.0)
                    self._lost = lost + 1, first_s, row["time_s"]
                    self.dropped += 1
                    return
            self._waiting.append(_Row(row, clock_s, time.monotonic()))
            self._rows += 1
            self._changed.notify_all()

    def do(self, work: Work) -> None:
        with self._changed:
            self._waiting.append(work)
            self._changed.notify_all()

    def settle(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything so far is committed; False if that takes longer."""
        done = threading.Event()
        self.do(lambda store: done.set())
        return done.wait(timeout_s)

    def stop(self) -> str | None:
        """Commit, roll up, close; return the rows that could not be written, in words, or None."""
        with self._changed:
            self._ends_s = time.monotonic() + LEAVE_S
            self._changed.notify_all()
        self._thread.join(2.0 * LEAVE_S)
        with self._changed:
            labels = [item.row["time_s"] for item in self._waiting if isinstance(item, _Row)]
        if not labels and self._lost is None:
            return None
        lost, first_s, last_s = self._lost or (0, labels[0], labels[-1])
        why = f" ({self.trouble.text})" if self.trouble is not None else ""
        return self._lack(lost + len(labels), min([first_s, *labels]), max([last_s, *labels])) + why

    @property
    def failure(self) -> str | None:
        """Reason why no job should begin: rows can neither be written nor wait in memory; None if they can."""
        if self._full:
            return f"{self._rows} rows wait, and there is no room for more: {self.delay()}"
        return self.trouble.text if self.trouble is not None and not self.trouble.passes else None

    def delay(self) -> str | None:
        """Return why rows wait, and how many; None if none do, or not yet for UNREPORTED_S."""
        trouble, now_s = self.trouble, time.monotonic()
        with self._changed:
            first = next((item for item in self._waiting if isinstance(item, _Row)), None)
            rows = self._rows
        waits = f"{rows} rows wait in memory, and are written when that is over" + (
            f"; {self.dropped} found no room there" if self.dropped else ""
        )
        if trouble is not None:
            short = trouble.passes and now_s - self._troubled_s < UNREPORTED_S
            return None if short else f"{trouble.text}: {waits}"
        if self._log_bytes > MUCH_LOG_BYTES:
            who = who_reads(self.path) or "another program"
            size = f"{self._log_bytes / 1e6:.0f} MB"
            return f"{self.path}-wal has grown to {size}, as {who} reads the history without a pause; close it there"
        slow_s = now_s - first.came_s if first is not None and now_s >= self._rests_until_s else 0.0
        return f"{self.path}: the disk has not answered for {slow_s:.0f} s: {waits}" if slow_s > SLOW_S else None

    # -- the thread ----------------------------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            with self._changed:
                rests_s = self._rests_until_s - time.monotonic()
                self._changed.wait_for(self._something_to_do, rests_s if rests_s > 0.0 else None)
                ends_s, new, head = self._ends_s, self._unpublished(), self._head()
            if ends_s is None and time.monotonic() < self._rests_until_s:
                self._follow(new)
                self._show(new)
            elif not self._try(head) and ends_s is not None:
                time.sleep(LEAVE_S / 20.0)
            if ends_s is not None and (not self._waiting or time.monotonic() > ends_s):
                if self.store is not None:
                    self._done(lambda store: store.roll_up(0.0, everything=True, aged_s=self._aged_s))
                    self._close()  # unless the roll-up found it gone
                return

    def _something_to_do(self) -> bool:
        rests = time.monotonic() < self._rests_until_s
        return self._ends_s is not None or bool(self._unpublished() if rests else self._waiting)

    def _unpublished(self) -> list[_Row]:
        """Return the last rows, which were not published yet, in order."""
        rows = (item for item in reversed(self._waiting) if isinstance(item, _Row))
        return list(itertools.takewhile(lambda row: not row.shown, rows))[::-1]

    def _head(self) -> list[_Row] | Work:
        if self._waiting and not isinstance(self._waiting[0], _Row):
            return self._waiting[0]
        first = itertools.islice(self._waiting, AT_ONCE)
        return list(itertools.takewhile(lambda item: isinstance(item, _Row), first))  # type: ignore[arg-type]

    def _try(self, head: list[_Row] | Work) -> bool:
        """Write what waits first; True if it is in the file now."""
        if not isinstance(head, list):
            done = self._done(head)
            if done:
                self._take_out(1)
            return done
        new = [row for row in head if not row.shown]
        self._follow(new)
        done = not head or self._done(lambda store: store.add((row.row for row in head), self._aged_s))
        if done:
            self._take_out(len(head))
        self._show(new)
        if done and head and self._done(self._after_rows):
            self._tidy(head[-1])
        return done

    def _take_out(self, items: int) -> None:
        with self._changed:
            for _ in range(items):
                if isinstance(self._waiting.popleft(), _Row):
                    self._rows -= 1
                    self.committed += 1
                    self._full = False
            self._changed.notify_all()

    def _show(self, rows: list[_Row]) -> None:
        for row in rows:
            row.shown = True
            self._publish(row.row)

    def _follow(self, rows: list[_Row]) -> None:
        """Advance the aging clock; report jumps of the time of day."""
        for row in rows:
            label_s, passed_s = float(row.row["time_s"]), 0.0
            if self._last is not None:
                passed_s = row.clock_s - self._last[1]
                jumped_s = label_s - self._last[0] - passed_s
            else:  # forward is no jump: the daemon was not running
                jumped_s = min(label_s - self._last_label_s, 0.0) if self._last_label_s is not None else 0.0
            self._last = label_s, row.clock_s
            self._aged_s = (label_s if self._aged_s is None else self._aged_s) + max(passed_s, 0.0)
            if abs(jumped_s) > JUMP_S:
                self._on_jump(jumped_s)

    def _tidy(self, last: _Row) -> None:
        """Roll up, delete old rows from time to time, and check the size of the log."""
        now_s, aged_s = float(last.row["time_s"]), self._aged_s
        rolled = self._done(lambda store: store.roll_up(now_s, aged_s=aged_s))
        if rolled and aged_s is not None and abs(last.clock_s - self._tidied_s) >= RETAIN_EVERY_S:
            self._tidied_s = last.clock_s
            self._done(lambda store: store.retain(aged_s))
            self._log_bytes = MUCH_LOG_BYTES + 1  # so that its size is read
        if self._log_bytes > MUCH_LOG_BYTES:
            self._log_bytes = self.store.log_bytes() if self.store is not None else 0
        if self._log_bytes > MUCH_LOG_BYTES and self.trouble is None:
            self._rests_until_s = time.monotonic() + GATHER_S

    def _done(self, work: Work) -> bool:
        """Do work on the store; False, after a report, if there is trouble."""
        begin_s = time.monotonic()
        try:
            work(self._there())
        except (sqlite3.Error, OSError) as error:
            self._on_trouble(trouble_of(error, self.path), time.monotonic() - begin_s)
            return False
        if self.trouble is not None or (self._lost is not None and self._rows < MOST_WAITING // 2):
            self._trouble_over()
        return True

    def _there(self) -> Store:
        """Return the store, open. Raises OSError if its file has gone; the next try begins a new one."""
        if self.store is not None and not self.store.in_place():
            self._close()
            raise OSError("was moved or deleted; a new one is begun")
        if self.store is None:
            store = self._opened()
            try:
                self._last_label_s = store.last_label_s()
                aged_s = store.aged_s() or self._last_label_s
                self._aged_s = self._aged_s if aged_s is None else aged_s
            except BaseException:
                store.close()
                raise
            self.store = store
        return self.store

    def _close(self) -> None:
        if self.store is not None:
            self.store.close()
        self.store = None

    def _on_trouble(self, trouble: Trouble, took_s: float) -> None:
        """Rest until the next try, and report."""
        now_s, before = time.monotonic(), self.trouble
        self.trouble = trouble
        self._rests_until_s = now_s + (TRY_AGAIN_S if trouble.passes else max(TRY_AGAIN_S, PART_OF_TIME * took_s))
        if before is None:
            self._troubled_s = now_s
        if trouble.anew:
            self._close()
        if not self._waiting:
            self.do(_no_work)  # so that it is tried again
        if not trouble.passes and (before is None or before.passes):
            self._reported = True
            self._on_failure(trouble.text)
        elif not self._reported and (text := self.delay()):
            self._reported = True
            self._report(f"the history has to wait: {text}", False)

    def _trouble_over(self) -> None:
        self.trouble, self._rests_until_s = None, -math.inf
        if self._reported:
            self._report(f"the history is written again; {self._rows} rows had waited for that", False)
        self._reported = False
        with self._changed:
            lost, self._lost = self._lost, None
        if lost is not None:
            self._report(self._lack(*lost), True)

    def _lack(self, rows: int, first_s: float, last_s: float) -> str:
        at = [time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(time_s)) for time_s in (first_s, last_s)]
        return f"the history lacks {rows} rows, {at[0]} to {at[1]}; those of a run are in its record.csv"


def _no_work(store: Store) -> None:
    """Do nothing: the store is opened for it."""
