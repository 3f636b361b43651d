"""The web server of every page, uvicorn, with bounds on everything that callers can make it keep.

uvicorn waits for a request's first line for ever. Here a request has to be complete within some seconds. If there is no
room for another connection, the one that has been waiting for longest without a request is dropped, so that half-open
connections shut nobody out; connections whose request is being answered stay. The log is bounded as well.
"""

from __future__ import annotations

import asyncio
import logging
import math
import socket
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

WHOLE_REQUEST_S = 10.0  # for head and body; a configuration is 1 MB at most
STALLED_S = 20.0  # for taking some of an answer; a page whose computer sleeps asks again when it wakes
CLOSES_S = 1  # for open connections; no safety waits for it
PAGE_CONNECTIONS = 500  # half of the descriptors that a process has by default
STOP_CONNECTIONS = 100  # nobody needs one for longer than a moment
LONGEST_HEAD = 64_000  # bytes
MOST_LINES = 10  # a minute, of one logger
MINUTE_S = 60.0
LOGGERS = ("uvicorn.error", "asyncio")


class BoundedProtocol(H11Protocol):
    """One connection of at most `most` at a time."""

    def __init__(self, most: int, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._most = most
        self._overdue: asyncio.TimerHandle | None = None
        self._stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for the connection, or close it at once."""
        super().connection_made(transport)
        self._wait_for_request()
        if len(self.connections) > self._most and not self._make_room():
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timers."""
        self._request_is_whole()
        self._answer_is_taken()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take bytes of a request; its time begins with the first one."""
        if self._overdue is None and not self._answering():
            self._wait_for_request()
        super().data_received(data)
        if self._answering() and not self.cycle.more_body:
            self._request_is_whole()

    def on_response_complete(self) -> None:
        """Go on with a request that came meanwhile; else uvicorn waits some seconds for another one."""
        self._request_is_whole()
        super().on_response_complete()
        if self._answering() and self.cycle.more_body:
            self._wait_for_request()

    def pause_writing(self) -> None:
        """Give the caller, who does not take the answer, some time."""
        super().pause_writing()
        self._stalled = self.loop.call_later(STALLED_S, self._drop)

    def resume_writing(self) -> None:
        """Note that the answer is being taken."""
        self._answer_is_taken()
        super().resume_writing()

    def _answer_is_taken(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None

    def _answering(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # none before the first request
        return cycle is not None and not cycle.response_complete

    def _wait_for_request(self) -> None:
        self._request_is_whole()
        self._overdue = self.loop.call_later(WHOLE_REQUEST_S, self._drop)

    def _request_is_whole(self) -> None:
        if self._overdue is not None:
            self._overdue.cancel()
            self._overdue = None

    def _drop(self) -> None:
        self._overdue = None
        if self.transport is not None:
            self.transport.abort()

    def _make_room(self) -> bool:
        """Drop the connection that has been waiting for longest, of all but this one; False if none is waiting."""
        waiting: list[BoundedProtocol] = [
            one
            for one in self.connections
            if isinstance(one, BoundedProtocol) and one is not self and not one._answering()
        ]
        if not waiting:
            return False
        oldest = min(waiting, key=lambda one: one._overdue.when() if one._overdue is not None else math.inf)
        self.connections.discard(oldest)  # its end comes later; the room is there now
        oldest._drop()
        return True


class BoundedLog(logging.Filter):
    """Passes the first lines of each minute, then the number of those that were left out."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = clock
        self._began_s = -MINUTE_S
        self._lines = self._left_out = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Return True if the line is to be written. A request that the bench's end has cut short is no fault."""
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


def server_of(application: Any, most: int) -> uvicorn.Server:
    """Return a server of at most so many connections at a time."""
    config = uvicorn.Config(
        application,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=CLOSES_S,
        http=partial(BoundedProtocol, most),  # type: ignore[arg-type]
        ws="none",
        backlog=256,
        h11_max_incomplete_event_size=LONGEST_HEAD,
    )
    for name in LOGGERS:  # uvicorn has set them up
        logging.getLogger(name).addFilter(BoundedLog())
    return uvicorn.Server(config)


async def serve_and_close(
    server: uvicorn.Server, listener: socket.socket, report: Callable[[str], None] | None = None
) -> None:
    """Serve until the server's end. report: takes the page's address once the page is there. Connections that are still
    open after uvicorn's grace are closed here; uvicorn leaves them to the interpreter's end."""
    reporting = asyncio.create_task(_report_address(server, listener, report)) if report is not None else None
    await server.serve([listener])
    if reporting is not None:
        reporting.cancel()
    for connection in list(server.server_state.connections):
        connection.transport.abort()
    await asyncio.sleep(0)  # the event loop closes them in its next turn


async def _report_address(server: uvicorn.Server, listener: socket.socket, report: Callable[[str], None]) -> None:
    address, port = listener.getsockname()[:2]
    while not server.started:
        await asyncio.sleep(0.02)
    report(f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/")
