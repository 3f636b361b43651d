"""The latch on disk: a file that no kill, full disk or power cut turns into "nothing is latched".

    bench.latch    slot 0, slot 1, each of SLOT bytes
    slot           peltier latch 1 SHA-256-OF-THE-REST
                   {"sequence": 7, "state": "tripped", "cause": "...", "text": "...", "at_s": ...}
                   spaces up to the slot's end

The file is made under another name, both slots written and synced, and renamed when it is whole: its space is taken
from then on. What changes goes into the slot with the smaller sequence number, in place, and is synced. Where that is
cut short the other slot is whole, but it may say "clear" while the one that was cut short was to say "tripped": a slot
that cannot be read makes the whole latch unreadable, and the caller takes that for a trip.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import asdict
from pathlib import Path

from rig.daemon.latch import CLEAR, STOPPED, TRIPPED, Kept

LATCH = "bench.latch"
SLOT = 4096  # bytes: a page, which the kernel writes whole whenever the process is killed; and no sector of both slots
SLOTS = 2
LONGEST_TEXT = 3000  # bytes of JSON: with its heading and the other fields it stays below a slot
HEADING = b"peltier latch 1 "


class Unreadable(Exception):
    """The file is there and does not say what is latched. readable: what its other slot says, where that is whole."""

    def __init__(self, why: str, readable: Kept | None = None) -> None:
        self.readable = readable
        super().__init__(why)


def read(path: Path) -> Kept | None:
    """What is latched; None where there is no file. Raises Unreadable."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise Unreadable(f"{path}: {error.strerror or error}") from None
    if len(data) != SLOTS * SLOT:
        raise Unreadable(f"{path} has {len(data)} bytes; expected {SLOTS * SLOT}")
    slots = _slots(data)
    known = sorted((slot for slot in slots if slot is not None), key=lambda slot: slot[0])
    if len(known) < SLOTS:
        raise Unreadable(f"{path}: {SLOTS - len(known)} of its {SLOTS} slots damaged", known[-1][1] if known else None)
    if known[1][0] != known[0][0] + 1:
        raise Unreadable(f"{path}: slots {known[0][0]} and {known[1][0]} do not follow one another", known[1][1])
    return known[1][1]


def write(path: Path, kept: Kept) -> None:
    """Keep it: on disk when this returns. Raises OSError; what is on disk is then the old, the new, or unreadable."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        data = b""
    if len(data) != SLOTS * SLOT:
        _make(path, kept)
        return
    slots = _slots(data)
    sequences = [slot[0] if slot is not None else 0 for slot in slots]
    damaged = [k for k, slot in enumerate(slots) if slot is None]
    descriptor = os.open(path, os.O_WRONLY)
    try:
        _reserve(descriptor)
        for number, k in enumerate(damaged or [sequences.index(min(sequences))], start=max(sequences) + 1):
            _put(descriptor, k, _slot(number, kept))
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _make(path: Path, kept: Kept) -> None:
    """The file anew, under its name only when it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    begun = path.with_name(f"{path.name}.new")
    try:
        descriptor = os.open(begun, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        try:
            _reserve(descriptor)
            for k in range(SLOTS):
                _put(descriptor, k, _slot(k + 1, kept))
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        os.replace(begun, path)
    except OSError:
        with contextlib.suppress(OSError):
            begun.unlink()  # a part of it would take room away from the next trial
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the name
    finally:
        os.close(folder)


def _reserve(descriptor: int) -> None:
    """Space for all slots, where it is not taken yet: a copy of the file may have holes. Raises OSError."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(descriptor, 0, SLOTS * SLOT)


def _put(descriptor: int, k: int, slot: bytes) -> None:
    written = os.pwrite(descriptor, slot, k * SLOT)
    if written != len(slot):
        raise OSError(f"only {written} of {len(slot)} bytes were written")


def _slot(sequence: int, kept: Kept) -> bytes:
    said = {"sequence": sequence, **asdict(kept)}
    while len(json.dumps(said["text"])) > LONGEST_TEXT:
        said["text"] = said["text"][: len(said["text"]) * 9 // 10]
    rest = b"\n" + json.dumps(said).encode() + b"\n"
    rest = rest.ljust(SLOT - len(HEADING) - 64)
    return HEADING + hashlib.sha256(rest).hexdigest().encode() + rest


def _slots(data: bytes) -> list[tuple[int, Kept] | None]:
    """(sequence, what it says) of each slot; None where it is damaged."""
    return [_said(data[k * SLOT : (k + 1) * SLOT]) for k in range(SLOTS)]


def _said(slot: bytes) -> tuple[int, Kept] | None:
    begin = len(HEADING)
    rest = slot[begin + 64 :]
    if slot[:begin] != HEADING or slot[begin : begin + 64] != hashlib.sha256(rest).hexdigest().encode():
        return None
    try:
        said = json.loads(rest)
        kept = Kept(str(said["state"]), str(said["cause"]), str(said["text"]), float(said["at_s"]))
        sequence = int(said["sequence"])
    except (ValueError, TypeError, KeyError):
        return None
    return (sequence, kept) if kept.state in (CLEAR, STOPPED, TRIPPED) else None
