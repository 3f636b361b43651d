"""Parts of every page's server, the bench's and the overview's: JSON replies, refusals, viewers, session, files;
and the server itself, uvicorn, with bounds on everything that callers can make it keep.

uvicorn waits for a request's first line for ever. Here a request has to be complete within some seconds. If there is no
room for another connection, the one that has been waiting for longest without a request is dropped, so that half-open
connections shut nobody out; connections whose request is being answered stay. The log is bounded as well.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import re
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.staticfiles import StaticFiles
from starlette.types import Scope
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from rig.core.json_text import parsed_json
from rig.daemon.announcer import encoded, sent_event
from rig.daemon.client import Refusal
from rig.web.protection import COOKIE, Sessions, host_name

PAGE = Path(__file__).resolve().parents[1] / "page"
STATIC, OVERVIEW = PAGE / "static", PAGE / "overview"  # of a bench, and of several; no build step
# the strictest policy that the pages work under: no inline script or style, nothing from another origin, no frame
CONTENT_SECURITY_POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
)
LONGEST_NAME = 80  # characters of a press or an address in the log
READ_AT_ONCE = 1 << 20  # bytes
WAITING = 60  # events for one viewer
MOST_VIEWERS = 300  # of the connections, so that there is room for requests


def json_reply(value: Any, status: int = 200) -> Response:
    return Response(encoded(value), status, media_type="application/json")


def refusal_reply(status: int, *lines: str, **headers: str) -> Response:
    response = json_reply({"faults": list(lines)}, status)
    response.headers.update({name.replace("_", "-"): text for name, text in headers.items()})
    return response


async def refused(request: Request, error: Exception) -> Response:
    """Turn a Refusal, or an unknown address or method, into a reply, for starlette."""
    if isinstance(error, HTTPException):
        line = f"{request.method} {request.url.path[:LONGEST_NAME]}: {error.detail}"
        return refusal_reply(error.status_code, line, **dict(error.headers or {}))
    assert isinstance(error, Refusal)
    return refusal_reply(error.status, *error.lines)


async def body_of(request: Request) -> bytes:
    """Return a request's body. Raises Refusal if it ends early."""
    try:
        return await request.body()
    except ClientDisconnect:
        raise Refusal(400, ["body: it ended early"]) from None


async def object_in(request: Request) -> dict[str, Any]:
    """Return the object in a request's body. Raises Refusal."""
    try:
        body = parsed_json(await body_of(request))
    except ValueError as error:
        raise Refusal(400, [f"body: {error}"]) from None
    if not isinstance(body, dict):
        raise Refusal(422, ["body: expected an object"])
    return body


async def exchange(
    connecting: Coroutine[Any, Any, tuple[asyncio.StreamReader, asyncio.StreamWriter]],
    method: str,
    path: str,
    headers: dict[str, str],
    body: bytes,
    most: float = math.inf,
) -> tuple[int, bytes]:
    """Send a request on a connection of its own; return status and content, of at most so many bytes. Raises OSError,
    or ValueError if the answer is no whole one.

    It is one of HTTP/1.0, whose answer comes in one piece and ends with the connection.
    """
    reader, writer = await connecting
    with contextlib.closing(writer):
        head = [f"{method} {path} HTTP/1.0", *(f"{name}: {text}" for name, text in headers.items())]
        head += [f"Content-Length: {len(body)}", "", ""]
        writer.write("\r\n".join(head).encode("latin-1", "replace") + body)
        answer = b""
        while len(answer) <= most and (part := await reader.read(READ_AT_ONCE)):
            answer += part
    if len(answer) > most:
        raise ValueError(f"an answer of more than {most} bytes")
    lines, _, content = answer.partition(b"\r\n\r\n")
    if (status := re.match(rb"HTTP/1\.\d (\d{3})\b", lines)) is None:
        raise ValueError("no HTTP")
    length = re.search(rb"(?i)\r\ncontent-length: *(\d+)", lines)
    if length is not None and len(content) < int(length[1]):
        raise ValueError("an answer that ends early")
    return int(status[1]), content


class Viewer:
    """A queue of encoded events for one reader of /api/events. One that is too slow misses rows, never states."""

    def __init__(self) -> None:
        self._events: deque[tuple[str, bytes]] = deque()
        self._there = asyncio.Event()

    def put(self, event: str, data: bytes) -> None:
        """Append an event; a full queue loses its oldest row, or else the oldest of all."""
        if len(self._events) >= WAITING:
            oldest = next((k for k, (name, _) in enumerate(self._events) if name == "row"), 0)
            del self._events[oldest]
        self._events.append((event, data))
        self._there.set()

    async def take(self) -> list[bytes]:
        """Return the events since the last call, at least one."""
        while not self._events:
            self._there.clear()
            await self._there.wait()
        taken = [data for _, data in self._events]
        self._events.clear()
        return taken


def events_reply(viewers: set[Viewer], current: Callable[[], dict[str, Any]]) -> Response:
    """Return server-sent events until the viewer goes, the present state first."""
    if len(viewers) >= MOST_VIEWERS:
        return refusal_reply(503, f"viewers: expected at most {MOST_VIEWERS}")
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(_events(viewers, current), media_type="text/event-stream", headers=headers)


async def _events(viewers: set[Viewer], current: Callable[[], dict[str, Any]]) -> AsyncIterator[bytes]:
    viewer = Viewer()
    viewers.add(viewer)
    try:
        yield b"retry: 2000\n\n" + sent_event("state", current())
        while True:
            yield b"".join(await viewer.take())
    finally:
        viewers.discard(viewer)


@contextlib.asynccontextmanager
async def running(*work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run coroutines meanwhile, and cancel them at the end."""
    tasks = [asyncio.create_task(one) for one in work]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks, timeout=1.0)


async def begin_session(request: Request, sessions: Sessions) -> Response:
    """Return a cookie to a caller with the token."""
    body = await object_in(request)
    name = sessions.begin(body.get("token"))
    if name is None:
        return refusal_reply(401, "token: missing or wrong")
    answer = json_reply({"ok": True})
    answer.set_cookie(COOKIE, name, samesite="strict", httponly=True, path="/")
    return answer


class PageFiles(StaticFiles):
    """Static files that run no foreign code, and are requested again after an upgrade. stop_port: of this host's STOP,
    the one other address that the page may use."""

    def __init__(self, folder: Path, stop_port: int | None) -> None:
        super().__init__(directory=folder, html=True)
        self._stop_port = stop_port

    def file_response(self, full_path: Any, stat_result: Any, scope: Scope, status_code: int = 200) -> Response:
        """Return the file with its policy; a browser may keep it, but asks whether it is still valid."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        policy = CONTENT_SECURITY_POLICY
        if self._stop_port is not None:
            host = host_name(Headers(scope=scope).get("host", ""))  # one of this bench's: the protection has checked it
            policy += f"; connect-src 'self' http://{host}:{self._stop_port}"
        response.headers["Content-Security-Policy"] = policy
        response.headers["Cache-Control"] = "no-cache"
        return response


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
        super().connection_made(transport)
        self._wait_for_request()
        if len(self.connections) > self._most and not self._make_room():
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
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
