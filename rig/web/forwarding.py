"""Requests forwarded to the bench process, and STOP's own listener: POST /api/stop and nothing else.

STOP's listener is a process with connections of its own. The page sends STOP to it and to its own address at once, and
believes the first answer; whoever exhausts the one has not exhausted the other. Everything that could delay STOP is in
the page's process alone: the history, viewers, files.
"""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import AsyncIterator
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.daemon.announcer import encoded
from rig.web.bench_link import STOP, BenchGone, BenchLink
from rig.web.page_server import LONGEST_NAME, Refusal, body_of, object_in, refused
from rig.web.protection import Names, Protection, Sessions

JOBS = "/api/jobs"
OF_A_JOB = ("configuration", "text", "name", "kind", "hold_degC", "hold_s")  # no files of the bench's computer
PREFLIGHT = {
    "Access-Control-Allow-Methods": "POST",
    "Access-Control-Allow-Headers": "authorization, content-type, x-peltier",
    "Access-Control-Max-Age": "7200",  # s, the longest that a browser remembers: the next STOP goes out at once
}


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
    except BenchGone as error:
        raise Refusal(503, str(error)) from None
    return Response(answer, status, media_type="application/json")


async def _press(request: Request) -> str:
    """Return the name of this press of STOP, or a new one; a STOP is taken whatever its body is."""
    try:
        press = (await object_in(request)).get("press")
    except Refusal:
        press = None
    return press[:LONGEST_NAME] if isinstance(press, str) else secrets.token_hex(8)


def stop_application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """Return the application of STOP's listener. settings: the bench process's [serve]."""

    async def stop(request: Request) -> Response:
        if request.method == "OPTIONS":
            return Response(status_code=204, headers=PREFLIGHT)
        return await forward(link, request)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with link.living(link.follow()):
            yield

    names = Names(settings["address"], settings["hosts"], page_port=settings["port"])
    protection = Middleware(Protection, names=names, sessions=Sessions(settings["token"]), elsewhere=True)
    return Starlette(
        routes=[Route(STOP, stop, methods=["POST", "OPTIONS"])],
        middleware=[protection],
        lifespan=lifespan,
        exception_handlers={Refusal: refused, HTTPException: refused},
    )
