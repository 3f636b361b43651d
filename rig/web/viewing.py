"""What every page's server has: viewers of a stream of events, and a cookie for who knows the token."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from rig.web.bench_link import Viewer, sent_event
from rig.web.protection import COOKIE, Sessions
from rig.web.replies import failed, given, said

MOST_VIEWERS = 300  # of the connections that there are, so that there is room for questions


def streamed(viewers: set[Viewer], current: Callable[[], dict[str, Any]]) -> Response:
    """Server-sent events until the viewer goes, the state as it is now first."""
    if len(viewers) >= MOST_VIEWERS:
        return failed(503, f"viewers: expected at most {MOST_VIEWERS}")
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


async def session_begun(request: Request, sessions: Sessions) -> Response:
    """A cookie for who knows the token."""
    body = await given(request)
    name = sessions.begin(body.get("token"))
    if name is None:
        return failed(401, "token: missing or wrong")
    answer = said({"ok": True})
    answer.set_cookie(COOKIE, name, samesite="strict", httponly=True, path="/")
    return answer
