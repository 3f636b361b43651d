"""The page's application, docs/bench_api.md: requests answered from the history, or forwarded to the bench process.

Questions to the history are answered in threads with deadlines; the metrics are computed when Prometheus asks.
A query over a month takes one processor for a moment; forty at once would hold up everybody. Here they wait in line,
which costs nothing, and one that would wait for too long is refused. The memory of the film is the model's, driven by
the temperatures in the history since the film was last saturated; each request brings it up to date. numba is imported
when there is a model, and not before.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sqlite3
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route

from rig.core.clock import DAY_S
from rig.daemon.announcer import encoded
from rig.daemon.client import NoDaemon, Refusal
from rig.history import reading
from rig.history.reading import loop_points, temperatures
from rig.history.store import trouble_of
from rig.records.film_output import output_to_ohm
from rig.web.bench_link import JOBS, STOP, BenchLink, forward
from rig.web.page_server import (
    STATIC,
    PageFiles,
    begin_session,
    events_reply,
    json_reply,
    refusal_reply,
    refused,
    running,
)
from rig.web.protection import Names, Protection, Sessions

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


HOUR_S = 3600.0  # of points shown: some cycles of the film
POINTS = 1500  # more overlap on a figure of 600 pixels
CURVE_POINTS = 121  # over the limits' range, some 0.8 K apart, drawn with straight lines
TURN_K = 0.1  # a reversal by less is noise
MOST_ROWS = 500_000  # that one request catches up with; a week at 10 Hz takes twelve


class LoopPlane:
    """Answers `GET /api/loop` from a history; safe for several threads."""

    def __init__(self, history: Path) -> None:
        self._history = history
        self._lock = threading.Lock()
        self._key: tuple[object, ...] = ()
        self._film: _FollowedFilm | None = None

    def document(
        self, model: str | None, memory_since_s: float | None, limits_degC: list[float], now_s: float
    ) -> dict[str, Any]:
        """Return the answer. memory_since_s: Unix s since when the film's memory is known; None: it is not. Raises
        sqlite3.Error."""
        points = loop_points(self._history, now_s - HOUR_S, POINTS)
        found: dict[str, Any] = {
            "temperature_degC": [point[1] for point in points],
            "resistance_ohm": [point[2] for point in points],
            "model": None,
            "memory": None,
        }
        with self._lock:
            key = (model, memory_since_s, tuple(limits_degC))
            if key != self._key:
                self._key, self._film = key, _followed(model, memory_since_s, limits_degC)
            if self._film is not None:
                found["model"] = self._film.curves
                found["memory"] = self._film.memory(self._history)
        return found


def _followed(model: str | None, since_s: float | None, limits_degC: list[float]) -> _FollowedFilm | None:
    """Return the film of a model file; None if there is no such file, or no film with a resistance in it."""
    if model is None or not Path(model).is_file():
        return None
    from rig.config.model_file import read_model
    from rig.core.faults import Faults

    try:
        known = read_model(Path(model))
        falls = known.film is not None and known.film.output == "minus_log10_ohm"
        return _FollowedFilm(known, since_s, limits_degC) if falls else None
    except (Faults, OSError, ValueError):
        return None


class _FollowedFilm:
    """A film model, its major loop, and its memory as far as the history was followed."""

    def __init__(self, known: Any, since_s: float | None, limits_degC: list[float]) -> None:
        import numpy as np

        low, high = limits_degC
        film = known.film
        self._model, self._mixing, self._limits = film, known.mixing, (low, high)
        self._at_s, self._memory, self._turn_degC, self._branch = since_s, None, 0.0, "falling"
        up = np.linspace(low, high, CURVE_POINTS)
        rising, _ = film.simulate(up, film.initial_memory(low, "heated"))
        falling, _ = film.simulate(up[::-1], film.initial_memory(high, "cooled"))
        self.curves = {
            "temperature_degC": up.tolist(),
            "rising_ohm": (10.0 ** -self._mixed(rising)).tolist(),
            "falling_ohm": (10.0 ** -self._mixed(falling[::-1])).tolist(),
        }

    def _mixed(self, outputs: Any) -> Any:
        return outputs if self._mixing is None else self._mixing.mixed(outputs)

    def memory(self, history: Path) -> dict[str, Any] | None:
        """Return the film's present state; None if it is not known."""
        import numpy as np

        from compensator.inverse.inverse import Inverse

        if self._at_s is None:
            return None
        rows = temperatures(history, self._at_s, MOST_ROWS)
        if rows:
            self._at_s = rows[-1][0]
            values = np.array([row[1] for row in rows])
            if self._memory is None:
                self._memory = self._model.initial_memory(float(values[0]), "cooled")
                self._turn_degC = float(values[0])
            self._memory = self._model.simulate(values, self._memory)[1]
            for value in values:
                self._follow_branch(float(value))
        if self._memory is None or len(rows) == MOST_ROWS:  # there are more: the memory is that of an earlier time
            return None
        interval = Inverse(self._model, *self._limits).solve(1e6, self._memory).interval
        reachable = None
        if interval is not None:
            reachable = sorted(output_to_ohm(output) for output in self._mixed(np.array(interval)).tolist())
        return {"temperature_degC": self._memory.input_degC, "branch": self._branch, "reachable_ohm": reachable}

    def _follow_branch(self, degC: float) -> None:
        """Follow the farthest temperature on the branch, and the reversals."""
        forward = degC - self._turn_degC if self._branch == "rising" else self._turn_degC - degC
        if forward > 0.0:
            self._turn_degC = degC
        elif forward < -TURN_K:
            self._turn_degC = degC
            self._branch = "falling" if self._branch == "rising" else "rising"


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


class Metrics(NamedTuple):
    """Metrics of the bench, from its last state and row. rows: that were published; gone: the bench process is."""

    state: dict[str, Any]
    row: dict[str, Any]
    rows: int
    gone: bool

    def collect(self) -> Iterator[Metric]:
        state, row, rows, gone = self
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

    def __init__(self, link: BenchLink, settings: dict[str, Any]) -> None:
        self._link, self._settings = link, settings
        self._history = Path(settings["history"])
        self._queries = HistoryQueries()
        self._plane_queries = HistoryQueries(PLANE_S, at_once=1)
        self._plane = LoopPlane(self._history)

    async def _get(self, path: str) -> Any:
        """Ask the bench process. Raises Refusal, with its status and faults if it refuses."""
        try:
            return await self._link.get(path)
        except NoDaemon as error:
            raise Refusal(503, [str(error)]) from None

    async def state(self, request: Request) -> Response:
        self._link.state = await self._get("/api/state")
        return json_reply(self._link.current())

    async def events(self, request: Request) -> Response:
        return events_reply(self._link.viewers, self._link.current)

    async def history(self, request: Request) -> Response:
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

    async def report(self, request: Request) -> Response:
        """Reply with a file of a run's folder: its report, a figure, its record."""
        number = request.path_params["number"]
        folder = next((job["folder"] for job in await self._get("/api/jobs") if job["id"] == number), None)
        if folder is None:
            raise Refusal(404, ["run: not known"])
        try:
            root = Path(folder).resolve()
            path = (root / request.path_params["name"]).resolve()
            if not (path.is_relative_to(root) and path.is_file()):
                raise Refusal(404, [NO_FILE])
        except (OSError, ValueError):
            raise Refusal(404, [NO_FILE]) from None
        return FileResponse(path)

    async def metrics(self, request: Request) -> Response:
        link = self._link
        found: Any = Metrics(link.current(), link.row, link.rows, link.gone.is_set())  # all that is asked of a registry
        return Response(generate_latest(found), media_type=CONTENT_TYPE_LATEST)

    async def health(self, request: Request) -> Response:
        """Reply 200 while control cycles complete, else 503 with the faults."""
        try:
            state = await self._link.get("/api/state")
            offline, age_s, warnings = state["state"] == "offline", state["cycle_age_s"], state["warnings"]
        except (NoDaemon, Refusal, KeyError) as error:
            return json_reply({"ok": False, "wrong": [str(error)]}, 503)
        wrong = []
        if offline:
            wrong += [line for line in warnings if line.startswith("offline")] or ["offline"]
        if age_s > HEALTHY_S + 5.0 * float(self._settings["period_s"]):
            wrong.append(f"the last control cycle was completed {age_s:.1f} s ago")
        wrong += [line for line in warnings if line.startswith(("the history cannot", "the latch cannot"))]
        return json_reply({"ok": not wrong} | ({"wrong": wrong} if wrong else {}), 503 if wrong else 200)

    def close(self) -> None:
        self._queries.close()
        self._plane_queries.close()


def application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """Return the page's application. settings: the bench process's [serve]."""
    sessions = Sessions(settings["token"], settings["metrics_token"])
    requests, to_the_bench = Requests(link, settings), partial(forward, link)
    routes: list[Route | Mount] = [
        Route("/api/state", requests.state),
        Route("/api/events", requests.events),
        Route("/api/history", requests.history),
        Route("/api/loop", requests.loop),
        Route("/api/trips", requests.trips),
        Route(JOBS, to_the_bench, methods=["GET", "POST"]),
        Route("/api/jobs/{number}", to_the_bench, methods=["DELETE"]),
        Route("/api/configurations", to_the_bench),
        Route(STOP, to_the_bench, methods=["POST"]),
        Route("/api/reset", to_the_bench, methods=["POST"]),
        Route("/api/session", partial(begin_session, sessions=sessions), methods=["POST"]),
        Route("/runs/{number}/{name:path}", requests.report),
        Route("/metrics", requests.metrics),
        Route("/health", requests.health),
        Mount("/", PageFiles(STATIC, settings["stop_port"])),
    ]
    names = Names(settings["address"], settings["hosts"])

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with running(link.follow(), link.send_states()):
            yield
        requests.close()

    return Starlette(
        routes=routes,
        middleware=[Middleware(Protection, names=names, sessions=sessions)],
        lifespan=lifespan,
        exception_handlers={Refusal: refused, HTTPException: refused},
    )
