"""`python -m rig.web.serving SOCKET [LISTENER]`: a web process, started by the bench process and ended with it.

It serves the page of a bench or, with LISTENER, the descriptor of a listening TCP socket, STOP and nothing else.
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

from rig.daemon.client import Client, NoDaemon, Refusal
from rig.daemon.web_process import listening
from rig.web.bench_link import BenchLink
from rig.web.server import CLOSES_S, PAGE_CONNECTIONS, STOP_CONNECTIONS, serve_and_close, server_of

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
