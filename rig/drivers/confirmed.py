"""What must happen is tried until the instrument says that it has: output off, test current off."""

from __future__ import annotations

from collections.abc import Callable


def confirmed(try_once: Callable[[int], bool], attempts: int, doubt: Callable[[], None]) -> bool:
    """Whether one of the attempts (0, 1, ...) was confirmed. Never raises; `doubt` is called after an error."""
    for attempt in range(attempts):
        try:
            if try_once(attempt):
                return True
        except Exception:  # whatever it was, the next attempt matters more
            doubt()
    return False
