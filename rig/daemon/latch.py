"""The latch: a trip or a STOP that keeps jobs from starting until somebody resets it with a reason.

It holds in memory at once, and is reported when it is on disk (`LatchStore`). On disk it is a file that no kill, full
disk or power cut turns into "nothing is latched":

    bench.latch    peltier latch 2 SHA-256-OF-THE-REST
                   {"state": "tripped", "cause": "...", "text": "...", "at_s": ...}
                   spaces up to SIZE bytes

The file is created under another name, synced, and renamed when it is whole: its space is allocated from then on. A
change is written in place and synced. One that is cut short leaves a file whose sum is wrong; a file that cannot be
read counts as a trip. At the daemon's start:

| the latch's file  | the history   | then the bench is                |
|-------------------|---------------|----------------------------------|
| is readable       | in any state  | as the file says                 |
| is not readable   | in any state  | tripped                          |
| is missing        | is missing    | a new bench: nothing is latched  |
| is missing        | is there      | tripped                          |

It is on disk before a history is begun, so that no kill leaves a history without it.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rig.core.file_writing import replacing

# rows kept with a trip: at one to ten rows a second those that led to it, and those that followed
ROWS_BEFORE, ROWS_AFTER = 40, 20
CLEAR, STOPPED, TRIPPED = "clear", "stopped", "tripped"
OFF_CONTRADICTED = "off_contradicted"  # trip of a temperature that contradicts a confirmed "off"
UNKNOWN = "what was latched is not known: look at the bench before you reset it"
LATCH = "bench.latch"
SIZE = 4096  # bytes: a page, which the kernel writes whole whenever the process is killed
LONGEST_TEXT = 3000  # bytes of JSON: with its heading and the other fields it stays below the size
HEADING = b"peltier latch 2 "
DIGEST = 64  # characters of a SHA-256
PATIENCE_S = 5.0  # a card or a disk under load syncs within a second or two; `peltier stop` waits 15 s for its answer
TRY_AGAIN_S = 1.0


class Unreadable(Exception):
    """The file is there and does not say what is latched."""


class NotCleared(Exception):
    """The latch stays as it was, for a reason."""


@dataclass(frozen=True)
class Entry:
    """Content of the latch's file. state: CLEAR, STOPPED or TRIPPED; text: why, also why it is clear; at_s: Unix s."""

    state: str
    cause: str
    text: str
    at_s: float


@dataclass
class Latch:
    """state: STOPPED or TRIPPED; at_s: Unix seconds; number: of the trip in the history, None until it is saved."""

    state: str
    cause: str
    text: str
    at_s: float
    rows: list[dict[str, Any]] = field(default_factory=list)
    number: int | None = None
    cleared_s: float | None = None
    cleared_because: str | None = None
    after: int = 0  # rows since

    def table(self) -> dict[str, Any]:
        return {"cause": self.cause, "text": self.text, "at_s": self.at_s, "rows": len(self.rows)}

    def document(self) -> dict[str, Any]:
        more = {"rows": self.rows, "cleared_s": self.cleared_s, "cleared_because": self.cleared_because}
        return {**self.table(), **more, "state": self.state}

    def entry(self) -> Entry:
        """Return the latch as its file keeps it: without the rows."""
        return Entry(self.state, self.cause, self.text, self.at_s)

    def add_row(self, row: dict[str, Any]) -> bool:
        """Add a row after the trip; True for the last one that is kept."""
        if self.after >= ROWS_AFTER:
            return False
        self.rows.append(row)
        self.after += 1
        return self.after == ROWS_AFTER

    def recall(self, number: int, document: dict[str, Any]) -> None:
        """Take the rows of this trip from the history, which has it under a number."""
        self.number, self.rows, self.after = number, list(document.get("rows", [])), ROWS_AFTER


def tripped(cause: str, text: str, at_s: float, recent: deque[dict[str, Any]]) -> Latch:
    """Return a trip with the rows before it."""
    return Latch(TRIPPED, cause, text, at_s, list(recent)[-ROWS_BEFORE:])


def latch_at_start(path: Path, history_was_there: bool, now_s: float) -> Latch | None:
    """Return what is latched when the daemon starts; see the table above. now_s: Unix seconds."""
    try:
        entry = read(path)
    except Unreadable as error:
        return Latch(TRIPPED, "latch", f"the latch could not be read ({error}); {UNKNOWN}", now_s)
    if entry is None and history_was_there:
        return Latch(TRIPPED, "latch", f"the latch's file {path} is missing beside a history; {UNKNOWN}", now_s)
    if entry is None or entry.state == CLEAR:
        return None
    return Latch(entry.state, entry.cause, entry.text, entry.at_s, after=ROWS_AFTER)


class LatchStore:
    """The latch in memory and on disk. held: keeps jobs from starting; reported: the latch that everybody sees, once it
    is on disk. fault: why the file cannot be written; None if it can.

    A thread writes, so that a disk that hangs holds up neither STOP nor the loop: a caller waits PATIENCE_S at most. A
    latch that cannot be written holds all the same; it is tried again every second, and no job starts meanwhile.
    """

    def __init__(self, path: Path, latch: Latch | None, now_s: float) -> None:
        self.path = path
        self.held = self.reported = latch
        self.fault: str | None = None
        self._wanted = latch.entry() if latch is not None else Entry(CLEAR, "start", "nothing was latched", now_s)
        self._asked, self._tried, self._written = 1, 0, 0  # counts of changes
        self._clearing: Latch | None = None
        self._ending = False
        self._changed = threading.Condition()
        threading.Thread(target=self._work, name="latch", daemon=True).start()
        with self._changed:
            self._wait(1)

    @property
    def on_disk(self) -> bool:
        return self._written == self._asked

    def trouble(self) -> str | None:
        """Return why the file is not up to date; None if it is."""
        if self.on_disk:
            return None
        return self.fault or f"{self.path}: the disk has not answered yet"

    def hold(self, latch: Latch) -> bool:
        """Hold a latch in memory, at once; False if a trip is held already. A trip replaces a stop."""
        with self._changed:
            held = self.held
            if held is not None and held is not self._clearing and (held.state == TRIPPED or latch.state != TRIPPED):
                return False
            self.held = latch
            return True

    def save(self) -> None:
        """Save the held latch, then report it; if the disk fails it is reported with the fault."""
        with self._changed:
            latch = self.held
            if latch is None or (self.reported is latch and self.on_disk):
                return
            self._wait(self._ask(latch.entry()))
            if self.held is latch:
                self.reported = latch

    def save_again(self) -> None:
        """Write the file once more: it may have gone, together with the history beside it."""
        with self._changed:
            self._ask(self._wanted)

    def clear(self, reason: str, at_s: float) -> Latch | None:
        """Clear the latch, on disk first, and return it; None if nothing was latched. Raises NotCleared."""
        with self._changed:
            latch = self.held
            if latch is None:
                return None
            self._clearing = latch
            done = self._wait(self._ask(Entry(CLEAR, "reset", reason, at_s)))
            self._clearing = None
            if self.held is None:  # another reset was first
                return None
            if self.held is not latch:
                self._ask(self.held.entry())
                raise NotCleared(f"meanwhile it {self.held.state} again: {self.held.text}")
            if not done:
                fault = self.trouble()
                self._ask(latch.entry())
                raise NotCleared(f"the latch cannot be written: {fault}")
            self.held = self.reported = None
            return latch

    def close(self) -> None:
        """End the thread, after one more try to write."""
        with self._changed:
            self._ending = True
            self._changed.notify_all()
            self._wait(self._asked)

    def _ask(self, entry: Entry) -> int:
        """Ask the thread to write; return the number of this change."""
        self._wanted = entry
        self._asked += 1
        self._changed.notify_all()
        return self._asked

    def _wait(self, number: int) -> bool:
        """Wait for a change, or for its failure; True if it, or a later one, is on disk."""
        self._changed.wait_for(lambda: max(self._tried, self._written) >= number, PATIENCE_S)
        return self._written >= number

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ending or not self.on_disk)
                if self.on_disk:
                    return
                number, wanted = self._asked, self._wanted
            fault = None
            try:
                write(self.path, wanted)
            except OSError as error:
                fault = f"{self.path}: {error.strerror or error}"
            with self._changed:
                self.fault, self._tried = fault, number
                if fault is None:
                    self._written = number
                self._changed.notify_all()
                if fault is None:
                    continue
                if self._ending:
                    return
                self._pause(number)

    def _pause(self, number: int) -> None:
        """Wait until the next trial is due, or for a newer change."""
        self._changed.wait_for(lambda: self._ending or self._asked != number, TRY_AGAIN_S)


# -- the file --------------------------------------------------------------------------------------------------------


def read(path: Path) -> Entry | None:
    """Return the file's entry; None if there is no file. Raises Unreadable."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise Unreadable(f"{path}: {error.strerror or error}") from None
    if len(data) != SIZE:
        raise Unreadable(f"{path} has {len(data)} bytes; expected {SIZE}")
    begin = len(HEADING) + DIGEST
    if data[:begin] != HEADING + _digest(data[begin:]):
        raise Unreadable(f"{path} is damaged: its sum is wrong")
    try:
        document = json.loads(data[begin:])
        state, cause, text = (str(document[key]) for key in ("state", "cause", "text"))
        entry = Entry(state, cause, text, float(document["at_s"]))
    except (ValueError, TypeError, KeyError) as error:
        raise Unreadable(f"{path}: {error!r}") from None
    if state not in (CLEAR, STOPPED, TRIPPED):
        raise Unreadable(f"{path}: state {state!r}")
    return entry


def write(path: Path, entry: Entry) -> None:
    """Write the entry; it is on disk when this returns. Raises OSError: then the old one is, the new, or neither."""
    content = _content(entry)
    if path.is_file() and path.stat().st_size == SIZE:
        _put(path, content, os.O_WRONLY)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        _put(new, content, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the name
    finally:
        os.close(folder)


def _put(path: Path, content: bytes, flags: int) -> None:
    descriptor = os.open(path, flags, 0o644)
    try:
        if hasattr(os, "posix_fallocate"):  # all of the space: a copy of the file may have holes
            os.posix_fallocate(descriptor, 0, SIZE)
        written = os.pwrite(descriptor, content, 0)
        if written != len(content):
            raise OSError(f"only {written} of {len(content)} bytes were written")
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _content(entry: Entry) -> bytes:
    document = asdict(entry)
    while len(json.dumps(document["text"])) > LONGEST_TEXT:
        document["text"] = document["text"][: len(document["text"]) * 9 // 10]
    rest = b"\n" + json.dumps(document).encode() + b"\n"
    rest = rest.ljust(SIZE - len(HEADING) - DIGEST)
    return HEADING + _digest(rest) + rest


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()
