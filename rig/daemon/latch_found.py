"""What is latched when the daemon starts, from the latch's file and the history beside it.

| the latch's file    | the history                         | then it is                                      |
|---------------------|-------------------------------------|-------------------------------------------------|
| says something      | whatever became of it               | what the file says                              |
| cannot be read      | whatever became of it               | tripped                                         |
| is not there        | is not there                        | a new bench: nothing is latched                 |
| is not there        | is from before latches had a file   | the history's last trip, unless it was cleared  |
| is not there        | had such a file, or cannot say      | tripped                                         |
"""

from __future__ import annotations

from pathlib import Path

from rig.daemon.latch import CLEAR, Kept, Latch, after_restart, not_known, of_history
from rig.daemon.latch_file import Unreadable, read
from rig.history.store import Store


def found_at_start(path: Path, history_was_there: bool, store: Store | None, now_s: float) -> tuple[Kept, Latch | None]:
    """What the file at `path` should say from now on, and the latch that this means.

    history_was_there: before `store` was opened; store: None where it could not be. now_s: Unix seconds.
    """
    try:
        kept = read(path)
    except Unreadable as error:
        other = f"; its other slot says: {error.readable.state}, {error.readable.text}" if error.readable else ""
        return _held(not_known(f"the latch could not be read ({error}{other})", now_s))
    latch = after_restart(kept) if kept is not None else None
    if kept is None and history_was_there:
        if store is None:
            return _held(not_known(f"the latch's file {path} is not there, and the history cannot be read", now_s))
        if store.damage is not None or store.has_latch:
            return _held(not_known(f"the latch's file {path} is missing beside a history", now_s))
    if latch is None and store is not None and not store.has_latch and (last := store.last_trip()) is not None:
        latch = of_history(*last)
    if latch is not None:
        return _held(latch)
    return kept or Kept(CLEAR, "new", "nothing was ever latched here", now_s), None


def _held(latch: Latch) -> tuple[Kept, Latch | None]:
    return latch.kept(), latch
