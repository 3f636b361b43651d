"""The web process's connection to the bench process: requests forwarded, events fanned out to viewers."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from rig.daemon.announcer import encoded, sent_event
from rig.daemon.client import FAILED, NoDaemon, Refusal
from rig.web.page_server import LONGEST_NAME, Viewer, body_of, exchange, object_in

ANSWER_S = 15.0  # a STOP that waits for a dead man's silence takes longest
ROWS_A_SECOND = 10
STATE_EVERY_S = 5.0  # the longest time between two events for a viewer
LONGEST_LINE = 4_000_000  # bytes of an event
MOST_REQUESTS = 16  # at a time; a STOP does not wait for its turn
STOP, JOBS = "/api/stop", "/api/jobs"
OF_A_JOB = ("configuration", "text", "name", "kind", "hold_degC", "hold_s")  # no files of the bench's computer
INSISTS_S, AGAIN_S = 5.0, 0.02  # a STOP is sent anew while the bench process has no room for a connection


class BenchLink:
    """Connected to the bench process's socket; `gone` is set when that has ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.viewers: set[Viewer] = set()
        self.state: dict[str, Any] = {}
        self.row: dict[str, Any] = {}
        self.rows = 0
        self.gone = asyncio.Event()
        self._sent_s: deque[float] = deque(maxlen=ROWS_A_SECOND)
        self._state_sent_s = 0.0
        self._turns = asyncio.Semaphore(MOST_REQUESTS)

    async def request(self, method: str, path: str, body: bytes = b"", caller: str | None = None) -> tuple[int, bytes]:
        """Return status and body of the bench process's answer. Raises NoDaemon.

        caller: who asks the page; None if the page itself does. A STOP without an answer is sent anew for some seconds,
        with the same body: its `press` makes it one STOP.
        """
        headers = {"X-Peltier-For": caller} if caller is not None else {}
        until_s = time.monotonic() + (INSISTS_S if path == STOP else 0.0)
        while True:
            try:
                async with asyncio.timeout(ANSWER_S):
                    async with contextlib.nullcontext() if path == STOP else self._turns:
                        connecting = asyncio.open_unix_connection(str(self.path))
                        return await exchange(connecting, method, path, headers, body)
            except (OSError, ValueError) as error:  # TimeoutError is an OSError
                if time.monotonic() >= until_s or self.gone.is_set():
                    why = str(error) or type(error).__name__
                    raise NoDaemon(f"the bench process does not answer: {why}") from None
            await asyncio.sleep(AGAIN_S)

    async def get(self, path: str) -> Any:
        """Return the answer to a question. Raises NoDaemon, or Refusal with the bench process's status and faults."""
        status, content = await self.request("GET", path)
        try:
            answer = json.loads(content)
        except ValueError as error:
            raise NoDaemon(f"the bench process's answer is no JSON: {error}") from None
        if status >= FAILED:
            raise Refusal(status, answer["faults"])
        return answer

    async def follow(self) -> None:
        """Pass on the events until the bench process ends."""
        try:
            reader, writer = await asyncio.open_unix_connection(str(self.path), limit=LONGEST_LINE)
            with contextlib.closing(writer):
                writer.write(b"GET /api/events HTTP/1.0\r\n\r\n")
                status = int((await reader.readline()).split()[1])
                if status >= FAILED:  # this process ends, and is started again
                    print(f"peltier serve: page: events are refused (HTTP status {status})", file=sys.stderr)
                    return
                name = ""
                while line := (await reader.readline()).decode():
                    word, _, text = line.rstrip("\n").partition(": ")
                    if word == "event":
                        name = text
                    elif word == "data":
                        self._pass_on(name, json.loads(text))
        except (OSError, ValueError, IndexError):
            pass
        finally:
            self.gone.set()
            self.state = {**self.state, "state": "offline", "output": "unknown", "output_confirmed": False}
            self._send_to_viewers("state", self.current())

    def _pass_on(self, event: str, data: dict[str, Any]) -> None:
        if event == "state":
            self.state = data
            data = self.current()
            self._state_sent_s = time.monotonic()
        elif event == "row":
            self.row, self.rows = data, self.rows + 1
            now_s = time.monotonic()
            if len(self._sent_s) == ROWS_A_SECOND and now_s - self._sent_s[0] < 0.95:
                return
            self._sent_s.append(now_s)
        self._send_to_viewers(event, data)

    def _send_to_viewers(self, event: str, data: dict[str, Any]) -> None:
        if self.viewers:
            content = sent_event(event, data)
            for viewer in self.viewers:
                viewer.put(event, content)

    async def send_states(self) -> None:
        """Send the state at least every few seconds, until the bench process ends."""
        while not self.gone.is_set():
            await asyncio.sleep(1.0)
            if time.monotonic() - self._state_sent_s >= STATE_EVERY_S - 1.0:
                with contextlib.suppress(NoDaemon, Refusal):  # viewers get the last one again
                    self.state = await self.get("/api/state")
                self._state_sent_s = time.monotonic()
                self._send_to_viewers("state", self.current())

    def current(self) -> dict[str, Any]:
        return {**self.state, "viewers": len(self.viewers)}


async def forward(link: BenchLink, request: Request) -> Response:
    """Return the bench process's answer to a request. Raises Refusal if it does not answer."""
    path = request.scope["raw_path"].decode("ascii", "replace")
    if request.scope["path"] == STOP:  # by which it was routed, percent signs resolved
        path, body = STOP, encoded({"press": await _press(request)})
    elif (request.method, request.scope["path"]) == ("POST", JOBS):
        body = encoded({key: value for key, value in (await object_in(request)).items() if key in OF_A_JOB})
    else:
        body = await body_of(request)
    caller = request.client.host[:LONGEST_NAME] if request.client is not None else "somewhere"
    try:
        method = "GET" if request.method == "HEAD" else request.method  # uvicorn leaves the body out
        status, answer = await link.request(method, path, body, f"the page ({caller})")
    except NoDaemon as error:
        raise Refusal(503, [str(error)]) from None
    return Response(answer, status, media_type="application/json")


async def _press(request: Request) -> str:
    """Return the name of this press of STOP, or a new one; a STOP is taken whatever its body is."""
    try:
        press = (await object_in(request)).get("press")
    except Refusal:
        press = None
    return press[:LONGEST_NAME] if isinstance(press, str) else secrets.token_hex(8)
