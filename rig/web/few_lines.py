"""A log that nobody can fill: so many lines a minute, and then how many were left out."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable

MOST_LINES = 10  # a minute, of one logger
MINUTE_S = 60.0
LOGGERS = ("uvicorn.error", "asyncio")


class FewLines(logging.Filter):
    """Passes the first lines of a minute; the first line of a later one tells how many were left out."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = clock
        self._began_s = -MINUTE_S
        self._lines = self._left_out = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the line is written. What is cut short because the bench ends is no fault."""
        if record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError):
            return False
        now_s = self._now_s()
        if now_s - self._began_s >= MINUTE_S:
            if self._left_out:
                record.msg = f"{record.getMessage()} ({self._left_out} lines before this one were left out)"
                record.args = None
            self._began_s, self._lines, self._left_out = now_s, 0, 0
        self._lines += 1
        self._left_out += self._lines > MOST_LINES
        return self._lines <= MOST_LINES


def quieten() -> None:
    """Bound what the web server and its event loop write; after uvicorn has set its loggers up."""
    for name in LOGGERS:
        logging.getLogger(name).addFilter(FewLines())
