"""The overview's application: all benches in one document, STOP for each, the page's files, protection around it."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route

from rig.daemon.announcer import sent_event
from rig.overview.bench import Bench
from rig.overview.configuration import Overview
from rig.overview.exchange import Unanswered
from rig.page import OVERVIEW, STATIC
from rig.version import __version__
from rig.web.page_server import (
    LONGEST_NAME,
    PageFiles,
    Refusal,
    Viewer,
    begin_session,
    events_reply,
    json_reply,
    object_in,
    refusal_reply,
    refused,
)
from rig.web.protection import Names, Protection, Sessions

TELL_S = 0.25  # what changes within this goes out together
NO_ANSWER = 502


class Benches:
    """The methods are the endpoints."""

    def __init__(self, content: Overview, sessions: Sessions) -> None:
        self._changed = asyncio.Event()
        self._benches = {table.name: Bench(table, self._changed.set) for table in content.bench}
        self._viewers: set[Viewer] = set()
        self._sessions = sessions

    def current(self) -> dict[str, Any]:
        """All benches at this moment, in the order of the configuration."""
        benches = [bench.shown() for bench in self._benches.values()]
        return {"time_s": time.time(), "version": __version__, "benches": benches}

    async def state(self, request: Request) -> Response:
        """The same, for who asks."""
        return json_reply(self.current())

    async def events(self, request: Request) -> Response:
        """The same as it changes, until the viewer goes."""
        return events_reply(self._viewers, self.current)

    async def stop(self, request: Request) -> Response:
        """STOP to one bench, by its name; the answer is the bench's own."""
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
        """A cookie for who knows the token."""
        return await begin_session(request, self._sessions)

    @contextlib.asynccontextmanager
    async def watched(self, app: Starlette) -> AsyncIterator[None]:
        """Every bench is asked, and every viewer told, meanwhile."""
        work = [self._tell(), *(bench.watch() for bench in self._benches.values())]
        tasks = [asyncio.create_task(one) for one in work]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks, timeout=1.0)

    async def _tell(self) -> None:
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._viewers:
                event = sent_event("state", self.current())
                for viewer in self._viewers:
                    viewer.put("state", event)
            await asyncio.sleep(TELL_S)


def application(content: Overview) -> Starlette:
    """The overview of a configuration."""
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
