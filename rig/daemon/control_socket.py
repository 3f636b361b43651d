"""The daemon's socket: newline-ended JSON from `peltier stop`, `status`, `run`, and from the web process.

    {"do": "stop", "by": "..."}                  {"ok": true, "off": true, "confirmed": true, "took_s": 0.01}
    {"do": "reset", "reason": "..."}             {"do": "state"}    {"do": "jobs"}    {"do": "configurations"}
    {"do": "submit", "configuration": "name"}    or "text" and "name"; or "path" and "out", of this computer
    {"do": "submit", ..., "kind": "calibration"}    calibrates instead
    {"do": "cancel", "id": "..."}                {"do": "follow"}   {"do": "who"}     {"do": "subscribe"}

A wrong question gets {"ok": false, "status": 4xx, "faults": [...]}, and the connection stays. The socket and its folder
belong to one user (mode 0600): who may write to it may write to the ports as well.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import socket
import threading
from pathlib import Path
from typing import Any

from rig.daemon.announce import encoded
from rig.daemon.answers import Answers, Refusal
from rig.daemon.client import Client, NoDaemon
from rig.errors import PortHeld

LONGEST_LINE = 2_000_000  # bytes: a configuration of 1 MB, escaped
MOST_CONNECTIONS = 64


class ControlSocket:
    """Takes its place when it is made, listens from `start` to `close`, a thread for each connection."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._answers: Answers
        self._make_room()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            self._listener.bind(str(self.path))
        except OSError:
            self._listener.close()
            raise
        finally:
            os.umask(before)
        self._connections = threading.BoundedSemaphore(MOST_CONNECTIONS)

    def _make_room(self) -> None:
        """PortHeld where another daemon of this name lives."""
        try:
            with Client(self.path, 2.0) as other:
                who = other.ask("who")
            raise PortHeld(f"the name {self.path.stem!r} (serve.name)", who["pid"], "peltier serve")
        except NoDaemon:
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()  # of one that was killed

    def start(self, answers: Answers) -> None:
        """Answer from now on."""
        self._answers = answers
        self._listener.listen(16)
        threading.Thread(target=self._accept, name="control socket", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
        with contextlib.suppress(OSError):
            self._listener.close()
        with contextlib.suppress(OSError):
            self.path.unlink()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            if not self._connections.acquire(blocking=False):
                connection.close()
                continue
            threading.Thread(target=self._serve, args=(connection,), name="connection", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection, connection.makefile("rb") as lines:
                while True:
                    line = lines.readline(LONGEST_LINE)
                    if not line.endswith(b"\n"):
                        return
                    question = _question(line)
                    if question.get("do") == "subscribe":
                        self._stream(connection)
                        return
                    connection.sendall(encoded(self._answer(question)))
        except OSError:
            return
        finally:
            self._connections.release()

    def _answer(self, question: dict[str, Any]) -> dict[str, Any]:
        try:
            return {"ok": True, **self._answers.answer(question)}
        except Refusal as refusal:
            return {"ok": False, "status": refusal.status, "faults": refusal.lines}
        except Exception as error:  # one question must not take the connection with it
            return {"ok": False, "status": 500, "faults": [f"{type(error).__name__}: {error}"]}

    def _stream(self, connection: socket.socket) -> None:
        announcer = self._answers.desk.announcer
        listener = announcer.listen()
        try:
            connection.settimeout(5.0)
            connection.sendall(encoded({"event": "state", "data": self._answers.desk.state()}))
            while True:
                try:
                    line = listener.get(timeout=5.0)
                except queue.Empty:
                    line = encoded({"event": "state", "data": self._answers.desk.state()})
                if line is None:
                    return
                connection.sendall(line)
        finally:
            announcer.leave(listener)


def _question(line: bytes) -> dict[str, Any]:
    try:
        question = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return question if isinstance(question, dict) else {}
