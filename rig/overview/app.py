"""The overview's application and server: all benches in one document, STOP for each, the page's files, protection."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import sys
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route

from rig.daemon.announcer import sent_event
from rig.daemon.web_process import listening, why_not
from rig.overview.bench import Bench, Unanswered
from rig.overview.configuration import Overview
from rig.version import __version__
from rig.web.page_server import (
    LONGEST_NAME,
    OVERVIEW,
    PAGE_CONNECTIONS,
    STATIC,
    PageFiles,
    Refusal,
    Viewer,
    begin_session,
    events_reply,
    json_reply,
    object_in,
    refusal_reply,
    refused,
    serve_and_close,
    server_of,
)
from rig.web.protection import Names, Protection, Sessions

TOGETHER_S = 0.25  # what changes within this goes out together
NO_ANSWER = 502


class Benches:
    """State of all benches; the methods are the endpoints."""

    def __init__(self, content: Overview, sessions: Sessions) -> None:
        self._changed = asyncio.Event()
        self._benches = {table.name: Bench(table, self._changed.set) for table in content.bench}
        self._viewers: set[Viewer] = set()
        self._sessions = sessions

    def current(self) -> dict[str, Any]:
        """Return all benches at this moment, in the order of the configuration."""
        benches = [bench.shown() for bench in self._benches.values()]
        return {"time_s": time.time(), "version": __version__, "benches": benches}

    async def state(self, request: Request) -> Response:
        """Reply with all benches at this moment."""
        return json_reply(self.current())

    async def events(self, request: Request) -> Response:
        """Send all benches as they change, until the viewer goes."""
        return events_reply(self._viewers, self.current)

    async def stop(self, request: Request) -> Response:
        """Send STOP to one bench, by its name; reply with the bench's own answer."""
        body = await object_in(request)
        bench = self._benches.get(str(body.get("bench")))
        if bench is None:
            return refusal_reply(404, f"bench: expected one of {', '.join(self._benches)}")
        press = body.get("press")
        name = press[:LONGEST_NAME] if isinstance(press, str) else secrets.token_urlsafe(12)
        try:
            status, answer = await bench.stop(name)
        except Unanswered as error:
            return refusal_reply(NO_ANSWER, f"{bench.name} does not answer: {error}")
        return json_reply(answer, status)

    async def session(self, request: Request) -> Response:
        """Begin a session of a caller with the token."""
        return await begin_session(request, self._sessions)

    @contextlib.asynccontextmanager
    async def watched(self, app: Starlette) -> AsyncIterator[None]:
        """Ask every bench, and send changes to every viewer, meanwhile."""
        work = [self._send_changes(), *(bench.watch() for bench in self._benches.values())]
        tasks = [asyncio.create_task(one) for one in work]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks, timeout=1.0)

    async def _send_changes(self) -> None:
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._viewers:
                event = sent_event("state", self.current())
                for viewer in self._viewers:
                    viewer.put("state", event)
            await asyncio.sleep(TOGETHER_S)


def application(content: Overview) -> Starlette:
    """Return the application of a configuration."""
    table = content.overview
    sessions = Sessions(table.token.get_secret_value() if table.token is not None else None)
    benches = Benches(content, sessions)
    routes: list[Route | Mount] = [
        Route("/api/state", benches.state),
        Route("/api/events", benches.events),
        Route("/api/stop", benches.stop, methods=["POST"]),
        Route("/api/session", benches.session, methods=["POST"]),
        Mount("/shared", PageFiles(STATIC, None)),
        Mount("/icons", PageFiles(STATIC / "icons", None)),
        Mount("/", PageFiles(OVERVIEW, None)),
    ]
    return Starlette(
        routes=routes,
        middleware=[Middleware(Protection, names=Names(table.address, table.hosts), sessions=sessions)],
        lifespan=benches.watched,
        exception_handlers={Refusal: refused},
    )


async def serve(content: Overview, report: Callable[[str], None]) -> int:
    """Serve the overview until a signal; return the exit status. report: called with the address once the page is
    there."""
    table = content.overview
    server = server_of(application(content), PAGE_CONNECTIONS)
    try:
        listener = listening(table.address, table.port)
    except OSError as error:
        why = f"{table.address}:{table.port}: {why_not(error)} (overview.address, overview.port)"
        print(f"peltier overview: there is no page at {why}", file=sys.stderr)
        return 1
    await serve_and_close(server, listener, report)
    return 0 if server.started else 1
