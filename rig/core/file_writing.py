"""Files that are written whole or not at all, errors that name their file, as that of a full disk does not, and locks.

A lock is held by one process on a file or a folder; a file beside or in it has the process number.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rig.core.errors import PortHeld

TAKEN = (errno.EAGAIN, errno.EACCES)  # what a lock that somebody else has may answer (POSIX leaves the choice)
DIGITS = 20  # of a process number, and to spare


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Add the file's name to an OSError from inside that has none."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file to write to, which replaces the one at `path` at the end; after an error the old one stays and
    the new one is deleted, so that it takes no space from the next attempt. Raises OSError, which names the file."""
    new = path.with_name(path.name + ".new")
    try:
        with naming_file(path):
            yield new
            os.replace(new, path)
    except BaseException as error:
        with suppress(OSError):
            new.unlink()
        if isinstance(error, OSError) and error.filename == str(new):  # the user knows no file of this name
            error.filename = str(path)
        raise


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """Give a file to write to as `replacing` does; a link, a pipe and a device are written to as they are."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with naming_file(path):
            yield path
    else:
        with replacing(path) as new:
            yield new


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all. Raises OSError, which names the file."""
    with writing(path) as new:
        new.write_text(text, encoding="utf-8")


# ---- locks ------------------------------------------------------------------------------------------


def locked(path: Path, what: str, told_in: Path, mode: int = 0o600) -> int:
    """Open a folder, or a file that is made if it is missing, and lock it; return its descriptor. POSIX only.

    The lock goes when the descriptor is closed, and with the process, whatever it dies of; the file stays.
    """
    import fcntl

    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR | os.O_CREAT, mode)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if error.errno in TAKEN:
            raise PortHeld(what, _holder(told_in), "peltier serve") from None
        raise
    return descriptor


def tell_holder(path: Path) -> None:
    """Write this process's number into a file whose lock it holds; on a full disk nothing is written."""
    with suppress(OSError):
        path.write_text(str(os.getpid()), encoding="ascii")


def command_of(process: int) -> str:
    """Return the command line of a process; "" if it is unknown (elsewhere than on Linux it always is)."""
    with suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    return ""


def _holder(path: Path) -> int | None:
    try:
        with path.open("rb") as file:
            text = file.read(DIGITS).strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None
