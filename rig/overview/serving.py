"""`peltier overview` put together: one event loop that serves the page and asks the benches. Until a signal."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rig.daemon.web_process import listening, why_not
from rig.overview.app import application
from rig.overview.configuration import Overview
from rig.web.server import PAGE_CONNECTIONS, serve_and_close, server_of


async def serve(content: Overview, told: Callable[[str], None]) -> int:
    """Serve the overview; 1 where its address cannot be had. told: given that address when the page is there."""
    table = content.overview
    server = server_of(application(content), PAGE_CONNECTIONS)
    try:
        listener = listening(table.address, table.port)
    except OSError as error:
        why = f"{table.address}:{table.port}: {why_not(error)} (overview.address, overview.port)"
        print(f"peltier overview: there is no page at {why}", file=sys.stderr)
        return 1
    await serve_and_close(server, listener, told)
    return 0 if server.started else 1
