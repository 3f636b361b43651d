"""`python -m rig.web.serving SOCKET [LISTENER]`: a web process, started by the bench process and ended with it.

It serves the page of a bench or, with LISTENER, the descriptor of a listening TCP socket, STOP and nothing else. STOP's
process has connections of its own: the page sends STOP to it and to its own address at once, and believes the first
answer; whoever exhausts the one has not exhausted the other. Everything that could delay STOP is in the page's process
alone: the history, viewers, files.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.daemon.client import Client, NoDaemon
from rig.daemon.client import Refusal as RefusedByBench
from rig.daemon.web_process import listening
from rig.web.bench_link import STOP, BenchLink, forward
from rig.web.page_server import Refusal, refused
from rig.web.protection import Names, Protection, Sessions
from rig.web.server import CLOSES_S, PAGE_CONNECTIONS, STOP_CONNECTIONS, serve_and_close, server_of

PREFLIGHT = {
    "Access-Control-Allow-Methods": "POST",
    "Access-Control-Allow-Headers": "authorization, content-type, x-peltier",
    "Access-Control-Max-Age": "7200",  # s, the longest that a browser remembers: the next STOP goes out at once
}
NICENESS = 5  # of the page's process: on a busy computer the bench's, STOP's and `peltier stop` go first


async def serve(
    place: Path, report: Callable[[str], None], end: Callable[[], None], listener: socket.socket | None = None
) -> int:
    """Serve the bench at a socket: its page, or with a listener STOP alone; return the exit status.

    report: takes the page's address once the page is there. end: called some time after the bench process has gone,
    whatever is still open then.
    """
    try:
        with Client(place) as client:
            settings = client.ask("GET", "/daemon")
    except (NoDaemon, RefusedByBench) as error:
        print(f"peltier serve: page: {error}", file=sys.stderr)
        return 1
    link = BenchLink(place)
    if listener is None:
        from rig.web.app import application  # not in STOP's process, which needs little of it

        server = server_of(application(link, settings), PAGE_CONNECTIONS)
    else:
        server = server_of(stop_application(link, settings), STOP_CONNECTIONS)
    try:
        open_listener = listener or listening(settings["address"], settings["port"])
    except OSError:  # the bench process reports it, with the key
        return 1
    ending = asyncio.create_task(_end_with(link, server, end))
    await serve_and_close(server, open_listener, report if listener is None else None)
    ending.cancel()
    return 0 if server.started else 1


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


async def _end_with(link: BenchLink, server: uvicorn.Server, end: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    end()


def main() -> int:
    """Serve as the command line says; return the exit status."""
    listener = socket.socket(fileno=int(sys.argv[2])) if len(sys.argv) > 2 else None
    if listener is None:
        os.nice(NICENESS)
    return asyncio.run(
        serve(Path(sys.argv[1]), lambda url: print(f"page {url}", flush=True), lambda: os._exit(0), listener)
    )


if __name__ == "__main__":
    sys.exit(main())
