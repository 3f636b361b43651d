"""STOP's own listener: POST /api/stop and nothing else, in a process with connections of its own.

The page sends STOP here and to its own address at once, and believes the first answer. Whoever exhausts the one has not
exhausted the other. What is kept from the page's process is what could hold STOP up: the history, viewers, files.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.web.bench_link import BenchLink
from rig.web.names import Names
from rig.web.protection import Protection, Sessions
from rig.web.replies import Refusal, refused, stopped

PREFLIGHT = {
    "Access-Control-Allow-Methods": "POST",
    "Access-Control-Allow-Headers": "authorization, content-type, x-peltier",
    "Access-Control-Max-Age": "7200",  # s, the longest that a browser remembers: the next STOP goes out at once
}


def stop_application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """settings: what the bench process tells of [serve]."""

    async def stop(request: Request) -> Response:
        if request.method == "OPTIONS":
            return Response(status_code=204, headers=PREFLIGHT)
        return await stopped(link, request)

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        async with link.living(link.follow()):
            yield

    names = Names(settings["address"], settings["hosts"], page_port=settings["port"])
    protection = Middleware(Protection, names=names, sessions=Sessions(settings["token"]), elsewhere=True)
    return Starlette(
        routes=[Route("/api/stop", stop, methods=["POST", "OPTIONS"])],
        middleware=[protection],
        lifespan=lifespan,
        exception_handlers={Refusal: refused, HTTPException: refused},
    )
