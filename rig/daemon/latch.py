"""The latch: a trip or a STOP that keeps jobs from starting until somebody resets it with a reason.

It holds in memory at once, and is reported when it is on disk (`LatchStore`). On disk it is a file that no kill, full
disk or power cut turns into "nothing is latched":

    bench.latch    slot 0, slot 1, each of SLOT bytes
    slot           peltier latch 1 SHA-256-OF-THE-REST
                   {"sequence": 7, "state": "tripped", "cause": "...", "text": "...", "at_s": ...}
                   spaces up to the slot's end

The file is created under another name, both slots written and synced, and renamed when it is whole: its space is
allocated from then on. A change goes into the slot with the smaller sequence number, in place, and is synced. If that
is cut short the other slot is whole, but it may say "clear" while the one that was cut short was to say "tripped": so a
slot that cannot be read makes the whole latch unreadable, which counts as a trip. At the daemon's start:

| the latch's file  | the history   | then the bench is                |
|-------------------|---------------|----------------------------------|
| is readable       | in any state  | as the file says                 |
| is not readable   | in any state  | tripped                          |
| is missing        | is missing    | a new bench: nothing is latched  |
| is missing        | is there      | tripped                          |

It is on disk before a history is begun, so that no kill leaves a history without it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import threading
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

# rows kept with a trip: at one to ten rows a second those that led to it, and those that followed
ROWS_BEFORE, ROWS_AFTER = 40, 20
CLEAR, STOPPED, TRIPPED = "clear", "stopped", "tripped"
OFF_CONTRADICTED = "off_contradicted"  # trip of a temperature that contradicts a confirmed "off"
UNKNOWN = "what was latched is not known: look at the bench before you reset it"
LATCH = "bench.latch"
SLOT = 4096  # bytes: a page, which the kernel writes whole whenever the process is killed; and no sector of both slots
SLOTS = 2
LONGEST_TEXT = 3000  # bytes of JSON: with its heading and the other fields it stays below a slot
HEADING = b"peltier latch 1 "
DIGEST = 64  # characters of a SHA-256
PATIENCE_S = 5.0  # a card or a disk under load syncs within a second or two; `peltier stop` waits 15 s for its answer
TRY_AGAIN_S = 1.0


class Unreadable(Exception):
    """The file is there and does not say what is latched. readable: the entry of its other slot, if that is whole."""

    def __init__(self, why: str, readable: Entry | None = None) -> None:
        self.readable = readable
        super().__init__(why)


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
        other = f"; its other slot says: {error.readable.state}, {error.readable.text}" if error.readable else ""
        return Latch(TRIPPED, "latch", f"the latch could not be read ({error}{other}); {UNKNOWN}", now_s)
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
    if len(data) != SLOTS * SLOT:
        raise Unreadable(f"{path} has {len(data)} bytes; expected {SLOTS * SLOT}")
    known = sorted((slot for slot in _parsed_slots(data) if slot is not None), key=lambda slot: slot[0])
    if len(known) < SLOTS:
        raise Unreadable(f"{path}: {SLOTS - len(known)} of its {SLOTS} slots damaged", known[-1][1] if known else None)
    if known[1][0] != known[0][0] + 1:
        raise Unreadable(f"{path}: slots {known[0][0]} and {known[1][0]} do not follow one another", known[1][1])
    return known[1][1]


def write(path: Path, entry: Entry) -> None:
    """Write the entry; it is on disk when this returns. Raises OSError: then the old one is, the new, or neither."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        data = b""
    if len(data) != SLOTS * SLOT:
        _create(path, entry)
        return
    slots = _parsed_slots(data)
    sequences = [slot[0] if slot is not None else 0 for slot in slots]
    damaged = [k for k, slot in enumerate(slots) if slot is None]
    descriptor = os.open(path, os.O_WRONLY)
    try:
        _allocate(descriptor)
        for number, k in enumerate(damaged or [sequences.index(min(sequences))], start=max(sequences) + 1):
            _put(descriptor, k, _slot(number, entry))
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _create(path: Path, entry: Entry) -> None:
    """Create the file, under its name only when it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f"{path.name}.new")
    try:
        descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        try:
            _allocate(descriptor)
            for k in range(SLOTS):
                _put(descriptor, k, _slot(k + 1, entry))
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        os.replace(new, path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink()  # a part of it would take room away from the next trial
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the name
    finally:
        os.close(folder)


def _allocate(descriptor: int) -> None:
    """Allocate the space of all slots: a copy of the file may have holes. Raises OSError."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, SLOTS * SLOT)


def _put(descriptor: int, k: int, slot: bytes) -> None:
    written = os.pwrite(descriptor, slot, k * SLOT)
    if written != len(slot):
        raise OSError(f"only {written} of {len(slot)} bytes were written")


def _slot(sequence: int, entry: Entry) -> bytes:
    document = {"sequence": sequence, **asdict(entry)}
    while len(json.dumps(document["text"])) > LONGEST_TEXT:
        document["text"] = document["text"][: len(document["text"]) * 9 // 10]
    rest = b"\n" + json.dumps(document).encode() + b"\n"
    rest = rest.ljust(SLOT - len(HEADING) - DIGEST)
    return HEADING + hashlib.sha256(rest).hexdigest().encode() + rest


def _parsed_slots(data: bytes) -> list[tuple[int, Entry] | None]:
    """Return (sequence, entry) of each slot; None for a damaged one."""
    return [_parsed(data[k * SLOT : (k + 1) * SLOT]) for k in range(SLOTS)]


def _parsed(slot: bytes) -> tuple[int, Entry] | None:
    begin = len(HEADING)
    rest = slot[begin + DIGEST :]
    if slot[:begin] != HEADING or slot[begin : begin + DIGEST] != hashlib.sha256(rest).hexdigest().encode():
        return None
    try:
        document = json.loads(rest)
        state, cause, text = (str(document[key]) for key in ("state", "cause", "text"))
        entry = Entry(state, cause, text, float(document["at_s"]))
        sequence = int(document["sequence"])
    except (ValueError, TypeError, KeyError):
        return None
    return (sequence, entry) if entry.state in (CLEAR, STOPPED, TRIPPED) else None
