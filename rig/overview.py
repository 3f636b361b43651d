"""One page for several bench daemons: a process of its own that holds their tokens, with a STOP for each.

    [overview]
    port = 8780
    token = "..."                        # asked for wherever it is set; needed beyond the loopback
    [[bench]]
    name = "left"
    address = "http://127.0.0.1:8765"    # of the bench's page
    token = "..."                        # the bench's own serve.token, where it has one

Each bench is asked for its state about once a second, in a task of its own, so that one that does not answer holds up
no other. A request has a time limit for all of it.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import secrets
import ssl
import sys
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, SecretStr, model_validator
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Mount, Route

from rig.config.schema import HostName, Table, validate
from rig.config.toml_file import parsed_toml, read_text
from rig.core.faults import fault
from rig.daemon.announcer import sent_event
from rig.daemon.client import Refusal
from rig.daemon.web_process import listening, why_not
from rig.version import __version__
from rig.web.page_server import (
    LONGEST_NAME,
    OVERVIEW,
    PAGE_CONNECTIONS,
    STATIC,
    PageFiles,
    Viewer,
    begin_session,
    events_reply,
    exchange,
    json_reply,
    object_in,
    refusal_reply,
    refused,
    running,
    serve_and_close,
    server_of,
)
from rig.web.protection import LOOPBACK, Names, Protection, Sessions

MOST_BENCHES = 200  # on one page: beyond that nobody looks at all of them


def _page_address(text: str) -> str:
    expected = "expected the address of a bench's page, as in http://10.0.0.7:8765"
    if not re.fullmatch(r"https?://([A-Za-z0-9._-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?/?", text):
        raise ValueError(expected)
    try:
        urlsplit(text).port  # noqa: B018 - it is read when it is asked for, and may be too large
    except ValueError:
        raise ValueError(expected) from None
    return text.rstrip("/")


class BenchTable(Table):
    """[[bench]]: a bench as the overview reaches it."""

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]{1,40}$")
    address: Annotated[str, AfterValidator(_page_address)]
    token: Annotated[SecretStr, Field(min_length=16)] | None = None


class OverviewTable(Table):
    """[overview]: its page; the keys mean what they mean in [serve]."""

    address: str = "127.0.0.1"
    port: int = Field(default=8780, ge=0, le=65535)
    token: Annotated[SecretStr, Field(min_length=16)] | None = None
    hosts: list[HostName] = []


class Overview(Table):
    """The whole file."""

    overview: OverviewTable = OverviewTable()
    bench: list[BenchTable] = Field(min_length=1, max_length=MOST_BENCHES)

    @model_validator(mode="before")
    @classmethod
    def _named_once(cls, data: Any) -> Any:
        tables = data.get("bench") if isinstance(data, dict) else None
        names = [table.get("name") for table in tables if isinstance(table, dict)] if isinstance(tables, list) else []
        twice = sorted({str(name) for name in names if name is not None and names.count(name) > 1})
        if twice:
            raise ValueError(f"bench.name: {', '.join(twice)}: expected each name once")
        return data


def read_overview(path: Path) -> Overview:
    """Read and check the overview's configuration. Raises Faults."""
    content = validate(Overview, parsed_toml(read_text(path), path), path)
    table = content.overview
    if table.address not in LOOPBACK and table.token is None:
        text = f"missing; address {table.address} is not the loopback: expected a token"
        raise fault(path, "overview.token", text)
    return content


LARGEST = 2_000_000  # bytes of an answer; a state takes two thousand
# A bench that falls silent right after an answer is asked again a second later, and shown as silent when that has had
# no answer for as long as stands here: 2.5 s in all.
PERIOD_S, ANSWER_S = 1.0, 1.5
STOP_S = 15.5  # a bench waits 15 s for its instruments
SHOWN = ("state", "output", "output_confirmed", "trip", "stop", "job", "queue", "reading", "limits", "drive_unit")
SHOWN_TOO = ("time_s", "ticks", "warnings", "version")


class Unanswered(Exception):
    """A bench gave no answer, or none that can be read."""


class Place(NamedTuple):
    """Address at which a bench listens. secure: None for plain HTTP."""

    host: str
    port: int
    secure: ssl.SSLContext | None


async def asked(place: Place, method: str, path: str, token: str | None, body: Any, within_s: float) -> tuple[int, Any]:
    """Send a request; return status and JSON. Raises Unanswered."""
    host = f"[{place.host}]" if ":" in place.host else place.host
    headers = {"Host": f"{host}:{place.port}", "Accept": "application/json"}
    if method != "GET":
        headers |= {"Content-Type": "application/json", "X-Peltier": "1"}
    if token is not None:
        headers["Authorization"] = f"Bearer {token}"
    content = b"" if method == "GET" else json.dumps(body).encode()
    try:
        async with asyncio.timeout(within_s):
            connecting = asyncio.open_connection(place.host, place.port, ssl=place.secure)
            status, found = await exchange(connecting, method, path, headers, content, LARGEST)
        return status, json.loads(found) if found else None
    except TimeoutError:
        raise Unanswered(f"no answer within {within_s:g} s") from None
    except OSError as error:  # asyncio's own text leaves out the cause
        known = error.errno is not None and error.errno > 0
        cause = os.strerror(error.errno or 0).lower() if known else error.strerror or str(error) or type(error).__name__
        raise Unanswered(cause) from None
    except (ValueError, RecursionError) as error:
        raise Unanswered(f"what answers there is no bench: {error}") from None


_kept: set[asyncio.Future[Any]] = set()  # what nobody holds may be collected before it has ended


async def first_success(*ways: Any) -> tuple[int, Any]:
    """Return the first success among the answers of several requests, else the last refusal. Raises Unanswered.

    The others are left to end by themselves: each of them is a STOP that may still be needed.
    """
    tasks = [asyncio.ensure_future(way) for way in ways]
    every = asyncio.gather(*tasks, return_exceptions=True)
    _kept.add(every)
    every.add_done_callback(_kept.discard)
    refused: tuple[int, Any] | None = None
    silent = Unanswered("nowhere to ask")
    for done in asyncio.as_completed(tasks):
        try:
            status, answer = await done
        except Unanswered as error:
            silent = error
            continue
        if status == 200:
            return status, answer
        refused = status, answer
    if refused is None:
        raise silent
    return refused


class Bench:
    """State of one bench, and its STOP. changed: called when the state may have changed."""

    def __init__(self, table: BenchTable, changed: Callable[[], None]) -> None:
        self.name, self.address = table.name, table.address
        self._token = table.token.get_secret_value() if table.token is not None else None
        parts = urlsplit(table.address)
        secure = ssl.create_default_context() if parts.scheme == "https" else None
        self._place = Place(str(parts.hostname), parts.port or (443 if secure else 80), secure)
        self._changed = changed
        self._state: dict[str, Any] = {}
        self._stop_port: int | None = None
        self._heard_s: float | None = None  # time.monotonic()
        self._trouble: str | None = "not asked yet"

    async def watch(self) -> None:
        while True:
            began_s = time.monotonic()
            await self._look()
            self._changed()
            await asyncio.sleep(max(0.0, began_s + PERIOD_S - time.monotonic()))

    async def _look(self) -> None:
        try:
            status, answer = await asked(self._place, "GET", "/api/state", self._token, None, ANSWER_S)
        except Unanswered as error:
            self._trouble = str(error)
            return
        if status != 200 or not isinstance(answer, dict):
            self._trouble = _in_words(status, answer)
            return
        self._state = {key: answer.get(key) for key in SHOWN + SHOWN_TOO}
        port = answer.get("stop_port")
        self._stop_port = port if isinstance(port, int) else None
        self._heard_s, self._trouble = time.monotonic(), None

    def shown(self) -> dict[str, Any]:
        """Return the bench for the page. state: the last one known, None before the first; trouble: None while it
        answers."""
        silent_s = None if self._heard_s is None else time.monotonic() - self._heard_s
        known = {"name": self.name, "address": self.address, "trouble": self._trouble, "silent_s": silent_s}
        return {**known, "state": self._state or None}

    async def stop(self, press: str) -> tuple[int, Any]:
        """Send STOP to the bench's page and to STOP's own listener at once; the first success counts. Raises
        Unanswered."""
        body = {"press": press}
        places = [self._place]
        if self._stop_port is not None and self._place.secure is None:  # behind a proxy the page's address has to do
            places.append(self._place._replace(port=self._stop_port))
        ways = [asked(place, "POST", "/api/stop", self._token, body, STOP_S) for place in places]
        return await first_success(*ways)


def _in_words(status: int, answer: Any) -> str:
    """Return in words what a bench answered in place of its state."""
    if status == 401:
        return "the bench does not take the token of this overview"
    faults = answer.get("faults") if isinstance(answer, dict) else None
    return "; ".join(map(str, faults))[:300] if isinstance(faults, list) and faults else f"the bench answers {status}"


TOGETHER_S = 0.25  # what changes within this goes out together
NO_ANSWER = 502


class Benches:
    """State of all benches; the methods are the endpoints."""

    def __init__(self, content: Overview) -> None:
        self._changed = asyncio.Event()
        self._benches = {table.name: Bench(table, self._changed.set) for table in content.bench}
        self._viewers: set[Viewer] = set()

    def current(self) -> dict[str, Any]:
        """Return all benches at this moment, in the order of the configuration."""
        benches = [bench.shown() for bench in self._benches.values()]
        return {"time_s": time.time(), "version": __version__, "benches": benches}

    async def state(self, request: Request) -> Response:
        return json_reply(self.current())

    async def events(self, request: Request) -> Response:
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

    def watched(self, app: Starlette) -> AbstractAsyncContextManager[None]:
        """Ask every bench, and send changes to every viewer, meanwhile."""
        return running(self._send_changes(), *(bench.watch() for bench in self._benches.values()))

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
    """Return the web application of a configuration."""
    table = content.overview
    sessions = Sessions(table.token.get_secret_value() if table.token is not None else None)
    benches = Benches(content)
    routes: list[Route | Mount] = [
        Route("/api/state", benches.state),
        Route("/api/events", benches.events),
        Route("/api/stop", benches.stop, methods=["POST"]),
        Route("/api/session", partial(begin_session, sessions=sessions), methods=["POST"]),
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
