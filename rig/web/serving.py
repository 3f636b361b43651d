"""A web process's own loop: serve until the bench process ends."""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn

from rig.daemon.client import Client, NoDaemon
from rig.daemon.listening import listening
from rig.web.bench_link import BenchLink
from rig.web.connections import bounded
from rig.web.few_lines import quieten

CLOSES_S = 1  # for open connections; no safety waits for it
PAGE_CONNECTIONS = 500  # half of the descriptors that a process has by default
STOP_CONNECTIONS = 100  # nobody needs one for longer than a moment
LONGEST_HEAD = 64_000  # bytes


async def serve(
    place: Path, told: Callable[[str], None], ends: Callable[[], None], listener: socket.socket | None = None
) -> int:
    """Serve the bench at a socket: its page, or with a listener STOP alone. told: given the page's address when it is
    there. ends: called some time after the bench process has gone, whatever is still open then."""
    try:
        with Client(place) as client:
            settings = client.ask("web")
    except NoDaemon as error:
        print(f"peltier serve: page: {error}", file=sys.stderr)
        return 1
    link = BenchLink(place)
    most = PAGE_CONNECTIONS if listener is None else STOP_CONNECTIONS
    application = _application(link, settings, listener is not None)
    server = server_of(application, most)
    try:
        door = listener or listening(settings["address"], settings["port"])
    except OSError:  # the bench process tells it, with the key
        return 1
    ending = asyncio.create_task(_end_with(link, server, ends))
    await serve_and_close(server, door, told if listener is None else None)
    ending.cancel()
    return 0 if server.started else 1


def _application(link: BenchLink, settings: dict[str, Any], stop_alone: bool) -> Any:
    """STOP's process does not load what the page's needs."""
    if stop_alone:
        from rig.web.stop_door import stop_application

        return stop_application(link, settings)
    from rig.web.app import application

    return application(link, settings)


def server_of(application: Any, most: int) -> uvicorn.Server:
    """A server with bounds on all that callers can make it keep. most: connections at a time."""
    config = uvicorn.Config(
        application,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=CLOSES_S,
        http=bounded(most),
        ws="none",
        backlog=256,
        h11_max_incomplete_event_size=LONGEST_HEAD,
    )
    quieten()
    return uvicorn.Server(config)


async def serve_and_close(
    server: uvicorn.Server, listener: socket.socket, told: Callable[[str], None] | None = None
) -> None:
    """Serve until the server is told to end. told: given the page's address when it is there. What a caller still has
    open after uvicorn's grace, uvicorn leaves to the interpreter's end; here it is closed."""
    telling = asyncio.create_task(_tell_where(server, listener, told)) if told is not None else None
    await server.serve([listener])
    if telling is not None:
        telling.cancel()
    for connection in list(server.server_state.connections):
        connection.transport.abort()
    await asyncio.sleep(0)  # each one's end is told in the event loop's next turn


async def _tell_where(server: uvicorn.Server, listener: socket.socket, told: Callable[[str], None]) -> None:
    """Tell the page's address as soon as it is there."""
    address, port = listener.getsockname()[:2]
    while not server.started:
        await asyncio.sleep(0.02)
    told(f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/")


async def _end_with(link: BenchLink, server: uvicorn.Server, ends: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    ends()
