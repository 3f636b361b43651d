"""A lock that one process holds on a file or a folder, and whose it is: a file beside or in it has the process number.

It goes when its descriptor is closed, and with the process, whatever that dies of; the file stays.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path

from rig.core.errors import PortHeld

TAKEN = (errno.EAGAIN, errno.EACCES)  # what a lock that somebody else has may answer (POSIX leaves the choice)
DIGITS = 20  # of a process number, and to spare


def locked(path: Path, what: str, told_in: Path, mode: int = 0o600) -> int:
    """Open a folder, or a file that is made if it is missing, and lock it as long as it is open; return its
    descriptor."""
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
    with contextlib.suppress(OSError):
        path.write_text(str(os.getpid()), encoding="ascii")


def _holder(path: Path) -> int | None:
    try:
        with path.open("rb") as file:
            text = file.read(DIGITS).strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None
