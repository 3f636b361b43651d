"""Talk to a daemon: JSON over HTTP on its Unix socket, the interface of docs/bench_api.md.

Import-light, because `peltier stop` waits for it: `http.client` brings ssl and email with it, `pathlib` urllib and
ipaddress; either takes longer to load than an output to switch off.

Where the socket is, so that `stop` finds it without reading a configuration:

$PELTIER_SOCKET                       if set: this one and no other
$XDG_RUNTIME_DIR/peltier/NAME.sock    a user's own daemon
/run/peltier/NAME.sock                the systemd unit's (RuntimeDirectory=peltier)
/tmp/peltier-UID/NAME.sock            if there is neither
"""

from __future__ import annotations

import json
import os
import socket
import sys
import time

from rig.core.errors import RigError
from rig.core.faults import Faults

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator
    from pathlib import Path
    from typing import Any

CALIBRATION = "calibration"  # a kind of job
CROWDED_S = 5.0  # for a place in the listener's queue, which moves within milliseconds
ANSWER_S = 15.0  # `stop` retries an instrument that does not answer for some seconds
FAILED = 400  # HTTP: this status and those above are refusals
NO_REASON = "the daemon refused without a reason"
NONE_RUNS = "no daemon runs here (`peltier serve CONFIG` starts one)"
SYSTEM = "/run/peltier"


class NoDaemon(RigError):
    """No daemon answers there."""


class Refusal(Faults):
    """A request that the daemon refuses: an HTTP status, and a line for each fault."""

    def __init__(self, status: int, lines: list[str]) -> None:
        self.status = status
        super().__init__(lines)


class Client:
    """A connection to one daemon; `path` is its socket, `name` its name. Raises NoDaemon if none listens there."""

    def __init__(self, path: str | Path, timeout_s: float = ANSWER_S) -> None:
        self.path = os.fspath(path)
        self.name = _name(self.path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout_s)
        try:
            _connect(self._socket, path, time.monotonic() + min(timeout_s, CROWDED_S))
        except OSError as error:
            self._socket.close()
            raise NoDaemon(f"no daemon listens at {path} ({error.strerror or error})") from None
        self._file = self._socket.makefile("rb")

    def ask(self, method: str, path: str, /, **body: Any) -> Any:
        """Return the answer to a request. Raises Refusal, and NoDaemon if the connection breaks or nothing comes."""
        self._send(method, path, body)
        return self._answer(*self._head())

    def events(self, timeout_s: float | None = None) -> Iterator[dict[str, Any]]:
        """Yield {"event": name, "data": {...}} from now on, the state first. Raises as `ask`, also when the daemon
        ends."""
        self._socket.settimeout(timeout_s)
        self._send("GET", "/api/events", {})
        status, length = self._head()
        if status >= FAILED:
            self._answer(status, length)
        name = ""
        while True:
            word, _, text = self._line().partition(": ")
            if word == "event":
                name = text
            elif word == "data":
                yield {"event": name, "data": json.loads(text)}

    def close(self) -> None:
        self._file.close()
        self._socket.close()

    def _send(self, method: str, path: str, body: dict[str, Any]) -> None:
        content = json.dumps(body).encode() if body else b""
        head = f"{method} {path} HTTP/1.1\r\nHost: peltier\r\nContent-Length: {len(content)}\r\n\r\n"
        try:
            self._socket.sendall(head.encode() + content)
        except OSError as error:
            raise NoDaemon(f"the daemon at {self.path} has gone ({error})") from None

    def _head(self) -> tuple[int, int]:
        try:
            status, length = int(self._line().split()[1]), 0
            while line := self._line():
                name, _, value = line.partition(":")
                length = int(value) if name.lower() == "content-length" else length
        except (ValueError, IndexError):
            raise NoDaemon(f"the process at {self.path} is no daemon of this version{self._how_to_end()}") from None
        return status, length

    def _answer(self, status: int, length: int) -> Any:
        try:
            answer = json.loads(self._file.read(length))
        except (OSError, ValueError):
            raise NoDaemon(f"the daemon at {self.path} has ended") from None
        if status >= FAILED:
            raise Refusal(status, answer.get("faults") or [NO_REASON])
        return answer

    def _how_to_end(self) -> str:
        """Return how to end the process that listens, where its number is known (Linux)."""
        if not hasattr(socket, "SO_PEERCRED"):
            return ""
        number = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 4)
        return f": end it (`kill {int.from_bytes(number, sys.byteorder)}`), which switches its output off"

    def _line(self) -> str:
        try:
            line = self._file.readline()
        except OSError as error:
            raise NoDaemon(f"the daemon at {self.path} does not answer ({error})") from None
        if not line.endswith(b"\n"):
            raise NoDaemon(f"the daemon at {self.path} has ended")
        return line.decode().rstrip("\r\n")

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _connect(end: socket.socket, path: str | Path, until_s: float) -> None:
    """Connect, again and again while the listener's queue is full. Raises OSError."""
    while True:
        try:
            end.connect(os.fspath(path))
            return
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(0.005)


def daemons(timeout_s: float = ANSWER_S) -> list[Client]:
    """Return a connection to every daemon that listens."""
    found: list[Client] = []
    for path in sockets() if hasattr(socket, "AF_UNIX") else []:
        try:
            found.append(Client(path, timeout_s))
        except NoDaemon:
            continue
    return found


def daemons_called(name: str | None) -> list[Client]:
    """Return the daemon of a name, or every one. Raises NoDaemon if there is none."""
    found = daemons()
    if name is not None:
        for client in found:
            if client.name != name:
                client.close()
        found = [client for client in found if client.name == name]
    if not found:
        raise NoDaemon(NONE_RUNS if name is None else f"no daemon called {name!r} runs here")
    return found


def one_daemon(name: str | None) -> Client:
    """Return the daemon of a name, or the only one. Raises NoDaemon, and Faults if there are several."""
    found = daemons_called(name)
    if len(found) > 1:
        for client in found:
            client.close()
        raise Faults([f"--bench: missing; expected one of {', '.join(client.name for client in found)}"])
    return found[0]


def _name(path: str) -> str:
    """Return the name of the daemon with this socket."""
    return os.path.splitext(os.path.basename(path))[0]


def _folders() -> list[str]:
    own = os.environ.get("XDG_RUNTIME_DIR")
    fallback = os.path.join(os.environ.get("TMPDIR", "/tmp"), f"peltier-{_user()}")
    return ([os.path.join(own, "peltier")] if own else []) + [SYSTEM, fallback]


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0


def socket_to_bind(name: str) -> Path:
    """Return the socket of a daemon that starts now; make its folder, closed to other users.

    Raises PermissionError if the folder belongs to another user.
    """
    from pathlib import Path

    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return Path(given)
    runtime = os.environ.get("RUNTIME_DIRECTORY")  # systemd's
    folder = Path(runtime.split(":")[0] if runtime else next(f for f in _folders() if f != SYSTEM))
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        raise PermissionError(f"{folder} belongs to another user; set PELTIER_SOCKET or XDG_RUNTIME_DIR")
    return folder / f"{name}.sock"


def socket_of(name: str) -> str:
    """Return the socket at which the daemon of a name listens, or would."""
    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return given
    return next((path for path in sockets() if _name(path) == name), os.path.join(_folders()[0], f"{name}.sock"))


def sockets() -> list[str]:
    """Return the sockets of daemons, the user's own first."""
    given = os.environ.get("PELTIER_SOCKET")
    if given:
        return [given]
    found = []
    for folder in _folders():
        try:
            paths = sorted(os.path.join(folder, file) for file in os.listdir(folder) if file.endswith(".sock"))
            found += [path for path in paths if folder == SYSTEM or os.stat(path).st_uid in (_user(), 0)]
        except OSError:  # not there, or not readable for this user
            continue
    return found


# -- common to the verbs that talk to a daemon -----------------------------------------------------------------------


def bench_argument(parser: argparse.ArgumentParser) -> None:
    """Add --bench NAME, for a computer with several daemons."""
    parser.add_argument("--bench", metavar="NAME", help="the daemon (serve.name), if several run")


def json_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", metavar="FILE", help="write the answer as JSON; - is stdout")


def write_json(target: str | None, value: Any) -> None:
    """Write the answer to the target of --json; a file whole or not at all. Raises OSError, which names the file."""
    if target is None:
        return
    text = json.dumps(value, indent=2) + "\n"
    if target == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        from pathlib import Path

        from rig.core.file_writing import write_text

        write_text(Path(target), text)


def text_stream(target: str | None) -> Any:
    """Return the stream for people: stderr if stdout belongs to --json."""
    return sys.stderr if target == "-" else sys.stdout
