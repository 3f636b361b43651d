"""`peltier overview` put together: one event loop that serves the page and asks the benches. Until a signal."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rig.overview.app import application
from rig.overview.configuration import Overview
from rig.web.serving import PAGE_CONNECTIONS, serve_and_close, server_of, tell_where


async def serve(content: Overview, told: Callable[[str], None]) -> int:
    """Serve the overview. told: given the page's address when it is there."""
    table = content.overview
    server = server_of(application(content), table.address, table.port, PAGE_CONNECTIONS)
    telling = asyncio.create_task(tell_where(server, told))
    await serve_and_close(server)
    telling.cancel()
    return 0 if server.started else 1
