"""Telling others: systemd, the webhook, and listeners who are too slow."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

from rig.config.configuration import read_configuration
from rig.core.faults import Faults
from rig.daemon import systemd
from rig.daemon.announcer import MOST_WAITING, Announcer, encoded, post_webhook
from rig.daemon.serving import bench_of
from rig.daemon.systemd import Notifier
from tests.rig.daemon.benches import SERVE, write_current


@pytest.fixture
def heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[str]]]:
    """What systemd would have heard."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))

        def read() -> list[str]:
            found = []
            while True:
                try:
                    found.append(listener.recv(4096).decode())
                except BlockingIOError:
                    return found

        yield read


def test_systemd_is_fed_by_cycles_alone(heard: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(systemd.time, "monotonic", lambda: now[0])
    notifier = Notifier()
    notifier.ready("the output is off")
    assert heard() == ["READY=1\nSTATUS=the output is off"]
    for _ in range(25):  # ten a second
        notifier.cycle()
        now[0] += 0.1
    assert heard() == ["WATCHDOG=1"] * 3
    now[0] += 100.0
    assert heard() == []
    notifier.ends(60.3)
    assert heard() == ["EXTEND_TIMEOUT_USEC=60300000"]
    notifier.close()


class Receiver(HTTPServer):
    """Fails as often as it is told, then keeps what comes."""

    def __init__(self, failures: int) -> None:
        self.failures = failures
        self.bodies: list[dict[str, Any]] = []
        super().__init__(("127.0.0.1", 0), Answer)


class Answer(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.server.failures:
            self.server.failures -= 1
            self.send_response(500)
        else:
            self.server.bodies.append(body)
            self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("failures", [0, 2])
def test_a_webhook_is_tried_again(failures: int) -> None:
    with Receiver(failures) as receiver:
        threading.Thread(target=receiver.serve_forever, daemon=True).start()
        told: list[str] = []
        url = f"http://127.0.0.1:{receiver.server_port}/hook"
        post_webhook(url, {"event": "trip", "cause": "temperature_limit"}, told.append, (0.0, 0.0, 0.0)).join(10.0)
        receiver.shutdown()
    assert told == []
    assert receiver.bodies == [{"event": "trip", "cause": "temperature_limit"}]


def test_a_webhook_that_speaks_no_http_is_told_of() -> None:
    """Somebody else's server at its address: every try counts, and the address, a secret, is not told."""
    told: list[str] = []
    tries = 0
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            nonlocal tries
            for _ in range(2):
                connection, _ = server.accept()
                with connection:
                    tries += 1
                    connection.recv(4096)
                    connection.sendall(b"hello\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        url = f"http://127.0.0.1:{server.getsockname()[1]}/SECRET"
        post_webhook(url, {"event": "trip"}, told.append, (0.0, 0.0)).join(10.0)
    assert told == ["webhook: BadStatusLine (2 tries)"]
    assert tries == 2


def test_a_listener_who_is_too_slow_is_let_go_and_the_others_are_not() -> None:
    announcer = Announcer()
    slow, quick = announcer.listen(), announcer.listen()
    for k in range(MOST_WAITING + 10):
        announcer.announce("row", {"k": k})
        assert quick.get_nowait() == b'event: row\ndata: {"k":%d}\n\n' % k
    last = None
    while not slow.empty():
        last = slow.get_nowait()
    assert last is None
    announcer.close()
    assert quick.get_nowait() is None


def test_what_json_cannot_say_is_null() -> None:
    assert json.loads(encoded({"a": float("nan"), "b": [float("inf"), 1.5], "c": Path("/x")})) == {
        "a": None,
        "b": [None, 1.5],
        "c": "/x",
    }


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ("", ""),
        ("dead_man_s = 54.0", ""),
        ("dead_man_s = 56.0", "bench.controller.dead_man_s: 56"),
        ("idle_period_s = 58.0", "serve.idle_period_s: 58"),
    ],
)
def test_a_silence_too_long_for_systemd(more: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the silence for the dead man of a controller that does not obey no cycle is completed."""
    path = write_current(tmp_path, more=SERVE)
    text = path.read_text()
    if more.startswith("dead_man_s"):
        text = text.replace("[bench.meter]", f"{more}\n[bench.meter]", 1)
    elif more:
        text = text.replace("idle_period_s = 0.1", more)
    path.write_text(text)
    file = read_configuration(path)
    bench_of(file)  # not under systemd
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    if not key:
        bench_of(file)
        return
    with pytest.raises(Faults) as found:
        bench_of(file)
    assert len(found.value.lines) == 1
    assert f"{key}: expected at most 55, 5 s below systemd's WatchdogSec" in found.value.lines[0]
