"""The page's process and the bench process: what is forwarded, as whose, and what a refusal becomes."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from starlette.requests import Request

from rig.daemon.client import Refusal
from rig.daemon.http_server import UnixServer
from rig.web.bench_link import STOP, BenchLink, forward

Asked = tuple[str, str, dict[str, Any], str | None]


class Noting:
    """Notes what is asked, and has no state to give."""

    def __init__(self) -> None:
        self.asked: list[Asked] = []

    def answer(self, method: str, path: str, body: dict[str, Any], remote: str | None) -> tuple[int, Any]:
        self.asked.append((method, path, body, remote))
        if path == "/api/state":
            raise RuntimeError("broken")
        return 200, {"confirmed": True}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Noting]:
    """A bench process at bench.sock."""
    noting, server = Noting(), UnixServer(tmp_path / "bench.sock")
    server.start(cast(Any, noting))
    yield noting
    server.close()


def through_the_page(folder: Path, raw_path: str, path: str, body: bytes, host: str = "127.0.0.1") -> None:
    """POST through the page's process."""

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    scope = {"type": "http", "method": "POST", "path": path, "raw_path": raw_path.encode(), "client": (host, 1)}

    async def post() -> None:
        await forward(BenchLink(folder / "bench.sock"), Request({**scope, "headers": [], "query_string": b""}, receive))

    asyncio.run(post())


def test_a_job_from_the_page_names_no_files_of_the_bench_computer(tmp_path: Path, bench: Noting) -> None:
    """Whoever reaches the page could read any TOML file, and have rows written anywhere."""
    body = {"configuration": "film", "kind": None, "path": "/etc/x.toml", "out": "/root/x", "by": "root"}
    through_the_page(tmp_path, "/api/jobs", "/api/jobs", json.dumps(body).encode(), host="")
    assert bench.asked == [("POST", "/api/jobs", {"configuration": "film", "kind": None}, "the page ()")]


def test_a_caller_without_a_name_is_no_user_of_this_computer(tmp_path: Path, bench: Noting) -> None:
    asyncio.run(BenchLink(tmp_path / "bench.sock").request("POST", "/api/jobs", b"{}", ""))
    assert bench.asked[0][3] == ""  # None would have the rights of the socket's user


@pytest.mark.parametrize("body", [b'{"press": "' + b"p" * 500 + b'"}', b'{"press": 5}', b"\xff", b""])
def test_a_stop_is_one_whatever_its_address_and_body_are(tmp_path: Path, bench: Noting, body: bytes) -> None:
    through_the_page(tmp_path, "/api/%73top", STOP, body)
    ((method, path, sent, remote),) = bench.asked
    assert (method, path, remote) == ("POST", STOP, "the page (127.0.0.1)")
    assert 0 < len(sent["press"]) <= 80


def test_a_refusal_is_no_state(tmp_path: Path, bench: Noting) -> None:
    """A fault in the bench process would be sent to every viewer as the state: no output, no temperature, no STOP."""
    link = BenchLink(tmp_path / "bench.sock")
    with pytest.raises(Refusal, match="RuntimeError: broken") as refused:
        asyncio.run(link.get("/api/state"))
    assert refused.value.status == 500


def test_a_crowded_bench_process_gets_the_same_stop_again(tmp_path: Path) -> None:
    """A page's STOP needs a new connection, and there may be no room for it at first."""
    path, presses = tmp_path / "bench.sock", list[str]()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.closing(writer):
            await reader.readuntil(b"\r\n\r\n")
            presses.append((await reader.readexactly(16)).decode())
            if len(presses) > 2:
                writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}")

    async def stop() -> tuple[int, bytes]:
        link = BenchLink(path)
        stopping = asyncio.create_task(link.request("POST", STOP, b'{"press": "one"}', "the page"))
        await asyncio.sleep(0.05)  # nobody listens as yet
        async with await asyncio.start_unix_server(serve, path):
            return await stopping

    assert asyncio.run(stop()) == (200, b"{}")
    assert presses == ['{"press": "one"}'] * 3


def test_refused_events_end_the_page_process_and_do_not_look_like_silence(tmp_path: Path) -> None:
    """The page would show the last state for ever, as if the bench were there."""

    async def follow() -> BenchLink:
        link, left = BenchLink(tmp_path / "bench.sock"), asyncio.Event()

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(b"HTTP/1.1 503 Unavailable\r\nContent-Length: 2\r\n\r\n{}")
            await reader.read()  # until the page's process leaves
            writer.close()
            await writer.wait_closed()
            left.set()

        async with await asyncio.start_unix_server(serve, link.path):
            await asyncio.wait_for(link.follow(), 30.0)
            await left.wait()
        return link

    link = asyncio.run(follow())
    assert link.gone.is_set()
    assert link.state["output"] == "unknown"
