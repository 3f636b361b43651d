"""Lines for whoever reads the daemon's stderr, by a thread of their own: a reader who stalls holds up nobody."""

from __future__ import annotations

import contextlib
import queue
import sys
import threading

MOST_WAITING = 1000  # lines; what is beyond is lost, rather than waited for
PATIENCE_S = 1.0  # at the end


class Log:
    """Takes lines from any thread, and never waits."""

    def __init__(self) -> None:
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def __call__(self, line: str) -> None:
        """Write a line soon."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(line)

    def close(self) -> None:
        """Write what waits, as far as somebody takes it."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(None)
        self._thread.join(PATIENCE_S)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError, ValueError):  # the terminal has gone
                print(f"peltier serve: {line}", file=sys.stderr, flush=True)
