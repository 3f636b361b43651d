"""One writer to a history: a lock on its folder and on a file in it, which has the process number of who holds it."""

from __future__ import annotations

import os
from pathlib import Path

from rig.core.errors import PortHeld
from rig.core.file_lock import locked, tell_holder

NAME = "history.lock"  # in the folder; it has the process number of who holds it
READABLE = 0o644  # by other users too, whose daemon is then told who has the folder


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
        for path in (self._folder, self._folder / NAME):
            try:
                self._descriptors.append(locked(path, str(self._folder), self._folder / NAME, READABLE))
            except PortHeld:
                self.close()
                raise
            except OSError as error:
                failure = error
        if not self._descriptors and failure is not None:
            raise failure
        tell_holder(self._folder / NAME)

    def close(self) -> None:
        """Give it back."""
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = []
