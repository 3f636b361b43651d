"""An overview over fake benches, for tests: `peltier overview` in a process of its own; a bench that says nothing."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tests.peltier import begun

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 60.0  # of patience on a busy computer
POST = {"Content-Type": "application/json", "X-Peltier": "1"}


class Overview:
    """Where it is, and what it answers."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.place = urlsplit(url).netloc

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
        """(status, answer)."""
        connection = http.client.HTTPConnection(self.place, timeout=LONGEST_S)
        try:
            data = None if body is None else json.dumps(body)
            connection.request(method, path, data, {**(POST if method == "POST" else {}), **headers})
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())
        finally:
            connection.close()

    def bench(self, name: str) -> dict[str, Any]:
        """One of the benches, as the page gets it."""
        found = self.ask("GET", "/api/state")[1]["benches"]
        return next(bench for bench in found if bench["name"] == name)

    def until(self, name: str, true: Any) -> dict[str, Any]:
        """Wait until something is so of a bench."""
        end_s = time.monotonic() + LONGEST_S
        while time.monotonic() < end_s:
            bench = self.bench(name)
            if true(bench):
                return bench
            time.sleep(0.05)
        raise AssertionError(f"{name}: it did not come true in {LONGEST_S} s; last {bench}")


def written(folder: Path, benches: dict[str, str], tokens: dict[str, str] | None = None, more: str = "") -> Path:
    """A configuration of an overview."""
    lines = ["[overview]", "port = 0", more]
    for name, address in benches.items():
        lines += ["[[bench]]", f'name = "{name}"', f'address = "{address}"']
        lines += [f'token = "{tokens[name]}"'] if tokens and name in tokens else []
    path = folder / "overview.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


@contextlib.contextmanager
def overviewing(path: Path) -> Iterator[Overview]:
    """`peltier overview` of a configuration, from its first line on."""
    process = begun("overview", path, env={**os.environ, "PYTHONPATH": str(ROOT)})
    try:
        assert process.stdout is not None
        yield Overview(process.stdout.readline().split()[1])
    finally:
        process.terminate()
        process.wait(LONGEST_S)
        assert process.stdout is not None
        process.stdout.close()


@contextlib.contextmanager
def silent() -> Iterator[str]:
    """The address of something that takes connections and never says anything."""
    kept: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def take() -> None:
            with contextlib.suppress(OSError):
                while True:
                    kept.append(listener.accept()[0])

        taking = threading.Thread(target=take, daemon=True)
        taking.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        with contextlib.suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)  # ends `accept`, which closing alone does not
        taking.join(LONGEST_S)  # or a connection that it takes last is closed by nobody
    for one in kept:
        one.close()
