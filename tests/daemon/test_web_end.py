"""The end of a web process: a caller that does not take its answer is not left open."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from typing import Any

from rig.web.serving import serve_and_close, server_of

MORE_THAN_A_KERNEL_KEEPS = 20_000_000  # bytes; Linux holds some megabytes of an answer between two sockets


async def long_answer(scope: Any, receive: Any, send: Any) -> None:
    """An application with one long answer."""
    if scope["type"] == "lifespan":
        while (message := await receive())["type"] != "lifespan.shutdown":
            await send({"type": message["type"] + ".complete"})
        await send({"type": "lifespan.shutdown.complete"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": bytes(MORE_THAN_A_KERNEL_KEEPS)})


def test_a_caller_that_takes_no_answer_is_closed_at_the_end() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.socket() as caller:
        server = server_of(long_answer, "127.0.0.1", 0, 5)
        thread = threading.Thread(target=lambda: asyncio.run(serve_and_close(server, [listener])))
        thread.start()
        caller.connect(listener.getsockname())
        caller.sendall(b"GET / HTTP/1.1\r\nHost: bench\r\n\r\n")
        while not server.server_state.total_requests and thread.is_alive():
            time.sleep(0.01)
        server.should_exit = True
        thread.join()
        assert not server.server_state.connections
