"""Classify errors of the history database, in words: a lock, which passes, a full disk, damage.

SQLite's result codes, https://www.sqlite.org/rescode.html; the bytes locked in `-shm`,
https://www.sqlite.org/walformat.html#wal_locks; the lines of /proc/locks, proc_locks(5).
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SIDE_FILES = ("", "-wal", "-shm")
# SQLITE_IOERR_RDLOCK, _UNLOCK, _BLOCKED, _CHECKRESERVEDLOCK, _LOCK, _SHMOPEN, _SHMLOCK, _SHMMAP: the file system's
# locks and shared memory, as on a network folder
NO_LOCKS = {sqlite3.SQLITE_IOERR | number << 8 for number in (8, 9, 11, 14, 15, 18, 20, 21)} | {sqlite3.SQLITE_PROTOCOL}
READ_MARKS = range(123, 128)  # bytes of -shm that are locked by whoever reads
PLAIN_CODE = 0xFF  # of an extended result code
BY_TEXT = {"locked": sqlite3.SQLITE_BUSY, "full": sqlite3.SQLITE_FULL, "readonly": sqlite3.SQLITE_READONLY}


@dataclass(frozen=True)
class Trouble:
    """An error of the history. text: what, where, what to do; passes: rows wait, and no run is ended; anew: the file
    has to be opened again; damage: it is no readable history."""

    text: str
    passes: bool = False
    anew: bool = False
    damage: bool = False


def trouble_of(error: sqlite3.Error | OSError, path: Path) -> Trouble:
    """Return the trouble behind an error of the history at `path`."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is None:  # an exception of Python's own
        code = next((number for word, number in BY_TEXT.items() if word in str(error)), None)
    if code in NO_LOCKS:
        do = "set serve.folder to a folder on a disk of this computer"
        return Trouble(f"{path}: its file system does not lock files as it should ({error}); {do}", passes=True)
    if code is None or isinstance(error, OSError):
        return Trouble(f"{path}: {error}")
    match code & PLAIN_CODE:
        case sqlite3.SQLITE_BUSY | sqlite3.SQLITE_LOCKED:
            who = who_locks(path) or "another program, such as a database browser or a backup"
            return Trouble(f"{path} is locked by {who}; close it there", passes=True)
        case sqlite3.SQLITE_FULL:
            return Trouble(f"{path}: {error}: make room on that disk")
        case sqlite3.SQLITE_READONLY:
            return Trouble(f"{path}: {error}: let this user write it and its folder", anew=True)
        case sqlite3.SQLITE_CORRUPT | sqlite3.SQLITE_NOTADB | sqlite3.SQLITE_ERROR | sqlite3.SQLITE_FORMAT:
            return Trouble(f"{path}: {error}: it is put aside, and a new one begun", anew=True, damage=True)
    return Trouble(f"{path}: {error}", anew=True)


def who_locks(path: Path) -> str:
    """Return the other processes that have the history locked for writing, in words; "" if none is found (Linux)."""
    return _in_words(path, SIDE_FILES, "WRITE", range(1 << 62))


def who_reads(path: Path) -> str:
    """Return the other processes that are reading the history, in words; "" if none is found (Linux)."""
    return _in_words(path, ("-shm",), "READ", READ_MARKS)


def _in_words(path: Path, endings: tuple[str, ...], how: str, at: range) -> str:
    inodes = {there.st_ino for ending in endings if (there := stat_of(Path(f"{path}{ending}"))) is not None}
    found = dict.fromkeys(
        process
        for process, kind, inode, first in _locks()
        if kind == how and inode in inodes and first in at and process > 0 and process != os.getpid()
    )
    return ", ".join(f"process {number}{_command(number)}" for number in found)


def _locks() -> Iterator[tuple[int, str, int, int]]:
    """Yield (process, "READ" or "WRITE", inode, first byte) of each lock on this computer."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if "->" not in words:  # those with an arrow wait for the lock
                yield int(words[4]), words[3], int(words[5].rsplit(":", 1)[1]), int(words[6])


def _command(process: int) -> str:
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
        return f" ({words})" if words else ""
    return ""


def stat_of(path: Path) -> os.stat_result | None:
    """Return the status of a file; None if there is none."""
    try:
        return os.stat(path)
    except OSError:
        return None
