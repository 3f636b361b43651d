"""The latch in memory and on disk: it holds the queue at once, and is told when it is on disk.

A thread writes, so that a disk that hangs holds up neither STOP nor the loop: whoever waits for it waits PATIENCE_S at
most. A latch that cannot be written holds all the same; it is tried again every second, and no job starts meanwhile.
"""

from __future__ import annotations

import threading
from pathlib import Path

from rig.daemon.latch import CLEAR, TRIPPED, Kept, Latch
from rig.daemon.latch_file import write

PATIENCE_S = 5.0  # a card or a disk under load syncs within a second or two; `peltier stop` waits 15 s for its answer
TRY_AGAIN_S = 1.0


class NotCleared(Exception):
    """The latch stays as it was: why."""


class Latching:
    """What is latched. held: what keeps jobs from starting; told: what everybody sees, after it is on disk.

    path: the latch's file; first: what is to be in it now, and the latch that this means. fault: why the file cannot be
    written, None where it says what it should.
    """

    def __init__(self, path: Path, first: Kept, latch: Latch | None) -> None:
        self.path = path
        self.held = self.told = latch
        self.fault: str | None = None
        self._wanted = first
        self._asked, self._tried, self._written = 1, 0, 0  # counts of changes
        self._clearing: Latch | None = None
        self._ending = False
        self._changed = threading.Condition()
        threading.Thread(target=self._work, name="latch", daemon=True).start()
        with self._changed:
            self._wait(1)

    @property
    def on_disk(self) -> bool:
        """Whether the file says what is latched."""
        return self._written == self._asked

    def trouble(self) -> str | None:
        """Why the file does not say what is latched; None where it does."""
        if self.on_disk:
            return None
        return self.fault or f"{self.path}: the disk has not answered yet"

    def hold(self, latch: Latch) -> bool:
        """In memory, at once; False where a trip is held already. A trip takes the place of a stop."""
        with self._changed:
            held = self.held
            if held is not None and held is not self._clearing and (held.state == TRIPPED or latch.state != TRIPPED):
                return False
            self.held = latch
            return True

    def keep(self) -> None:
        """What is held goes to disk, and is then told; where the disk fails it is told with the fault."""
        with self._changed:
            latch = self.held
            if latch is None or (self.told is latch and self.on_disk):
                return
            self._wait(self._ask(latch.kept()))
            if self.held is latch:
                self.told = latch

    def keep_again(self) -> None:
        """What the file should say is written once more: it may have gone, together with what lay beside it."""
        with self._changed:
            self._ask(self._wanted)

    def clear(self, reason: str, at_s: float) -> Latch | None:
        """What was latched no longer is, on disk first; None where nothing was. Raises NotCleared."""
        with self._changed:
            latch = self.held
            if latch is None:
                return None
            self._clearing = latch
            done = self._wait(self._ask(Kept(CLEAR, "reset", reason, at_s)))
            self._clearing = None
            if self.held is None:  # somebody else's reset
                return None
            if self.held is not latch:
                self._ask(self.held.kept())
                raise NotCleared(f"meanwhile it {self.held.state} again: {self.held.text}")
            if not done:
                fault = self.trouble()
                self._ask(latch.kept())
                raise NotCleared(f"the latch cannot be written: {fault}")
            self.held = self.told = None
            return latch

    def close(self) -> None:
        """End the thread; what is wanted and not on disk is tried once more."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
            self._wait(self._asked)

    def _ask(self, kept: Kept) -> int:
        """What the file should say; returns the number of this change."""
        self._wanted = kept
        self._asked += 1
        self._changed.notify_all()
        return self._asked

    def _wait(self, number: int) -> bool:
        """Wait for a change, or for its failure; whether it, or a later one, is on disk."""
        self._changed.wait_for(lambda: max(self._tried, self._written) >= number, PATIENCE_S)
        return self._written >= number

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(self._to_do)
                if self.on_disk:
                    return
                number, wanted = self._asked, self._wanted
            fault = _fault_of_writing(self.path, wanted)
            with self._changed:
                self.fault, self._tried = fault, number
                if fault is None:
                    self._written = number
                self._changed.notify_all()
                if fault is not None and not self._pause_unless_changed(number):
                    return

    def _to_do(self) -> bool:
        return self._ending or not self.on_disk

    def _pause_unless_changed(self, number: int) -> bool:
        """Wait until the next trial is due; False where there is to be none."""
        if self._ending:
            return False
        self._changed.wait_for(lambda: self._ending or self._asked != number, TRY_AGAIN_S)
        return True


def _fault_of_writing(path: Path, kept: Kept) -> str | None:
    """Write it; what stood in the way, or None."""
    try:
        write(path, kept)
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    return None
