"""The daemon's socket: one holder of a name, from before it answers until it has ended."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from rig.core.errors import PortHeld
from rig.daemon.client import Client, Refusal
from rig.daemon.http_server import Requests, UnixServer
from rig.daemon.output_lock import Off


def test_a_daemon_that_does_not_answer_yet_keeps_its_socket(tmp_path: Path) -> None:
    """While it switches the output off and checks a large history, another one is started by mistake."""
    path = tmp_path / "bench.sock"
    first = UnixServer(path)
    with pytest.raises(PortHeld, match=f"'bench'.*process {os.getpid()}"):
        UnixServer(path)
    assert path.is_socket()
    first.close()
    assert not path.exists()
    UnixServer(path).close()


def test_a_place_without_locks_is_not_told_as_one_that_is_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", none)
    with pytest.raises(OSError, match="No locks available"):
        UnixServer(tmp_path / "bench.sock")


def test_a_request_that_fails_leaves_the_connection_and_a_stop_in_it_is_taken(tmp_path: Path) -> None:
    """Otherwise `peltier stop` on a connection that met a fault, such as a disk that is gone, would not get through."""

    class Faulty:
        def answer(self, method: str, path: str, body: dict[str, Any], remote: str | None) -> tuple[int, Any]:
            if path != "/api/stop":
                raise OSError("the disk is gone")
            return 200, {"confirmed": True, "by": body.get("by")}

    server = UnixServer(tmp_path / "bench.sock")
    server.start(cast(Any, Faulty()))
    try:
        with Client(server.path) as client:
            with pytest.raises(Refusal, match="OSError: the disk is gone") as refused:
                client.ask("GET", "/api/jobs")
            assert refused.value.status == 500
            assert client.ask("POST", "/api/stop", by="a test") == {"confirmed": True, "by": "a test"}
            assert client.ask("POST", "/api/stop", by="\ud800") == {"confirmed": True, "by": None}
    finally:
        server.close()


@pytest.fixture
def stops(tmp_path: Path) -> Iterator[tuple[UnixServer, list[dict[str, Any]]]]:
    """A server, and the bodies of the STOPs that it has taken."""
    taken: list[dict[str, Any]] = []

    class Taking:
        def answer(self, method: str, path: str, body: dict[str, Any], remote: str | None) -> tuple[int, Any]:
            if (method, path) != ("POST", "/api/stop"):
                raise Refusal(404, ["Not Found"])
            taken.append({"remote": remote, **body})
            return 200, {"confirmed": True}

    server = UnixServer(tmp_path / "bench.sock")
    server.start(cast(Any, Taking()))
    yield server, taken
    server.close()


def sent(server: UnixServer, content: bytes) -> bytes:
    """The answer to bytes, until the server closes the connection."""
    with socket.socket(socket.AF_UNIX) as end:
        end.settimeout(30.0)
        end.connect(str(server.path))
        end.sendall(content)
        found = b""
        with contextlib.suppress(ConnectionResetError):  # it left some bytes unread
            while part := end.recv(65536):
                found += part
        return found


@pytest.mark.parametrize(
    "header", [b"Content-Length: " + b"9" * 5000, b"X: y\r\n" * 150 + b"X: y", b"X: " + b"y" * 70_000]
)
def test_a_stop_is_taken_whatever_its_headers_are_and_others_are_refused_without_a_traceback(
    stops: tuple[UnixServer, list[dict[str, Any]]], capfd: pytest.CaptureFixture[str], header: bytes
) -> None:
    """A traceback a request would fill the daemon's log, and the caller would get no answer."""
    server, taken = stops
    assert sent(server, b"POST /api/stop HTTP/1.1\r\n" + header + b"\r\n\r\n").startswith(b"HTTP/1.1 200 ")
    assert len(taken) == 1
    refused = sent(server, b"POST /api/jobs HTTP/1.1\r\n" + header + b"\r\n\r\n")
    assert refused.startswith(b"HTTP/1.1 4")
    assert json.loads(refused.partition(b"\r\n\r\n")[2])["faults"]
    assert sent(server, b"GET http://[/api/state HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 400 ")
    assert capfd.readouterr().err == ""


def test_a_press_is_kept_in_few_characters() -> None:
    """Else anybody who reaches the page fills the bench process's memory, 1 MB a press."""

    class Stopping:
        configurations = None

        def stop(self, by: str) -> Off:
            return Off(True, 0.01)

    requests = Requests(cast(Any, Stopping()))
    requests.answer("POST", "/api/stop", {"press": "p" * 1_000_000})
    assert [len(press or "") for press in requests._presses] == [80]
