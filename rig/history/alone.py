"""One writer to a history: a lock beside it, with the process number of who holds it."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import IO

from rig.errors import PortHeld


def alone(folder: Path) -> IO[str]:
    """The folder's lock, held until the file is closed. Raises PortHeld where another process has it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "history.lock"
    file = path.open("a+", encoding="utf-8")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.seek(0)
        text = file.read().strip()
        file.close()
        raise PortHeld(str(folder), int(text) if text.isdigit() else None, "peltier serve") from None
    file.truncate(0)
    file.write(str(os.getpid()))
    file.flush()
    return file
