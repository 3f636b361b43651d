"""A bench daemon for the page's tests: docs/bench_api.md on a synthetic rig, with faults at one's fingertips.

To look at the page without instruments:

    python -m tests.rig.web.fake_bench [--port 8765] [--token TOKEN] [--running]
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import socket
import threading
import time
import tomllib
from collections.abc import AsyncIterator, Iterator
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from rig.page import CONTENT_SECURITY_POLICY, STATIC
from rig.web.serving import serve_and_close
from tests.rig.web.fake_rig import PERIOD_S, FakeRig

TEXT = """# a loop, slowly
[bench.controller]
driver = "meerstetter"
port = "sim://"

[bench.meter]
driver = "keithley2000"
port = "sim://"

[experiment]
kind = "track_resistance"
name = "demo"
target = ["start 50 kohm", "ramp to 3 kohm at 0.2 dec/s"]
"""


class FakeBench:
    """State, queue, viewers; the tests reach in to trip it, freeze it, or see when STOP arrived."""

    def __init__(self, token: str | None = None) -> None:
        self.rig = FakeRig()
        self.token = token
        self.state, self.output, self.confirmed = "idle", "off", True
        self.trip: dict[str, object] | None = None
        self.jobs: list[dict[str, Any]] = []
        self.name = "film 7, bench A"
        self.drive_unit = "A"
        self.viewers: set[asyncio.Queue[str | None]] = set()
        self.stops: list[float] = []
        self.answers_stop_after_s = 0.0
        self.stop_port: int | None = None  # of STOP's own listener
        self.reset_reasons: list[str] = []
        self.started_s = time.time()
        self.warnings: list[str] = []
        self.known = True
        self.cycles = 0

    # what the bench knows

    def job(self) -> dict[str, Any] | None:
        """The job that runs."""
        return next((job for job in self.jobs if job["state"] == "running"), None)

    def tell(self) -> dict[str, object]:
        """The object `state` of the contract."""
        job, row = self.job(), self.rig.rows[-1] if self.rig.rows else None
        return {
            "time_s": time.time(), "version": "0.2.0", "name": self.name, "uptime_s": time.time() - self.started_s,
            "state": self.state, "output": self.output, "output_confirmed": self.confirmed, "trip": self.trip,
            "stop": {"cause": "stop", "text": "stopped by the page", "at_s": self.stops[-1], "rows": 0}
            if self.state == "stopped" else None,
            "job": job and {
                "id": job["id"], "name": job["name"], "kind": job["kind"], "phase": "track",
                "done_s": time.time() - job["started_s"], "total_s": 900.0,
                "elapsed_s": time.time() - job["started_s"], "to_go_s": 1200.0,
            },
            "queue": sum(job["state"] == "queued" for job in self.jobs),
            "reading": row and {**row, "quality": "good"},
            "limits": {"temperature_degC": [10, 95], "current_A": 4.0}, "dead_man_s": 10.0,
            "instruments": {"controller": "Meerstetter TEC-1091 SN 1234", "meter": "Keithley 2000 SN 0812345"},
            "ticks": {"done": self.cycles, "missed": 0, "latest_s": 0.004, "unwatched_s": 0.21},
            "gaps": {"count": 2, "longest_s": 340.0, "total_s": 352.0}, "drive_unit": self.drive_unit,
            "memory_known": self.known, "viewers": len(self.viewers), "warnings": self.warnings,
            "stop_port": self.stop_port,
        }  # fmt: skip

    # what happens to it

    def send(self, kind: str, content: object) -> None:
        """One event to every viewer."""
        for viewer in self.viewers:
            viewer.put_nowait(f"event: {kind}\ndata: {json.dumps(content)}\n\n")

    def end(self, state: str, job_state: str, reason: str) -> None:
        """The output off and the running job ended."""
        self.state, self.output, self.rig.run_since_s = state, "off", None
        if job := self.job():
            job.update(state=job_state, reason=reason, ended_s=time.time(), report=f"/runs/{job['id']}/report.html")
            self.send("job", job)
        self.send("state", self.tell())

    def trip_now(self, cause: str = "over_temperature", text: str = "95.3 degC is above the limit of 95 degC") -> None:
        """A limit was passed."""
        self.trip = {"cause": cause, "text": text, "at_s": time.time(), "rows": 40}
        self.end("tripped", "tripped", cause)
        self.send("trip", self.trip)

    def clear(self) -> None:
        """What latched is cleared; the queue goes on."""
        self.state, self.trip = "idle", None
        self.next()

    def add_job(self, name: str, kind: str) -> dict[str, Any]:
        """Into the queue."""
        now_s = time.time()
        job = {"id": f"j{len(self.jobs) + 1}", "name": name, "kind": kind, "state": "queued", "queued_s": now_s,
               "started_s": None, "ended_s": None, "reason": None, "folder": None, "report": None}  # fmt: skip
        self.jobs.insert(0, job)
        self.next()
        self.send("job", job)
        return job

    def next(self) -> None:
        """Start the oldest job of the queue where nothing runs."""
        queued = [job for job in self.jobs if job["state"] == "queued"]
        if self.state == "idle" and queued:
            queued[-1].update(state="running", started_s=time.time())
            self.state, self.output, self.rig.run_since_s = "running", "on", time.time()
        self.send("state", self.tell())

    async def live(self) -> None:
        """Ten rows a second, and the state every two."""
        while True:
            self.cycles += 1
            if not self.rig.frozen:
                self.send("row", {**self.rig.step(time.time()), "quality": "good"})
            if self.cycles % 20 == 0:
                self.send("state", self.tell())
            await asyncio.sleep(PERIOD_S)

    # HTTP

    def refused(self, request: Request) -> Response | None:
        """Why a request is not served."""
        public = not request.url.path.startswith(("/api", "/runs")) or request.url.path == "/api/session"
        if self.token and not public:
            given = request.headers.get("authorization", "").removeprefix("Bearer ")
            if self.token not in (given, request.cookies.get("peltier")):
                return JSONResponse({"error": "a token is needed"}, 401)
        if request.method in ("POST", "DELETE"):
            right = (
                request.headers.get("content-type") == "application/json" and request.headers.get("x-peltier") == "1"
            )
            if not right or request.headers.get("origin", str(request.base_url).rstrip("/")) != str(
                request.base_url
            ).rstrip("/"):
                return JSONResponse({"error": "refused"}, 403)
        return None

    async def events(self, request: Request) -> Response:
        """The live stream."""
        queue: asyncio.Queue[str | None] = asyncio.Queue()

        async def body() -> AsyncIterator[str]:
            self.viewers.add(queue)
            try:
                yield f"event: state\ndata: {json.dumps(self.tell())}\n\n"
                while (event := await queue.get()) is not None:
                    yield event
            finally:
                self.viewers.discard(queue)

        return StreamingResponse(body(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})

    async def stop(self, request: Request) -> Response:
        """STOP: the moment is noted first."""
        self.stops.append(time.time())
        self.end("stopped", "stopped", "STOP was pressed")
        self.confirmed = True
        await asyncio.sleep(self.answers_stop_after_s)
        return JSONResponse({"off": True, "confirmed": True, "took_s": 0.004})

    async def reset(self, request: Request) -> Response:
        """A reason is needed, and something to reset."""
        reason = str((await request.json()).get("reason", "")).strip()
        if self.state not in ("tripped", "stopped"):
            return JSONResponse({"error": "nothing is latched"}, 409)
        if not reason:
            return JSONResponse({"error": "a reset needs a reason"}, 422)
        self.reset_reasons.append(reason)
        self.clear()
        return JSONResponse({})

    async def post_job(self, request: Request) -> Response:
        """A listed configuration, or TOML with its faults named."""
        body = await request.json()
        if body.get("configuration") in ("demo", "major loop"):
            return JSONResponse(self.add_job(body["configuration"], "track_resistance"), 201)
        if "hold_degC" in body:
            if not 10 < body["hold_degC"] < 95:
                return JSONResponse({"faults": ["hold_degC: expected a number between the bench's limits"]}, 422)
            return JSONResponse(self.add_job(f"hold {body['hold_degC']:g} degC", "hold"), 201)
        try:
            settings = tomllib.loads(body.get("text", ""))
        except tomllib.TOMLDecodeError as fault:
            return JSONResponse({"faults": [str(fault)]}, 422)
        faults = [f"{name}: is missing" for name in ("bench", "experiment") if name not in settings]
        if faults:
            return JSONResponse({"faults": faults}, 422)
        return JSONResponse(self.add_job(body["name"], settings["experiment"]["kind"]), 201)

    async def delete_job(self, request: Request) -> Response:
        """Out of the queue, or ended."""
        job = next(job for job in self.jobs if job["id"] == request.path_params["id"])
        if job["state"] == "running":
            self.end("idle", "stopped", "ended from the page")
            self.next()
        else:
            job.update(state="stopped", reason="taken out of the queue", ended_s=time.time())
            self.send("job", job)
            self.send("state", self.tell())
        return JSONResponse({})

    async def session(self, request: Request) -> Response:
        """A cookie for a token."""
        if (await request.json()).get("token") != self.token:
            return JSONResponse({"error": "wrong token"}, 401)
        answer = JSONResponse({})
        answer.set_cookie("peltier", self.token or "", httponly=True, samesite="strict")
        return answer

    async def get(self, request: Request) -> Response:
        """Everything that only reads."""
        what, query = request.path_params["what"], request.query_params
        if what == "history":
            return JSONResponse(self.rig.history(float(query["from"]), float(query["to"]), int(query["points"])))
        answers = {
            "state": self.tell,
            "loop": lambda: self.rig.loop(self.known),
            "jobs": lambda: self.jobs[:200],
            "configurations": lambda: [
                {"name": "demo", "kind": "track_resistance", "text": TEXT},
                {"name": "major loop", "kind": "calibration", "text": TEXT.replace("track_resistance", "calibration")},
            ],
        }
        return JSONResponse(answers[what]())

    def application(self) -> Starlette:
        """The routes, under the page's own policy."""

        async def report(request: Request) -> Response:
            return HTMLResponse("<h1>report</h1>")

        @contextlib.asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
            task = asyncio.create_task(self.live())
            yield
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

        def guarded(handler: Any) -> Any:
            async def wrapped(request: Request) -> Response:
                answer: Response = self.refused(request) or await handler(request)
                return answer

            return wrapped

        application = Starlette(
            lifespan=lifespan,
            routes=[
                Route("/api/events", guarded(self.events)),
                Route("/api/stop", guarded(self.stop), methods=["POST"]),
                Route("/api/reset", guarded(self.reset), methods=["POST"]),
                Route("/api/session", guarded(self.session), methods=["POST"]),
                Route("/api/jobs", guarded(self.post_job), methods=["POST"]),
                Route("/api/jobs/{id}", guarded(self.delete_job), methods=["DELETE"]),
                Route("/api/{what}", guarded(self.get)),
                Route("/runs/{id}/report.html", guarded(report)),
                Mount("/", StaticFiles(directory=STATIC, html=True)),
            ],
        )

        async def with_policy(scope: Any, receive: Any, send: Any) -> None:
            async def sending(message: Any) -> None:
                if message["type"] == "http.response.start":
                    more = f"; connect-src 'self' http://127.0.0.1:{self.stop_port}" if self.stop_port else ""
                    policy = (CONTENT_SECURITY_POLICY + more).encode()
                    message["headers"] = [*message["headers"], (b"content-security-policy", policy)]
                await send(message)

            await application(scope, receive, sending)

        return with_policy  # type: ignore[return-value]


class Server:
    """A bench served from a thread."""

    def __init__(self, bench: FakeBench, port: int = 0) -> None:
        settings = uvicorn.Config(bench.application(), log_level="warning", ws="none", timeout_graceful_shutdown=1)
        listener = socket.create_server(("127.0.0.1", port))
        self.bench = bench
        self._server = uvicorn.Server(settings)
        self._thread = threading.Thread(
            target=lambda: asyncio.run(serve_and_close(self._server, listener)), daemon=True
        )
        self._thread.start()
        deadline_s = time.monotonic() + 10
        while not self._server.started and time.monotonic() < deadline_s:
            time.sleep(0.01)
        self.port: int = self._server.servers[0].sockets[0].getsockname()[1]
        self.address = f"http://127.0.0.1:{self.port}/"

    def close(self) -> None:
        """End every stream, then the server."""
        self._server.should_exit = True
        for viewer in list(self.bench.viewers):
            self._server.servers[0].get_loop().call_soon_threadsafe(viewer.put_nowait, None)
        self._thread.join(10)

    def call(self, action: Any, *words: object) -> None:
        """Run something of the bench in the server's own thread."""
        done = threading.Event()

        def run() -> None:
            action(*words)
            done.set()

        self._server.servers[0].get_loop().call_soon_threadsafe(run)
        done.wait(5)


@contextlib.contextmanager
def served(bench: FakeBench | None = None, port: int = 0) -> Iterator[Server]:
    """A bench on a free port, closed at the end."""
    server = Server(bench or FakeBench(), port)
    try:
        yield server
    finally:
        server.close()


def show_some(bench: FakeBench) -> None:
    """A running bench with a past, to look at."""
    now_s = time.time()
    past = [
        ("film 7 overnight", "track_resistance", "done", None, 30_000, 3.3e4),
        ("film 7 minor loops", "calibration", "done", None, 5400, 9.1e4),
        ("film 6 fast", "track_resistance", "tripped", "over_temperature: 95.3 degC", 71, 1.8e5),
        ("film 6", "track_resistance", "failed", "meter does not answer", 322, 1.9e5),
        ("film 6", "calibration", "stopped", "STOP was pressed", 1212, 2.0e5),
    ]
    for k, (name, kind, state, reason, took_s, ago_s) in enumerate(past):
        bench.jobs.append({
            "id": f"p{k}", "name": name, "kind": kind, "state": state, "queued_s": now_s - ago_s,
            "started_s": now_s - ago_s, "ended_s": now_s - ago_s + took_s, "reason": reason, "folder": None,
            "report": f"/runs/p{k}/report.html",
        })  # fmt: skip
    bench.rig.backfill(420)
    running = bench.add_job("film 7 tracking", "track_resistance")
    running["started_s"] = now_s - 420
    bench.rig.run_since_s = now_s - 420
    bench.add_job("film 7 major loop", "calibration")
    bench.started_s = now_s - 9.4 * 86400


def main() -> None:
    """Serve until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=8765)
    parser.add_argument("--token")
    parser.add_argument("--running", action="store_true")
    options = parser.parse_args()
    bench = FakeBench(options.token)
    if options.running:
        show_some(bench)
    with served(bench, options.port) as server:
        print(server.address, flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()


if __name__ == "__main__":
    main()
