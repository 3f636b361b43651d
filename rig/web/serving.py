"""The web process's own loop: serve until the bench process ends."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path

import uvicorn

from rig.daemon.client import Client, NoDaemon
from rig.web.app import application
from rig.web.bench_link import BenchLink

CLOSES_S = 1  # for open connections; no safety waits for it


async def serve(socket: Path, told: Callable[[str], None], ends: Callable[[], None]) -> int:
    """Serve the bench at a socket. told: given the page's address when it is there. ends: called some time after the
    bench process has gone, whatever is still open then."""
    try:
        with Client(socket) as client:
            settings = client.ask("web")
    except NoDaemon as error:
        print(f"peltier serve: page: {error}", file=sys.stderr)
        return 1
    link = BenchLink(socket)
    config = uvicorn.Config(
        application(link, settings),
        host=settings["address"],
        port=settings["port"],
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=CLOSES_S,
        limit_concurrency=1000,
        h11_max_incomplete_event_size=64_000,
    )
    server = uvicorn.Server(config)
    telling = asyncio.create_task(_tell_where(server, told))
    ending = asyncio.create_task(_end_with(link, server, ends))
    await server.serve()
    telling.cancel()
    ending.cancel()
    return 0 if server.started else 1


async def _tell_where(server: uvicorn.Server, told: Callable[[str], None]) -> None:
    while not server.started:
        await asyncio.sleep(0.02)
    for listening in server.servers:
        for socket in listening.sockets:
            address, port = socket.getsockname()[:2]
            told(f"http://[{address}]:{port}/" if ":" in address else f"http://{address}:{port}/")


async def _end_with(link: BenchLink, server: uvicorn.Server, ends: Callable[[], None]) -> None:
    await link.gone.wait()
    server.should_exit = True
    await asyncio.sleep(CLOSES_S + 0.5)
    ends()
