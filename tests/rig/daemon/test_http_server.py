"""The daemon's socket and its clients: one holder of a name, from before it answers until it has ended."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from rig.core.errors import PortHeld
from rig.daemon.client import Client, Refusal, write_json
from rig.daemon.http_server import Requests, UnixServer
from rig.daemon.output_lock import Off
from tests.peltier import Peltier
from tests.rig.daemon.benches import SERVE, running, write_current
from tests.rig.small import no_file_above


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


OFF = b'{"off": true, "confirmed": true, "confirmed_by": "its status", "took_s": 0.01}'


@contextlib.contextmanager
def answering(path: Path, answer: Callable[[bytes], bytes]) -> Iterator[None]:
    """A process at a socket that answers line by line."""

    def serve(connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection, connection.makefile("rb") as lines:
            for line in lines:
                connection.sendall(answer(line))

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=serve, args=(listener.accept()[0],), daemon=True).start()

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        threading.Thread(target=accept, daemon=True).start()
        yield
        listener.shutdown(socket.SHUT_RDWR)


def stopping(stops: list[str]) -> Callable[[bytes], bytes]:
    """What a daemon answers to the lines of a STOP, each of which is kept."""
    head = f"HTTP/1.1 200 OK\r\nContent-Length: {len(OFF)}\r\n\r\n".encode()

    def answer(line: bytes) -> bytes:
        stops.extend(["stop"] if line.startswith(b"POST /api/stop ") else [])
        return head + OFF if line == b"\r\n" else b""

    return answer


@pytest.mark.skipif(not hasattr(signal, "SIGXFSZ"), reason="file sizes are limited on POSIX only")
def test_an_answer_that_does_not_fit_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "status.json"
    write_json(str(target), {"output": "off"})
    before = target.read_text()
    assert before == '{\n  "output": "off"\n}\n'
    with no_file_above(4096), pytest.raises(OSError, match=r"status\.json"):
        write_json(str(target), {"warnings": ["x" * 100_000]})
    assert target.read_text() == before
    assert list(tmp_path.iterdir()) == [target]


def test_what_is_no_daemon_is_to_be_ended(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A daemon that speaks otherwise goes on heating: whoever types `stop` has to learn how to end it."""
    path = tmp_path / "bench.sock"
    monkeypatch.setenv("PELTIER_SOCKET", str(path))
    with answering(path, lambda line: b'{"ok":false}\n'):
        status, out, err = peltier("stop")
    assert (status, out, err.count("\n")) == (11, "", 1)
    assert f"end it (`kill {os.getpid()}`), which switches its output off" in err
    assert err.endswith("Switch the controller off by hand.\n")


def test_every_stop_comes_before_writing(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two benches, the second would go on heating because the first one's answer does not fit on a disk."""
    monkeypatch.delenv("PELTIER_SOCKET", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "peltier").mkdir()
    stops: list[str] = []
    one, two = (tmp_path / "peltier" / f"{name}.sock" for name in ("one", "two"))
    with answering(one, stopping(stops)), answering(two, stopping(stops)):
        status, out, err = peltier("stop", "--json", tmp_path / "no folder" / "stop.json")
    assert (status, len(stops)) == (1, 2)
    assert "one: output off" in out
    assert "two: output off" in out
    assert "stop.json" in err


def test_refused_events_do_not_look_like_silence(tmp_path: Path) -> None:
    """`peltier watch` would show nothing, for ever."""
    refusal = b'{"faults": ["too many listen"]}'
    head = f"HTTP/1.1 503 Unavailable\r\nContent-Length: {len(refusal)}\r\n\r\n".encode()
    path = tmp_path / "bench.sock"
    with (
        answering(path, lambda line: head + refusal if line == b"\r\n" else b""),
        Client(path, 30.0) as client,
        pytest.raises(Refusal, match="too many listen"),
    ):
        next(client.events(30.0))


def test_another_file_s_bench_is_left_alone(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = write_current(tmp_path, more=SERVE)
    other = tmp_path / "other.toml"
    other.write_text(mine.read_text())
    link = tmp_path / "link.toml"
    link.symlink_to(mine)
    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "bench.sock"))
    with running(mine) as bench:
        status, out, err = peltier("off", other, "--json", "-")
        assert (status, json.loads(out)["confirmed"]) == (0, True)
        assert f"no daemon serves {other}: nothing is on; left alone: bench" in err
        assert bench.state()["state"] == "idle"
        out = peltier.quietly("off", link)
        assert "bench: output off, confirmed" in out
        bench.until_state("stopped")
    out = peltier.quietly("off", mine)
    assert "nothing is on" in out
    assert "left alone" not in out


@pytest.mark.parametrize("error", [RuntimeError("a driver's own"), ImportError("no serial"), OSError("no room")])
def test_whatever_stands_in_its_way_the_output_is_not_confirmed_off(
    peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """Whoever types `off` must not have to read a traceback to learn that the heater is still on."""

    def fails(config: Path) -> None:
        raise error

    monkeypatch.setenv("PELTIER_SOCKET", str(tmp_path / "bench.sock"))
    monkeypatch.setattr("rig.command.bench._controller", fails)
    status, out, err = peltier("off", "rig.toml")
    assert (status, out, err.count("\n")) == (11, "", 1)
    assert f"OUTPUT NOT CONFIRMED OFF: {'the installation is not whole ' * isinstance(error, ImportError)}" in err
    assert f"{error}" in err
    assert "Switch the controller off by hand." in err
