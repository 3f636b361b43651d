"""The page's application, docs/bench_api.md: requests answered from the history, or forwarded to the bench process.

The metrics for Prometheus are computed when it asks.
"""

from __future__ import annotations

import contextlib
import math
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
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
from rig.web.bench_link import JOBS, STOP, BenchGone, BenchLink, forward
from rig.web.history import Busy, HistoryQueries, LoopPlane, TooLong
from rig.web.page_server import PageFiles, Refusal, begin_session, events_reply, json_reply, refusal_reply, refused
from rig.web.protection import Names, Protection, Sessions

HEALTHY_S = 10.0  # largest age of the last control cycle, besides five of its periods
PLANE_S = 45.0  # the first question about a film compiles its model
NO_FILE = "run: it has no such file"
STATES = ("idle", "running", "stopped", "tripped", "offline")
GAUGES = {
    "temperature_degC": ("peltier_temperature_celsius", "Thermometer's reading."),
    "resistance_ohm": ("peltier_resistance_ohms", "Ohmmeter's reading."),
    "current_A": ("peltier_current_amperes", "Current commanded; positive heats. Of a heater its drive, 0 to 1."),
    "setpoint_degC": ("peltier_setpoint_celsius", "Wanted temperature."),
    "target_ohm": ("peltier_target_ohms", "Wanted resistance."),
}


class Metrics:
    """Metrics of the bench: a registry with one collector."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(self)
        self._given: tuple[dict[str, Any], dict[str, Any], int, bool] = ({}, {}, 0, True)

    def text(self, state: dict[str, Any], row: dict[str, Any], rows: int, gone: bool) -> tuple[bytes, str]:
        """Return the text and its media type, from the last state and row."""
        self._given = (state, row, rows, gone)
        return generate_latest(self._registry), CONTENT_TYPE_LATEST

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics, for the registry."""
        state, row, rows, gone = self._given
        reading, ticks = {**state.get("reading", {}), **row}, state.get("ticks", {})
        word = GaugeMetricFamily("peltier_state", "1 for the state that the bench is in.", labels=["state"])
        for name in STATES:
            word.add_metric([name], float(state.get("state") == name))
        yield word
        output = {"on": 1.0, "off": 0.0}.get(state.get("output", "unknown"))
        gauges: list[tuple[str, str, Any]] = [
            ("peltier_up", "1 if the bench process answers.", not gone),
            *((name, text, reading.get(column)) for column, (name, text) in GAUGES.items()),
            ("peltier_output_on", "1 on, 0 off, NaN unknown.", output),
            ("peltier_output_confirmed", "1 if the controller confirmed it.", state.get("output_confirmed")),
            ("peltier_jobs_queued", "Jobs that wait.", state.get("queue")),
            ("peltier_viewers", "Pages that are open.", state.get("viewers")),
            ("peltier_warnings", "Warnings that are shown.", len(state.get("warnings", []))),
            ("peltier_cycle_age_seconds", "Since the last control cycle.", state.get("cycle_age_s")),
            ("peltier_tick_latest_seconds", "Largest lateness.", ticks.get("latest_s")),
        ]
        for name, text, value in gauges:
            yield GaugeMetricFamily(name, text, math.nan if value is None else float(value))
        yield CounterMetricFamily("peltier_ticks_done", "Control cycles completed.", float(ticks.get("done", 0)))
        yield CounterMetricFamily("peltier_ticks_missed", "Control cycles missed.", float(ticks.get("missed", 0)))
        yield CounterMetricFamily("peltier_rows_published", "Rows committed and published.", float(rows))


class Requests:
    """State of the page's process; the methods are the endpoints."""

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
        """Reply with the bench at this moment."""
        self._link.state = await self._get("/api/state")
        return json_reply(self._link.current())

    async def events(self, request: Request) -> Response:
        """Send events until the viewer goes."""
        return events_reply(self._link.viewers, self._link.current)

    async def history(self, request: Request) -> Response:
        """Reply with the rows of a span of time."""
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
        """Reply with the last hour in the (T, R) plane."""
        found = await self._get("/daemon")
        plane, now_s = self._plane, time.time()
        film = found["model"], found["memory_since_s"], found["limits_degC"]
        return await self._queried(lambda ends_s: plane.document(*film, now_s), self._plane_queries)

    async def trips(self, request: Request) -> Response:
        """Reply with the last trips and the rows around them."""
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
        """Begin a session of a caller with the token."""
        return await begin_session(request, self._sessions)

    async def report(self, request: Request) -> Response:
        """Reply with a file of a run's folder: its report, a figure, its record."""
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
        """Reply with the metrics."""
        link = self._link
        body, kind = self._metrics.text(link.current(), link.row, link.rows, link.gone.is_set())
        return Response(body, media_type=kind)

    async def health(self, request: Request) -> Response:
        """Reply 200 while control cycles complete, else 503 with the faults."""
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
        Route(JOBS, requests.forward, methods=["GET", "POST"]),
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
