"""The end of a web process: no caller is left open that does not take its answer, and no process that just began."""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from rig.daemon.web_process import WebProcess
from rig.overview import Overview, serve
from rig.web.serving import serve_and_close, server_of

BENCH = {"name": "left", "address": "http://127.0.0.1:8765"}
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
        server = server_of(long_answer, 5)
        thread = threading.Thread(target=lambda: asyncio.run(serve_and_close(server, listener)))
        thread.start()
        caller.connect(listener.getsockname())
        caller.sendall(b"GET / HTTP/1.1\r\nHost: bench\r\n\r\n")
        while not server.server_state.total_requests and thread.is_alive():
            time.sleep(0.01)
        server.should_exit = True
        thread.join()
        assert not server.server_state.connections


def test_a_web_process_that_is_being_begun_at_the_end_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look whether it is to end and the process there is time for `stop`."""
    asked, go_on = threading.Event(), threading.Event()
    begun: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def late(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        asked.set()
        go_on.wait()
        begun.append(popen([sys.executable, "-c", "import time; time.sleep(600)"], **options))
        return begun[0]

    monkeypatch.setattr(subprocess, "Popen", late)
    web = WebProcess(Path("bench.sock"), lambda line: None, ("127.0.0.1", 0))
    web.start()
    asked.wait()
    stop = threading.Thread(target=web.stop)
    stop.start()
    stop.join(0.2)  # long enough to find no process, if it does not wait for the one to come
    go_on.set()
    stop.join()
    try:
        assert len(begun) == 1
        assert begun[0].returncode is not None
    finally:
        for process in begun:
            process.kill()
            process.wait()


def test_a_page_whose_address_is_taken_says_so(tmp_path: Path) -> None:
    said: list[str] = []
    told = threading.Event()

    def note(line: str) -> None:
        said.append(line)
        told.set()

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        web = WebProcess(tmp_path / "no bench there", note, ("127.0.0.1", port))
        web.start()
        assert told.wait(30.0)
        web.stop()
    assert said[0].startswith(
        f"the page cannot be served: 127.0.0.1:{port} (serve.address, serve.port): Address already in use"
    )


def test_an_overview_whose_address_is_taken_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """No bench process tells it for this one."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        content = Overview.model_validate({"overview": {"port": port}, "bench": [BENCH]})
        assert asyncio.run(serve(content, print)) == 1
    why = "Address already in use (overview.address, overview.port)"
    assert capsys.readouterr().err == f"peltier overview: there is no page at 127.0.0.1:{port}: {why}\n"
