"""The web process's line to the bench process: one stream of events in, questions out, viewers fanned out to.

A viewer has a short queue of its own, fed with bytes that are encoded once for all; one who is too slow misses rows,
never states.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any

ANSWER_S = 15.0  # a STOP that waits for a dead man's silence is the bench's longest
WAITING = 60  # events for one viewer
ROWS_A_SECOND = 10
STATE_EVERY_S = 5.0  # a viewer hears something as often, however quiet the bench
LONGEST_LINE = 4_000_000  # bytes of an answer: twice the longest question
MOST_QUESTIONS = 16  # at a time; a STOP does not wait for its turn


class BenchGone(Exception):
    """The bench process does not answer."""


class Viewer:
    """A queue of encoded events for one reader of /api/events."""

    def __init__(self) -> None:
        self._events: deque[tuple[str, bytes]] = deque()
        self._there = asyncio.Event()

    def put(self, event: str, data: bytes) -> None:
        """Append; where the queue is full the oldest row goes, or else the oldest of all."""
        if len(self._events) >= WAITING:
            oldest = next((k for k, (name, _) in enumerate(self._events) if name == "row"), 0)
            del self._events[oldest]
        self._events.append((event, data))
        self._there.set()

    async def take(self) -> list[bytes]:
        """What has come since, at least one event."""
        while not self._events:
            self._there.clear()
            await self._there.wait()
        taken = [data for _, data in self._events]
        self._events.clear()
        return taken


class BenchLink:
    """Connected to the bench process's socket; `gone` is set when that has ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.viewers: set[Viewer] = set()
        self.state: dict[str, Any] = {}
        self.row: dict[str, Any] = {}
        self.rows = 0
        self.gone = asyncio.Event()
        self._sent: deque[float] = deque(maxlen=ROWS_A_SECOND)
        self._told_s = 0.0
        self._idle: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
        self._turns = asyncio.Semaphore(MOST_QUESTIONS)

    async def ask(self, do: str, **more: Any) -> dict[str, Any]:
        """The bench process's answer. Raises BenchGone."""
        try:
            async with asyncio.timeout(ANSWER_S):
                async with contextlib.nullcontext() if do == "stop" else self._turns:
                    return await self._ask(do, more)
        except (OSError, ValueError) as error:
            raise BenchGone(f"the bench process does not answer: {str(error) or type(error).__name__}") from None

    async def _ask(self, do: str, more: dict[str, Any]) -> dict[str, Any]:
        reader, writer = self._line() or await self._connect()
        try:
            writer.write(json.dumps({"do": do, **more}).encode() + b"\n")
            await writer.drain()
            line = await reader.readline()
            answer = json.loads(line)
        except BaseException:
            writer.close()
            raise
        self._idle.append((reader, writer))
        assert isinstance(answer, dict)
        return answer

    def _line(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter] | None:
        """One that is open already."""
        while self._idle:
            reader, writer = self._idle.pop()
            if not reader.at_eof():
                return reader, writer
            writer.close()
        return None

    @contextlib.asynccontextmanager
    async def living(self, *work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
        """Work that goes on meanwhile, such as `follow`."""
        tasks = [asyncio.create_task(one) for one in work]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks, timeout=1.0)
            await self.close()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        return await asyncio.open_unix_connection(str(self.path), limit=LONGEST_LINE)

    async def follow(self) -> None:
        """Pass on what happens, until the bench process ends."""
        try:
            reader, writer = await self._connect()
            try:
                writer.write(b'{"do": "subscribe"}\n')
                await writer.drain()
                while line := await reader.readline():
                    message = json.loads(line)
                    self._pass_on(message["event"], message["data"])
            finally:
                writer.close()
        except (OSError, ValueError):
            pass
        finally:
            self.gone.set()
            self.state = {**self.state, "state": "offline", "output": "unknown", "output_confirmed": False}
            self._tell("state", self.current())

    def _pass_on(self, event: str, data: dict[str, Any]) -> None:
        if event == "state":
            self.state = data
            data = self.current()
            self._told_s = time.monotonic()
        elif event == "row":
            self.row, self.rows = data, self.rows + 1
            now_s = time.monotonic()
            if len(self._sent) == ROWS_A_SECOND and now_s - self._sent[0] < 0.95:
                return
            self._sent.append(now_s)
        self._tell(event, data)

    def _tell(self, event: str, data: dict[str, Any]) -> None:
        if self.viewers:
            encoded = sent_event(event, data)
            for viewer in self.viewers:
                viewer.put(event, encoded)

    async def tell_now_and_then(self) -> None:
        """The state at least every few seconds, until the bench process ends."""
        while not self.gone.is_set():
            await asyncio.sleep(1.0)
            if time.monotonic() - self._told_s >= STATE_EVERY_S - 1.0:
                with contextlib.suppress(BenchGone, KeyError):
                    self.state = (await self.ask("state"))["state"]
                self._told_s = time.monotonic()
                self._tell("state", self.current())

    async def close(self) -> None:
        """Let go of the lines for questions."""
        for _, writer in self._idle:
            writer.close()
            with contextlib.suppress(OSError):  # TimeoutError is one
                async with asyncio.timeout(0.2):
                    await writer.wait_closed()
        self._idle.clear()

    def current(self) -> dict[str, Any]:
        """The last known state, with the number of viewers."""
        return {**self.state, "viewers": len(self.viewers)}


def sent_event(event: str, data: dict[str, Any]) -> bytes:
    """One server-sent event."""
    return f"event: {event}\ndata: {json.dumps(data)}\n\n".encode()
