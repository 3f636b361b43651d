"""A progress line, and lines that nobody has to wait for: a reader may stall (Ctrl-S, a `less` that waits)."""

from __future__ import annotations

import contextlib
import math
import os
import queue
import shutil
import sys
import threading
import time
from collections.abc import Callable
from typing import TextIO

REWRITTEN_S = 0.2  # on a terminal, at the soonest
NEW_LINE_S = 60.0  # elsewhere: a log of an evening stays readable
NARROWEST = 20  # columns


class TerminalLine:
    """A line on a stream that shows progress: rewritten in place on a terminal, elsewhere a new one now and then."""

    def __init__(self, stream: TextIO, now_s: Callable[[], float] = time.monotonic) -> None:
        self._stream, self._now_s = stream, now_s
        self._terminal = stream.isatty()
        self._shown_s = -math.inf if self._terminal else now_s() - 0.5 * NEW_LINE_S  # what is short needs no line
        self._length = 0

    def due(self) -> bool:
        return self._now_s() - self._shown_s >= (REWRITTEN_S if self._terminal else NEW_LINE_S)

    def show(self, text: str) -> None:
        self._shown_s = self._now_s()
        if not self._terminal:
            print(text, file=self._stream, flush=True)
            return
        text = text[: max(NARROWEST, shutil.get_terminal_size().columns - 1)]
        self._stream.write("\r" + text.ljust(self._length))
        self._stream.flush()
        self._length = len(text)

    def clear(self) -> None:
        """Clear the line, so that what is printed next begins a line of its own."""
        if self._length:
            self._stream.write("\r" + " " * self._length + "\r")
            self._stream.flush()
            self._length = 0
            self._shown_s = -math.inf


class PatientLine:
    """A progress line for a loop that must not wait: a thread writes, so that a halted terminal (Ctrl-S), or a pipe
    that nobody reads, holds up nobody while a current flows. A text that is not written when the next comes is
    dropped."""

    def __init__(self, line: TerminalLine) -> None:
        self._line = line
        self._text: str | None = None
        self._changed = threading.Condition()
        self._writing = threading.Lock()
        threading.Thread(target=self._write, name="progress", daemon=True).start()

    def due(self) -> bool:
        return self._line.due()

    def show(self, text: str) -> None:
        with self._changed:
            self._text = text
            self._changed.notify()

    def clear(self) -> None:
        """Clear the line. Waits for what is being written: not to be called while a current flows."""
        with self._changed:
            self._text = None
        with self._writing:
            self._line.clear()

    def _write(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._text is not None)
            with self._writing:
                with self._changed:
                    text, self._text = self._text, None
                if text is not None:
                    with contextlib.suppress(OSError, ValueError):  # the terminal has gone
                        self._line.show(text)


MOST_WAITING = 1000  # lines; what is beyond is lost, rather than waited for


class PatientLines:
    """Lines on stderr, taken from any thread without waiting, and written by a thread of their own. who: beginning of
    each line. The thread begins with the first line: until then a process that forks has no other."""

    def __init__(self, who: str) -> None:
        self._who = who
        self._lines: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        self._beginning = threading.Lock()
        self._thread: threading.Thread | None = None

    def __call__(self, line: str) -> None:
        with contextlib.suppress(queue.Full):
            self._lines.put_nowait(line)
        with self._beginning:
            if self._thread is None:
                self._thread = threading.Thread(target=self._write, name="lines", daemon=True)
                self._thread.start()

    def close(self, patience_s: float | None) -> None:
        """Write what waits, as far as somebody reads it in this time; None: wait until it is read, or the reader has
        gone."""
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
    """Write to stderr, past its buffer if it is a file: its lock would be held for as long as the reader stalls, and
    the process could not end."""
    try:
        descriptor = sys.stderr.fileno()
    except (OSError, ValueError, AttributeError):  # none, or not one of the system's
        print(text, end="", file=sys.stderr, flush=True)
        return
    data = text.encode(errors="backslashreplace")
    while data:
        data = data[os.write(descriptor, data) :]
