"""Each request of docs/bench_api.md, asked of the bench process or of the history."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import FileResponse, Response

from rig.core.clock import DAY_S
from rig.history import reading
from rig.history.trouble import trouble_of
from rig.web.bench_link import BenchGone, BenchLink
from rig.web.history_desk import Busy, HistoryDesk, TooLong
from rig.web.loop_plane import LoopPlane
from rig.web.measures import Measures
from rig.web.protection import Sessions
from rig.web.replies import Refusal, asked, client, encoded, failed, given, said, stopped
from rig.web.viewing import session_begun, streamed

HEALTHY_S = 10.0  # the oldest that a completed control cycle may be, beside five of its periods
PLANE_S = 45.0  # the first question about a film compiles its model
OF_A_JOB = ("configuration", "text", "name", "kind", "hold_degC", "hold_s")


class Requests:
    """The methods are the endpoints."""

    def __init__(self, link: BenchLink, settings: dict[str, Any], sessions: Sessions) -> None:
        self._link, self._settings, self._sessions = link, settings, sessions
        self._history = Path(settings["history"])
        self._desk = HistoryDesk()
        self._plane_desk = HistoryDesk(PLANE_S, at_once=1)
        self._measures = Measures()
        self._plane = LoopPlane(self._history)

    async def state(self, request: Request) -> Response:
        """The bench at this moment."""
        self._link.state = (await asked(self._link, "state"))["state"]
        return said(self._link.current())

    async def events(self, request: Request) -> Response:
        """Server-sent events until the viewer goes."""
        return streamed(self._link.viewers, self._link.current)

    async def history(self, request: Request) -> Response:
        """Rows of a stretch of time."""
        now_s = time.time()
        try:
            from_s = float(request.query_params.get("from", now_s - DAY_S))
            to_s = float(request.query_params.get("to", now_s))
            points = int(request.query_params.get("points", "1000")[:20])
            if points < 1:
                raise ValueError(f"{points} points: expected at least one")
            reading.check_stretch(from_s, to_s)
        except ValueError as error:
            return failed(422, f"from, to, points: {error}")
        return await self._looked_up(lambda ends_s: reading.stretch(self._history, from_s, to_s, points, ends_s))

    async def loop(self, request: Request) -> Response:
        """The last hour in the (T, R) plane."""
        told = await asked(self._link, "web")
        plane, now_s = self._plane, time.time()
        where = told["model"], told["memory_since_s"], told["limits_degC"]
        return await self._looked_up(lambda ends_s: plane.document(*where, now_s), self._plane_desk)

    async def trips(self, request: Request) -> Response:
        """The last trips with the rows around them."""
        return await self._looked_up(lambda ends_s: reading.trips(self._history))

    async def _looked_up(self, question: Callable[[float], Any], desk: HistoryDesk | None = None) -> Response:
        """What the history answers, as JSON, which is made in the same thread."""
        try:
            found = await (desk or self._desk).answer(lambda ends_s: encoded(question(ends_s)))
        except Busy:
            return failed(429, "history: too many questions wait; expected a try some seconds later", retry_after="3")
        except TooLong:
            line = "history: no answer in time; expected a try some seconds later, or a shorter stretch"
            return failed(503, line, retry_after="3")
        except sqlite3.Error as error:
            return failed(503, f"history: {trouble_of(error, self._history).text}")
        except OverflowError as error:
            return failed(503, f"history: {error}")
        return Response(found, media_type="application/json")

    async def jobs(self, request: Request) -> Response:
        """The queue and the last jobs."""
        return said((await asked(self._link, "jobs"))["jobs"])

    async def configurations(self, request: Request) -> Response:
        """What may be started."""
        return said((await asked(self._link, "configurations"))["configurations"])

    async def stop(self, request: Request) -> Response:
        """The output off."""
        return await stopped(self._link, request)

    async def reset(self, request: Request) -> Response:
        """Clear what is latched."""
        body = await given(request)
        return said(await asked(self._link, "reset", reason=body.get("reason", "")))

    async def submit(self, request: Request) -> Response:
        """A new job."""
        body = await given(request)
        wanted = {key: body[key] for key in OF_A_JOB if key in body}
        return said((await asked(self._link, "submit", **wanted))["job"], 201)

    async def cancel(self, request: Request) -> Response:
        """A job taken out of the queue, or ended."""
        number = request.path_params["number"]
        return said((await asked(self._link, "cancel", id=number, by=f"the page ({client(request)})"))["job"])

    async def session(self, request: Request) -> Response:
        """A cookie for who knows the token."""
        return await session_begun(request, self._sessions)

    async def report(self, request: Request) -> Response:
        """A file of a run's folder: its report, a figure, its record."""
        jobs = (await asked(self._link, "jobs"))["jobs"]
        number = request.path_params["number"]
        folder = next((job["folder"] for job in jobs if job["id"] == number), None)
        if folder is None:
            raise Refusal(404, "run: not known")
        try:
            root = Path(folder).resolve()
            path = (root / request.path_params["name"]).resolve()
            if not (path.is_relative_to(root) and path.is_file()):
                raise Refusal(404, "run: it has no such file")
        except (OSError, ValueError):
            raise Refusal(404, "run: it has no such file") from None
        return FileResponse(path)

    async def metrics(self, request: Request) -> Response:
        """Prometheus text."""
        state = self._link.current()
        body, kind = self._measures.text(state, self._link.row, self._link.rows, self._link.gone.is_set())
        return Response(body, media_type=kind)

    async def health(self, request: Request) -> Response:
        """Whether control cycles complete."""
        try:
            state = (await self._link.ask("state"))["state"]
        except (BenchGone, KeyError) as error:
            return said({"ok": False, "wrong": [str(error)]}, 503)
        wrong = []
        if state["state"] == "offline":
            wrong += [line for line in state["warnings"] if line.startswith("offline")] or ["offline"]
        if state["cycle_age_s"] > HEALTHY_S + 5.0 * float(self._settings["period_s"]):
            wrong.append(f"the last control cycle was completed {state['cycle_age_s']:.1f} s ago")
        wrong += [line for line in state["warnings"] if line.startswith(("the history cannot", "the latch cannot"))]
        return said({"ok": not wrong} | ({"wrong": wrong} if wrong else {}), 503 if wrong else 200)

    def close(self) -> None:
        """Ask the history no more."""
        self._desk.close()
        self._plane_desk.close()
