"""Lines on stderr, written by a thread of their own: a reader who stalls (Ctrl-S, a `less` that waits, a pipe that
nobody reads) holds up nobody who has an output to switch off.

Import-light.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading

MOST_WAITING = 1000  # lines; what is beyond is lost, rather than waited for


class PatientLines:
    """Takes lines from any thread, and never waits. who: what each line begins with. The thread begins with the first
    line: until then a process that forks has no other."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        self._beginning = threading.Lock()
        self._thread: threading.Thread | None = None

    def __call__(self, line: str) -> None:
        """Write a line soon."""
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(line)
        with self._beginning:
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="lines", daemon=True)
                self._thread.start()

    def close(self, patience_s: float | None) -> None:
        """Write what waits, as far as somebody takes it in this time; None: wait until it is taken, or nobody is there
        to take it."""
        if self._thread is None:
            return
        with contextlib.suppress(queue.Full):
            self._lines.put(None, timeout=patience_s)
            self._thread.join(patience_s)

    def _write(self) -> None:
        while (line := self._lines.get()) is not None:
            with contextlib.suppress(OSError, ValueError):  # the terminal has gone
                _written(f"{self._who}: {line}\n")


def _written(text: str) -> None:
    """On stderr, past its buffer where it is a file: its lock would be held for as long as the reader stalls, and the
    process could not end."""
    try:
        descriptor = sys.stderr.fileno()
    except (OSError, ValueError, AttributeError):  # none, or not one of the system's
        print(text, end="", file=sys.stderr, flush=True)
        return
    data = text.encode(errors="backslashreplace")
    while data:
        data = data[os.write(descriptor, data) :]
