"""Parts of every page's server, the bench's and the overview's: JSON replies, refusals, viewers, session, files."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response, StreamingResponse
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from rig.core.json_text import parsed_json
from rig.daemon.announcer import encoded, sent_event
from rig.page import CONTENT_SECURITY_POLICY
from rig.web.protection import COOKIE, Sessions, host_name

LONGEST_NAME = 80  # characters of a press or an address in the log
WAITING = 60  # events for one viewer
MOST_VIEWERS = 300  # of the connections, so that there is room for requests


class Refusal(Exception):
    """A request that is refused: an HTTP status, and a line for each fault."""

    def __init__(self, status: int, *lines: str, **headers: str) -> None:
        self.status, self.lines, self.headers = status, lines, headers
        super().__init__("; ".join(lines))


def json_reply(value: Any, status: int = 200) -> Response:
    """Return a value as JSON."""
    return Response(encoded(value), status, media_type="application/json")


def refusal_reply(status: int, *lines: str, **headers: str) -> Response:
    """Return a refusal with its reasons."""
    response = json_reply({"faults": list(lines)}, status)
    response.headers.update({name.replace("_", "-"): text for name, text in headers.items()})
    return response


async def refused(request: Request, error: Exception) -> Response:
    """Turn a Refusal, or an unknown address or method, into a reply, for starlette."""
    if isinstance(error, HTTPException):
        line = f"{request.method} {request.url.path[:LONGEST_NAME]}: {error.detail}"
        return refusal_reply(error.status_code, line, **dict(error.headers or {}))
    assert isinstance(error, Refusal)
    return refusal_reply(error.status, *error.lines, **error.headers)


async def body_of(request: Request) -> bytes:
    """Return a request's body. Raises Refusal if it ends early."""
    try:
        return await request.body()
    except ClientDisconnect:
        raise Refusal(400, "body: it ended early") from None


async def object_in(request: Request) -> dict[str, Any]:
    """Return the object in a request's body. Raises Refusal."""
    try:
        body = parsed_json(await body_of(request))
    except ValueError as error:
        raise Refusal(400, f"body: {error}") from None
    if not isinstance(body, dict):
        raise Refusal(422, "body: expected an object")
    return body


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
