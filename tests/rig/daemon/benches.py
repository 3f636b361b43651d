"""A daemon in this process, for tests: simulated instruments, real time, a socket and a page of its own."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from rig.config.configuration import read_configuration
from rig.core.outcome import Outcome, Stopped
from rig.daemon.command_queue import CommandQueue
from rig.daemon.http_server import Requests, UnixServer
from rig.daemon.serving import bench_of
from rig.daemon.supervisor import Supervisor
from rig.daemon.systemd import Notifier
from rig.daemon.web_process import listening
from rig.web.serving import serve
from tests.rig.small import write_bench

LONGEST_S = 180.0  # of patience on a busy computer, where loops may be compiled
SERVE = '[serve]\nport = 0\nfolder = "kept"\nidle_period_s = 0.1\n'
HEADERS = {"Content-Type": "application/json", "X-Peltier": "1"}


def write_current(
    folder: Path, target: str = '["start 0 A", "hold 60 s"]', name: str = "config", more: str = ""
) -> Path:
    """A bench with a current profile, which needs no model and begins at once."""
    path = write_bench(folder, target=target, more=more)
    text = path.read_text().replace('kind = "track_resistance"\nmodel = "model.toml"', 'kind = "current_profile"')
    text = text.replace("current_A = 4.0", "current_A = 4.0\npolarity_share = 0.0")  # its pulse takes seconds
    path = folder / f"{name}.toml"
    path.write_text(text.replace("\nperiod_s = 0.1", "\nperiod_s = 0.05"))
    return path


def put_on(path: Path, ports: Mapping[str, str], more: str = "") -> None:
    """Make a configuration that of a daemon at these ports, on a real clock. more: lines of [serve]."""
    text = path.read_text().replace('time = "virtual"\n', "")
    for role in ("controller", "meter"):
        text = text.replace('"sim://"', f'"{ports[role]}"', 1)
    path.write_text(text + '[serve]\nport = 0\nfolder = "kept"\n' + more)


def environment(folder: Path) -> dict[str, str]:
    """Of a daemon as a process of its own: its socket, and the one by which systemd is told."""
    more = {"PELTIER_SOCKET": str(folder / "bench.sock"), "NOTIFY_SOCKET": str(folder / "notify")}
    return {**os.environ, **more}


def until(true: Callable[[], Any], what: str = "it") -> Any:
    """Wait until something is so; its value."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        value = true()
        if value:
            return value
        time.sleep(0.01)
    raise AssertionError(f"{what} did not come true in {LONGEST_S} s")


class RunningBench:
    """Command queue, socket and supervisor, and the page if asked for. ends: what the supervisor raises at the end."""

    def __init__(self, path: Path, socket: Path, ends: type[Outcome] = Stopped) -> None:
        self._ends = ends
        self._ended: Outcome | None = None
        self.file, notes = bench_of(read_configuration(path))
        self.socket = socket
        self._listener = UnixServer(socket)
        self.logged: list[str] = []
        self.commands = CommandQueue(self.file, notes, log=self.logged.append)
        self.supervisor = Supervisor(self.file, self.commands, Notifier())
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._listener.start(Requests(self.commands))
        self._thread.start()
        self._web: threading.Thread | None = None
        self.url = ""

    def _keep(self) -> None:
        try:
            self.supervisor.keep()
        except self._ends as end:
            self._ended = end

    def state(self) -> dict[str, Any]:
        """As the page gets it."""
        return self.commands.state()

    def until_state(self, word: str) -> dict[str, Any]:
        """Wait for a state."""
        return until(lambda: self.state() if self.state()["state"] == word else None, word)

    def until_phase(self, name: str) -> None:
        """Wait for a phase of the running job."""
        until(lambda: (self.state()["job"] or {}).get("phase") == name, name)

    def serve(self) -> None:
        """Begin the page."""

        def told(url: str) -> None:
            self.url = url

        table = self.file.content.serve
        listener = listening(table.address, table.port)
        serving = serve(self.socket, listener, told, lambda: None)
        self._web = threading.Thread(target=asyncio.run, args=(serving,), daemon=True)
        self._web.start()
        until(lambda: self.url, "the page")

    def ask(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None, raw: bytes | None = None
    ) -> tuple[int, Any]:
        """(status, answer) of a request."""
        status, _, answer = self.ask_fully(method, path, body, headers, raw)
        return status, answer

    def ask_fully(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None, raw: bytes | None = None
    ) -> tuple[int, dict[str, str], Any]:
        """(status, headers, answer) of a request."""
        given = HEADERS if headers is None else headers
        data = raw if raw is not None else json.dumps(body).encode() if body is not None else None
        connection = http.client.HTTPConnection(urlsplit(self.url).netloc, timeout=LONGEST_S)
        try:
            connection.request(method, path, data, given)
            answer = connection.getresponse()
            text = answer.read()
        finally:
            connection.close()
        found = {name.lower(): value for name, value in answer.getheaders()}
        return answer.status, found, json.loads(text) if "json" in found.get("content-type", "") else text

    def events(self, count: int) -> list[tuple[str, Any]]:
        """The first server-sent events."""
        connection = http.client.HTTPConnection(urlsplit(self.url).netloc, timeout=LONGEST_S)
        found: list[tuple[str, Any]] = []
        try:
            connection.request("GET", "/api/events")
            stream = connection.getresponse()
            name = ""
            while len(found) < count:
                line = stream.readline().decode().rstrip("\n")
                if line.startswith("event: "):
                    name = line[7:]
                elif line.startswith("data: "):
                    found.append((name, json.loads(line[6:])))
        finally:
            connection.close()
        return found

    def close(self) -> None:
        """End, the output off."""
        self.supervisor.end()
        self._thread.join(LONGEST_S)
        self._listener.close()
        if self._web is not None:
            self._web.join(LONGEST_S)
            assert not self._web.is_alive()
        assert not self._thread.is_alive()
        assert self._ended is not None


@contextlib.contextmanager
def running(path: Path, web: bool = False, ends: type[Outcome] = Stopped) -> Iterator[RunningBench]:
    """A bench that is idle, and ends at the end."""
    bench = RunningBench(path, path.parent / "bench.sock", ends)
    try:
        until(lambda: bench.commands.online and bench.commands.recent, "the bench")
        if web:
            bench.serve()
        yield bench
    finally:
        bench.close()
