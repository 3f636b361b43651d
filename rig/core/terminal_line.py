"""A line that tells how far something is: rewritten in place on a terminal, elsewhere a new one now and then.

Import-light.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import threading
import time
from collections.abc import Callable
from typing import TextIO

REWRITTEN_S = 0.2  # on a terminal, at the soonest
NEW_LINE_S = 60.0  # elsewhere: a log of an evening stays readable
NARROWEST = 20  # columns


class TerminalLine:
    """One on a stream, by a clock (s)."""

    def __init__(self, stream: TextIO, now_s: Callable[[], float] = time.monotonic) -> None:
        self._stream, self._now_s = stream, now_s
        self._terminal = stream.isatty()
        self._shown_s = -math.inf if self._terminal else now_s() - 0.5 * NEW_LINE_S  # what is short needs no line
        self._length = 0

    def due(self) -> bool:
        """Whether it is time to show something again."""
        return self._now_s() - self._shown_s >= (REWRITTEN_S if self._terminal else NEW_LINE_S)

    def show(self, text: str) -> None:
        """In the place of what was shown before."""
        self._shown_s = self._now_s()
        if not self._terminal:
            print(text, file=self._stream, flush=True)
            return
        text = text[: max(NARROWEST, shutil.get_terminal_size().columns - 1)]
        self._stream.write("\r" + text.ljust(self._length))
        self._stream.flush()
        self._length = len(text)

    def clear(self) -> None:
        """Nothing is shown any more; what is printed next begins a line of its own."""
        if self._length:
            self._stream.write("\r" + " " * self._length + "\r")
            self._stream.flush()
            self._length = 0
            self._shown_s = -math.inf


class PatientLine:
    """The same for a loop that must not wait: a thread writes, so that a terminal that was halted (Ctrl-S), or a pipe
    that nobody reads, holds up nobody while a current flows. What it has not written when the next comes is dropped."""

    def __init__(self, line: TerminalLine) -> None:
        self._line = line
        self._text: str | None = None
        self._changed = threading.Condition()
        self._writing = threading.Lock()
        threading.Thread(target=self._write, name="progress", daemon=True).start()

    def due(self) -> bool:
        """Whether it is time to show something again."""
        return self._line.due()

    def show(self, text: str) -> None:
        """Soon, in the place of what was shown before."""
        with self._changed:
            self._text = text
            self._changed.notify()

    def clear(self) -> None:
        """Nothing is shown any more. Waits for what is being written: not for while a current flows."""
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
