"""Queries of the history: few at a time, each in a thread, none for longer than its deadline.

A query over a month takes one processor for a moment; forty at once would hold up everybody. Here they wait in line,
which costs nothing, and one that would wait for too long is refused.
"""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

AT_ONCE = 2  # queries: each takes a thread and a read of the disk
MOST_WAITING = 60  # with figures of a month, some 60 ms each, the last one is answered in time
DEADLINE_S = 8.0  # in line and in work; the page waits for 30 s


class Busy(Exception):
    """Too many queries wait."""


class TooLong(Exception):
    """A query was not answered within the deadline."""


class HistoryQueries:
    """Answers queries in threads of its own."""

    def __init__(self, deadline_s: float = DEADLINE_S, at_once: int = AT_ONCE) -> None:
        self._deadline_s, self._most = deadline_s, at_once + MOST_WAITING
        self._threads = ThreadPoolExecutor(at_once, "history")
        self._waiting = 0

    async def answer(self, query: Callable[[float], Any]) -> Any:
        """Return the result of a query, which gets the time.monotonic at which it has to end.

        Raises Busy, TooLong, and the query's exceptions.
        """
        if self._waiting >= self._most:
            raise Busy
        ends_s = time.monotonic() + self._deadline_s
        self._waiting += 1
        try:
            task = asyncio.get_running_loop().run_in_executor(self._threads, _result, query, ends_s)
            task.add_done_callback(self._one_less)
        except BaseException:
            self._waiting -= 1
            raise
        try:
            async with asyncio.timeout(self._deadline_s + 0.5):
                return await asyncio.shield(task)
        except TimeoutError:
            raise TooLong from None

    def _one_less(self, task: asyncio.Future[Any]) -> None:
        self._waiting -= 1
        if not task.cancelled():
            task.exception()  # retrieved, even if nobody waits for it any more

    def close(self) -> None:
        """Let the threads end."""
        self._threads.shutdown(wait=False, cancel_futures=True)


def _result(query: Callable[[float], Any], ends_s: float) -> Any:
    if time.monotonic() >= ends_s:
        raise TooLong
    try:
        return query(ends_s)
    except sqlite3.OperationalError:
        if time.monotonic() >= ends_s:
            raise TooLong from None
        raise
