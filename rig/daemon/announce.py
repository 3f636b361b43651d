"""Telling whoever listens: each listener has a short queue of its own, and who is too slow is let go."""

from __future__ import annotations

import contextlib
import json
import queue
import threading
from pathlib import Path
from typing import Any

from rig.core.json_text import finite

WAITING = 500  # lines for one listener


class Announcer:
    """Events go in from any thread and come out as lines of JSON in every listener's queue."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: list[queue.Queue[bytes | None]] = []

    def listen(self) -> queue.Queue[bytes | None]:
        """A queue of what happens from now on; None in it: the listener was too slow, or all is over."""
        listener: queue.Queue[bytes | None] = queue.Queue(WAITING)
        with self._lock:
            self._listeners.append(listener)
        return listener

    def leave(self, listener: queue.Queue[bytes | None]) -> None:
        """Listen no more."""
        with self._lock, contextlib.suppress(ValueError):
            self._listeners.remove(listener)

    def tell(self, event: str, data: Any) -> None:
        """Put {"event", "data"} into every queue; never waits."""
        with self._lock:
            if not self._listeners:
                return
            line = encoded({"event": event, "data": data})
            for listener in list(self._listeners):
                try:
                    listener.put_nowait(line)
                except queue.Full:
                    self._listeners.remove(listener)
                    with contextlib.suppress(queue.Empty):
                        listener.get_nowait()
                    listener.put_nowait(None)

    def close(self) -> None:
        """Let all listeners go."""
        with self._lock:
            for listener in self._listeners:
                with contextlib.suppress(queue.Full):
                    listener.put_nowait(None)
            self._listeners.clear()


def encoded(value: Any) -> bytes:
    """A line of JSON; not-a-number and infinity are null, a path is text."""
    try:
        return json.dumps(value, allow_nan=False, default=_plain).encode() + b"\n"
    except ValueError:
        return json.dumps(finite(value), default=_plain).encode() + b"\n"


def _plain(value: Any) -> Any:
    if hasattr(value, "item"):  # numpy's numbers
        return finite(value.item())
    return str(value) if isinstance(value, Path) else repr(value)
