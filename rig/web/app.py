"""The page's application, docs/bench_api.md: requests answered from the history, or forwarded to the bench process."""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import AsyncIterator, Callable
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route

from rig.core.clock import DAY_S
from rig.daemon.announcer import encoded
from rig.history import reading
from rig.history.trouble import trouble_of
from rig.web.bench_link import STOP, BenchGone, BenchLink
from rig.web.forwarding import forward
from rig.web.history_queries import Busy, HistoryQueries, TooLong
from rig.web.loop_plane import LoopPlane
from rig.web.metrics import Metrics
from rig.web.page_server import PageFiles, Refusal, begin_session, events_reply, json_reply, refusal_reply, refused
from rig.web.protection import Names, Protection, Sessions

HEALTHY_S = 10.0  # largest age of the last control cycle, besides five of its periods
PLANE_S = 45.0  # the first question about a film compiles its model
NO_FILE = "run: it has no such file"


class Requests:
    """The methods are the endpoints."""

    def __init__(self, link: BenchLink, settings: dict[str, Any], sessions: Sessions) -> None:
        self._link, self._settings, self._sessions = link, settings, sessions
        self._history = Path(settings["history"])
        self._queries = HistoryQueries()
        self._plane_queries = HistoryQueries(PLANE_S, at_once=1)
        self._metrics = Metrics()
        self._plane = LoopPlane(self._history)

    async def forward(self, request: Request) -> Response:
        """Let the bench process answer."""
        return await forward(self._link, request)

    async def _get(self, path: str) -> Any:
        """Ask the bench process. Raises Refusal, with its status and faults if it refuses."""
        try:
            return await self._link.get(path)
        except BenchGone as error:
            raise Refusal(503, str(error)) from None

    async def state(self, request: Request) -> Response:
        """The bench at this moment."""
        self._link.state = await self._get("/api/state")
        return json_reply(self._link.current())

    async def events(self, request: Request) -> Response:
        """Server-sent events until the viewer goes."""
        return events_reply(self._link.viewers, self._link.current)

    async def history(self, request: Request) -> Response:
        """Rows of a span of time."""
        now_s = time.time()
        try:
            from_s = float(request.query_params.get("from", now_s - DAY_S))
            to_s = float(request.query_params.get("to", now_s))
            points = int(request.query_params.get("points", "1000")[:20])
            if points < 1:
                raise ValueError(f"{points} points: expected at least one")
            reading.check_span(from_s, to_s)
        except ValueError as error:
            return refusal_reply(422, f"from, to, points: {error}")
        return await self._queried(lambda ends_s: reading.span(self._history, from_s, to_s, points, ends_s))

    async def loop(self, request: Request) -> Response:
        """The last hour in the (T, R) plane."""
        found = await self._get("/daemon")
        plane, now_s = self._plane, time.time()
        film = found["model"], found["memory_since_s"], found["limits_degC"]
        return await self._queried(lambda ends_s: plane.document(*film, now_s), self._plane_queries)

    async def trips(self, request: Request) -> Response:
        """The last trips with the rows around them."""
        return await self._queried(lambda ends_s: reading.trips(self._history))

    async def _queried(self, query: Callable[[float], Any], queries: HistoryQueries | None = None) -> Response:
        """Return the history's answer as JSON, which is encoded in the same thread."""
        try:
            found = await (queries or self._queries).answer(lambda ends_s: encoded(query(ends_s)))
        except Busy:
            line = "history: too many questions wait; expected a try some seconds later"
            return refusal_reply(429, line, retry_after="3")
        except TooLong:
            line = "history: no answer in time; expected a try some seconds later, or a shorter span"
            return refusal_reply(503, line, retry_after="3")
        except sqlite3.Error as error:
            return refusal_reply(503, f"history: {trouble_of(error, self._history).text}")
        except OverflowError as error:
            return refusal_reply(503, f"history: {error}")
        return Response(found, media_type="application/json")

    async def session(self, request: Request) -> Response:
        """A cookie for a caller with the token."""
        return await begin_session(request, self._sessions)

    async def report(self, request: Request) -> Response:
        """A file of a run's folder: its report, a figure, its record."""
        number = request.path_params["number"]
        folder = next((job["folder"] for job in await self._get("/api/jobs") if job["id"] == number), None)
        if folder is None:
            raise Refusal(404, "run: not known")
        try:
            root = Path(folder).resolve()
            path = (root / request.path_params["name"]).resolve()
            if not (path.is_relative_to(root) and path.is_file()):
                raise Refusal(404, NO_FILE)
        except (OSError, ValueError):
            raise Refusal(404, NO_FILE) from None
        return FileResponse(path)

    async def metrics(self, request: Request) -> Response:
        """Prometheus text."""
        link = self._link
        body, kind = self._metrics.text(link.current(), link.row, link.rows, link.gone.is_set())
        return Response(body, media_type=kind)

    async def health(self, request: Request) -> Response:
        """200 while control cycles complete, else 503 with the faults."""
        try:
            state = await self._link.get("/api/state")
            offline, age_s, warnings = state["state"] == "offline", state["cycle_age_s"], state["warnings"]
        except (BenchGone, Refusal, KeyError) as error:
            return json_reply({"ok": False, "wrong": [str(error)]}, 503)
        wrong = []
        if offline:
            wrong += [line for line in warnings if line.startswith("offline")] or ["offline"]
        if age_s > HEALTHY_S + 5.0 * float(self._settings["period_s"]):
            wrong.append(f"the last control cycle was completed {age_s:.1f} s ago")
        wrong += [line for line in warnings if line.startswith(("the history cannot", "the latch cannot"))]
        return json_reply({"ok": not wrong} | ({"wrong": wrong} if wrong else {}), 503 if wrong else 200)

    def close(self) -> None:
        """End the threads of the history."""
        self._queries.close()
        self._plane_queries.close()


def application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """Return the page's application. settings: the bench process's [serve]."""
    sessions = Sessions(settings["token"], settings["metrics_token"])
    requests = Requests(link, settings, sessions)
    routes: list[Route | Mount] = [
        Route("/api/state", requests.state),
        Route("/api/events", requests.events),
        Route("/api/history", requests.history),
        Route("/api/loop", requests.loop),
        Route("/api/trips", requests.trips),
        Route("/api/jobs", requests.forward, methods=["GET", "POST"]),
        Route("/api/jobs/{number}", requests.forward, methods=["DELETE"]),
        Route("/api/configurations", requests.forward),
        Route(STOP, requests.forward, methods=["POST"]),
        Route("/api/reset", requests.forward, methods=["POST"]),
        Route("/api/session", requests.session, methods=["POST"]),
        Route("/runs/{number}/{name:path}", requests.report),
        Route("/metrics", requests.metrics),
        Route("/health", requests.health),
    ]
    page = Path(str(resources.files("rig"))) / "page" / "static"
    if page.is_dir():
        routes.append(Mount("/", PageFiles(page, settings["stop_port"])))
    names = Names(settings["address"], settings["hosts"])

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with link.living(link.follow(), link.send_states()):
            yield
        requests.close()

    return Starlette(
        routes=routes,
        middleware=[Middleware(Protection, names=names, sessions=sessions)],
        lifespan=lifespan,
        exception_handlers={Refusal: refused, HTTPException: refused},
    )
