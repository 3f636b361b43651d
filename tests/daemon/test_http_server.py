"""The daemon's socket: one holder of a name, from before it answers until it has ended."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path
from typing import Any, cast

import pytest

from rig.core.errors import PortHeld
from rig.daemon.client import Client, Refusal
from rig.daemon.http_server import UnixServer


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


def test_what_a_killed_daemon_left_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "bench.sock"
    killed = UnixServer(path)
    os.close(killed._name_lock)  # as the system does
    second = UnixServer(path)
    assert path.is_socket()
    second.close()
    killed._listener.close()


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
