"""One web process: the page of a bench, or its STOP alone, until the bench process ends."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn

from rig.daemon.client import Client, NoDaemon, Refusal
from rig.daemon.web_process import listening
from rig.web.bench_link import BenchLink
from rig.web.server import CLOSES_S, PAGE_CONNECTIONS, STOP_CONNECTIONS, serve_and_close, server_of


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
    except (NoDaemon, Refusal) as error:
        print(f"peltier serve: page: {error}", file=sys.stderr)
        return 1
    link = BenchLink(place)
    most = PAGE_CONNECTIONS if listener is None else STOP_CONNECTIONS
    server = server_of(_application(link, settings, listener is not None), most)
    try:
        open_listener = listener or listening(settings["address"], settings["port"])
    except OSError:  # the bench process reports it, with the key
        return 1
    ending = asyncio.create_task(_end_with(link, server, end))
    await serve_and_close(server, open_listener, report if listener is None else None)
    ending.cancel()
    return 0 if server.started else 1


def _application(link: BenchLink, settings: dict[str, Any], stop_alone: bool) -> Any:
    """Return the application; STOP's process does not load what only the page's needs."""
    if stop_alone:
        from rig.web.forwarding import stop_application

        return stop_application(link, settings)
    from rig.web.app import application

    return application(link, settings)


async def _end_with(link: BenchLink, server: uvicorn.Server, end: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    end()
