"""A web process's own loop: serve until the bench process ends."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import uvicorn

from rig.daemon.client import Client, NoDaemon
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
    server = server_of(application, settings["address"], settings["port"], most)
    logging.getLogger("uvicorn.error").addFilter(_not_told_by_the_bench)
    telling = asyncio.create_task(tell_where(server, told)) if listener is None else None
    ending = asyncio.create_task(_end_with(link, server, ends))
    await serve_and_close(server, [listener] if listener is not None else None)
    if telling is not None:
        telling.cancel()
    ending.cancel()
    return 0 if server.started else 1


def _not_told_by_the_bench(record: logging.LogRecord) -> bool:
    """Of an address that cannot be had the bench process tells, with the key that says it."""
    return not isinstance(record.msg, OSError)


def _application(link: BenchLink, settings: dict[str, Any], stop_alone: bool) -> Any:
    """STOP's process does not load what the page's needs."""
    if stop_alone:
        from rig.web.stop_door import stop_application

        return stop_application(link, settings)
    from rig.web.app import application

    return application(link, settings)


def server_of(application: Any, address: str, port: int, most: int) -> uvicorn.Server:
    """A server with bounds on all that callers can make it keep. most: connections at a time."""
    config = uvicorn.Config(
        application,
        host=address,
        port=port,
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


async def serve_and_close(server: uvicorn.Server, listeners: list[socket.socket] | None = None) -> None:
    """Serve until the server is told to end. What a caller still has open after uvicorn's grace, uvicorn leaves to the
    interpreter's end; here it is closed."""
    await server.serve(listeners)
    for connection in list(server.server_state.connections):
        connection.transport.abort()
    await asyncio.sleep(0)  # each one's end is told in the event loop's next turn


async def tell_where(server: uvicorn.Server, told: Callable[[str], None]) -> None:
    """Tell the page's address as soon as it is there."""
    while not server.started:
        await asyncio.sleep(0.02)
    for listening in server.servers:
        for one in listening.sockets:
            address, port = one.getsockname()[:2]
            told(f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/")


async def _end_with(link: BenchLink, server: uvicorn.Server, ends: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    ends()
