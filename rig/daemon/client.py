"""Talking to a daemon over its socket: one JSON object a line, a question and its answer. Import-light.

An answer has "ok"; where it is false, "faults" holds a line each and "status" the HTTP status that says the same.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from rig.core.posix_only import has_unix_sockets
from rig.daemon.places import sockets_there

CALIBRATION = "calibration"  # a kind of job
CROWDED_S = 5.0  # for a place in a line that moves within milliseconds
ANSWER_S = 15.0  # an instrument that does not answer is tried for some seconds before `stop` says so


class NoDaemon(Exception):
    """Nobody listens there."""


class Client:
    """A connection to one daemon; `path` is its socket. Raises NoDaemon where none listens."""

    def __init__(self, path: Path, timeout_s: float = ANSWER_S) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout_s)
        try:
            _connect(self._socket, path, time.monotonic() + min(timeout_s, CROWDED_S))
        except OSError as error:
            self._socket.close()
            raise NoDaemon(f"no daemon listens at {path} ({error.strerror or error})") from None
        self._lines = self._socket.makefile("rb")

    def ask(self, do: str, **more: Any) -> dict[str, Any]:
        """Send a question, return its answer. Raises NoDaemon where the connection breaks or nothing comes."""
        self._send({"do": do, **more})
        return self._next()

    def events(self, timeout_s: float | None = None) -> Iterator[dict[str, Any]]:
        """What happens from now on, {"event": name, "data": {...}} each, until the daemon ends (NoDaemon)."""
        self._socket.settimeout(timeout_s)
        self._send({"do": "subscribe"})
        while True:
            yield self._next()

    def close(self) -> None:
        """Let go of the connection."""
        self._lines.close()
        self._socket.close()

    def _send(self, question: dict[str, Any]) -> None:
        try:
            self._socket.sendall(json.dumps(question).encode() + b"\n")
        except OSError as error:
            raise NoDaemon(f"the daemon at {self.path} has gone ({error})") from None

    def _next(self) -> dict[str, Any]:
        try:
            line = self._lines.readline()
        except OSError as error:
            raise NoDaemon(f"the daemon at {self.path} does not answer ({error})") from None
        if not line.endswith(b"\n"):
            raise NoDaemon(f"the daemon at {self.path} has ended")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _connect(end: socket.socket, path: Path, until_s: float) -> None:
    """Again and again where too many ask at this moment: a Unix socket says so at once. Raises OSError."""
    while True:
        try:
            end.connect(str(path))
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(0.005)


def daemons(timeout_s: float = ANSWER_S) -> list[Client]:
    """A connection to every daemon that listens."""
    found: list[Client] = []
    if not has_unix_sockets():
        return found
    for path in sockets_there():
        try:
            found.append(Client(path, timeout_s))
        except NoDaemon:
            continue
    return found
