"""`python -m rig.web.serving SOCKET LISTENER page|stop`: a web process, started by the bench process, ended with it.

LISTENER is the descriptor of a listening TCP socket. It serves the page of a bench, or STOP and nothing else. STOP's
process has connections of its own: the page sends STOP to it and to its own address at once, and believes the first
answer; whoever exhausts the one has not exhausted the other. Everything that could delay STOP is in the page's process
alone: the history, viewers, files.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.daemon.client import Client, NoDaemon, Refusal
from rig.web.bench_link import STOP, BenchLink, forward
from rig.web.page_server import (
    CLOSES_S,
    PAGE_CONNECTIONS,
    STOP_CONNECTIONS,
    refused,
    running,
    serve_and_close,
    server_of,
)
from rig.web.protection import Names, Protection, Sessions

PREFLIGHT = {
    "Access-Control-Allow-Methods": "POST",
    "Access-Control-Allow-Headers": "authorization, content-type, x-peltier",
    "Access-Control-Max-Age": "7200",  # s, the longest that a browser remembers: the next STOP goes out at once
}
NICENESS = 5  # of the page's process: on a busy computer the bench's, STOP's and `peltier stop` go first


async def serve(
    place: Path, listener: socket.socket, report: Callable[[str], None] | None, end: Callable[[], None]
) -> int:
    """Serve the bench at a socket: its page, or STOP alone; return the exit status.

    report: takes the page's address once the page is there; None for STOP alone. end: called some time after the bench
    process has gone, whatever is still open then.
    """
    try:
        with Client(place) as client:
            settings = client.ask("GET", "/daemon")
    except (NoDaemon, Refusal) as error:
        print(f"peltier serve: page: {error}", file=sys.stderr)
        return 1
    link = BenchLink(place)
    if report is not None:
        from rig.web.app import application  # not in STOP's process, which needs little of it

        server = server_of(application(link, settings), PAGE_CONNECTIONS)
    else:
        server = server_of(stop_application(link, settings), STOP_CONNECTIONS)
    ending = asyncio.create_task(_end_with(link, server, end))
    await serve_and_close(server, listener, report)
    ending.cancel()
    return 0 if server.started else 1


def stop_application(link: BenchLink, settings: dict[str, Any]) -> Starlette:
    """Return the application of STOP's listener. settings: the bench process's [serve]."""

    async def stop(request: Request) -> Response:
        if request.method == "OPTIONS":
            return Response(status_code=204, headers=PREFLIGHT)
        return await forward(link, request)

    names = Names(settings["address"], settings["hosts"], page_port=settings["port"])
    protection = Middleware(Protection, names=names, sessions=Sessions(settings["token"]), elsewhere=True)
    return Starlette(
        routes=[Route(STOP, stop, methods=["POST", "OPTIONS"])],
        middleware=[protection],
        lifespan=lambda app: running(link.follow()),
        exception_handlers={Refusal: refused, HTTPException: refused},
    )


async def _end_with(link: BenchLink, server: uvicorn.Server, end: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    end()


def main() -> int:
    """Serve as the command line says; return the exit status."""
    place, descriptor, what = sys.argv[1:]
    report: Callable[[str], None] | None = None
    if what == "page":
        os.nice(NICENESS)
        report = lambda url: print(f"page {url}", flush=True)  # noqa: E731
    return asyncio.run(serve(Path(place), socket.socket(fileno=int(descriptor)), report, lambda: os._exit(0)))


if __name__ == "__main__":
    sys.exit(main())
