"""Each request of docs/bench_api.md, asked of the bench process or of the history."""

from __future__ import annotations

import json
import math
import sqlite3
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse

from rig.history import reading
from rig.web.bench_link import BenchGone, BenchLink, Viewer, sent_event
from rig.web.loop_plane import LoopPlane
from rig.web.measures import Measures
from rig.web.protection import COOKIE, Sessions

DAY_S = 86400.0
HEALTHY_S = 10.0  # the oldest that a completed control cycle may be, beside five of its periods
MOST_VIEWERS = 500


class Requests:
    """The methods are the endpoints."""

    def __init__(self, link: BenchLink, settings: dict[str, Any], sessions: Sessions) -> None:
        self._link, self._settings, self._sessions = link, settings, sessions
        self._history = Path(settings["history"])
        self._measures = Measures()
        self._plane = LoopPlane(self._history)

    async def state(self, request: Request) -> Response:
        """The bench at this moment."""
        try:
            self._link.state = (await self._link.ask("state"))["state"]
        except (BenchGone, KeyError) as error:
            return failed(503, str(error))
        return JSONResponse(self._link.current())

    async def events(self, request: Request) -> Response:
        """Server-sent events until the viewer goes."""
        if len(self._link.viewers) >= MOST_VIEWERS:
            return failed(503, f"viewers: expected at most {MOST_VIEWERS}")
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        return StreamingResponse(self._stream(), media_type="text/event-stream", headers=headers)

    async def _stream(self) -> AsyncIterator[bytes]:
        viewer = Viewer()
        self._link.viewers.add(viewer)
        try:
            yield b"retry: 2000\n\n" + sent_event("state", self._link.current())
            while True:
                yield b"".join(await viewer.take())
        finally:
            self._link.viewers.discard(viewer)

    async def history(self, request: Request) -> Response:
        """Rows of a stretch of time."""
        now_s = time.time()
        try:
            from_s = float(request.query_params.get("from", now_s - DAY_S))
            to_s = float(request.query_params.get("to", now_s))
            points = int(request.query_params.get("points", "1000"))
            found = await run_in_threadpool(reading.stretch, self._history, from_s, to_s, points)
        except ValueError as error:
            return failed(422, f"from, to, points: {error}")
        except (sqlite3.Error, OverflowError) as error:
            return failed(503, f"history: {error}")
        return JSONResponse(found)

    async def loop(self, request: Request) -> Response:
        """The last hour in the (T, R) plane."""
        answer = await self._ask("web")
        if isinstance(answer, Response):
            return answer
        try:
            found = await run_in_threadpool(
                self._plane.document, answer["model"], answer["memory_since_s"], answer["limits_degC"], time.time()
            )
        except sqlite3.Error as error:
            return failed(503, f"history: {error}")
        return JSONResponse(found)

    async def trips(self, request: Request) -> Response:
        """The last trips with the rows around them."""
        try:
            found = await run_in_threadpool(reading.trips, self._history)
        except sqlite3.Error as error:
            return failed(503, f"history: {error}")
        return Response(json.dumps(finite(found)), media_type="application/json")

    async def jobs(self, request: Request) -> Response:
        """The queue and the last jobs."""
        answer = await self._ask("jobs")
        return answer if isinstance(answer, Response) else JSONResponse(answer["jobs"])

    async def configurations(self, request: Request) -> Response:
        """What may be started."""
        answer = await self._ask("configurations")
        return answer if isinstance(answer, Response) else JSONResponse(answer["configurations"])

    async def stop(self, request: Request) -> Response:
        """The output off."""
        answer = await self._ask("stop", by=f"the page ({_client(request)})")
        return answer if isinstance(answer, Response) else JSONResponse(without(answer))

    async def reset(self, request: Request) -> Response:
        """Clear what is latched."""
        body = await _object(request)
        if isinstance(body, Response):
            return body
        answer = await self._ask("reset", reason=body.get("reason", ""))
        return answer if isinstance(answer, Response) else JSONResponse(without(answer))

    async def submit(self, request: Request) -> Response:
        """A new job."""
        body = await _object(request)
        if isinstance(body, Response):
            return body
        wanted = {key: body[key] for key in ("configuration", "text", "name", "kind") if key in body}
        answer = await self._ask("submit", **wanted)
        return answer if isinstance(answer, Response) else JSONResponse(answer["job"], 201)

    async def cancel(self, request: Request) -> Response:
        """A job taken out of the queue, or ended."""
        number = request.path_params["number"]
        answer = await self._ask("cancel", id=number, by=f"the page ({_client(request)})")
        return answer if isinstance(answer, Response) else JSONResponse(answer["job"])

    async def session(self, request: Request) -> Response:
        """A cookie for who knows the token."""
        body = await _object(request)
        if isinstance(body, Response):
            return body
        name = self._sessions.begin(body.get("token"))
        if name is None:
            return failed(401, "token: missing or wrong")
        answer = JSONResponse({"ok": True})
        answer.set_cookie(COOKIE, name, samesite="strict", httponly=True, path="/")
        return answer

    async def report(self, request: Request) -> Response:
        """A file of a run's folder: its report, a figure, its record."""
        answer = await self._ask("jobs")
        if isinstance(answer, Response):
            return answer
        number = request.path_params["number"]
        folder = next((job["folder"] for job in answer["jobs"] if job["id"] == number), None)
        if folder is None:
            return failed(404, "run: not known")
        root = Path(folder).resolve()
        try:
            path = (root / request.path_params["name"]).resolve()
            if not (path.is_relative_to(root) and path.is_file()):
                return failed(404, "run: it has no such file")
        except (OSError, ValueError):
            return failed(404, "run: it has no such file")
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
            return JSONResponse({"ok": False, "wrong": [str(error)]}, 503)
        wrong = []
        if state["state"] == "offline":
            wrong += [line for line in state["warnings"] if line.startswith("offline")] or ["offline"]
        if state["cycle_age_s"] > HEALTHY_S + 5.0 * float(self._settings["period_s"]):
            wrong.append(f"the last control cycle was completed {state['cycle_age_s']:.1f} s ago")
        wrong += [line for line in state["warnings"] if line.startswith("the history cannot")]
        return JSONResponse({"ok": not wrong} | ({"wrong": wrong} if wrong else {}), 503 if wrong else 200)

    async def _ask(self, do: str, **more: Any) -> dict[str, Any] | Response:
        """The bench process's answer, or the response that says why there is none."""
        try:
            answer = await self._link.ask(do, **more)
        except BenchGone as error:
            return failed(503, str(error))
        if not answer.get("ok"):
            return JSONResponse({"faults": answer.get("faults", [])}, int(answer.get("status", 500)))
        return answer


def failed(status: int, line: str) -> Response:
    """A refusal with its reason."""
    return JSONResponse({"faults": [line]}, status)


def without(answer: dict[str, Any]) -> dict[str, Any]:
    """An answer without what only the socket's protocol needs."""
    return {key: value for key, value in answer.items() if key != "ok"}


def finite(value: Any) -> Any:
    """JSON knows neither infinity nor not-a-number."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    return [finite(entry) for entry in value] if isinstance(value, list) else value


async def _object(request: Request) -> dict[str, Any] | Response:
    try:
        body = json.loads(await request.body())
    except (ValueError, RecursionError):
        return failed(400, "body: expected JSON")
    return body if isinstance(body, dict) else failed(422, "body: expected an object")


def _client(request: Request) -> str:
    return request.client.host if request.client is not None else "somewhere"
