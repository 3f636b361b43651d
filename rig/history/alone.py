"""One writer to a history: a lock on its folder and on a file in it, which has the process number of who holds it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path

from rig.core.errors import PortHeld

NAME = "history.lock"
TAKEN = (errno.EAGAIN, errno.EACCES)


class Alone:
    """The right to write into a folder, from `take` to `close`.

    Two locks, because each may be impossible: a full disk has no room for the file, and some network file systems lock
    no folders. One that somebody else holds is enough to say no.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._descriptors: list[int] = []
        self._locked: os.stat_result | None = None  # the folder

    def take(self) -> None:
        """Take it; nothing more where it is held already, and the folder is the same one still. Raises PortHeld,
        OSError where no lock can be had."""
        self._folder.mkdir(parents=True, exist_ok=True)
        folder = os.stat(self._folder)
        if self._descriptors and self._locked is not None and os.path.samestat(folder, self._locked):
            return
        self.close()
        self._locked = folder
        failure: OSError | None = None
        for path, flags in ((self._folder, os.O_RDONLY), (self._folder / NAME, os.O_RDWR | os.O_CREAT)):
            try:
                self._lock(os.open(path, flags, 0o644))
            except PortHeld:
                self.close()
                raise
            except OSError as error:
                failure = error
        if not self._descriptors and failure is not None:
            raise failure
        with contextlib.suppress(OSError):  # there is no room on a full disk: then nobody is told the number
            (self._folder / NAME).write_text(str(os.getpid()), encoding="utf-8")

    def close(self) -> None:
        """Give it back."""
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = []

    def _lock(self, descriptor: int) -> None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            if error.errno in TAKEN:
                raise PortHeld(str(self._folder), self._holder(), "peltier serve") from None
            raise
        self._descriptors.append(descriptor)

    def _holder(self) -> int | None:
        try:
            text = (self._folder / NAME).read_text(encoding="utf-8").strip()
        except (OSError, ValueError):
            return None
        return int(text) if text.isdigit() else None
