"""The daemon's socket: newline-ended JSON from `peltier stop`, `status`, `run`, and from the web process.

    {"do": "stop", "by": "...", "press": "..."}  {"ok": true, "off": true, "confirmed": true, "confirmed_by": "...",
                                                  "took_s": 0.01}
    {"do": "reset", "reason": "..."}             {"do": "state"}    {"do": "jobs"}    {"do": "configurations"}
    {"do": "submit", "configuration": "name"}    or "text" and "name"; or "path" and "out", of this computer
    {"do": "submit", ..., "kind": "calibration"}    calibrates instead
    {"do": "submit", "hold_degC": 60, "hold_s": 600}    the bench's own configuration, holding a temperature
    {"do": "cancel", "id": "..."}                {"do": "follow"}   {"do": "who"}     {"do": "subscribe"}

A wrong question gets {"ok": false, "status": 4xx, "faults": [...]}, and the connection stays. Text that is no valid
Unicode is refused, but for a STOP, which is never refused. Where too many are connected, the one that has been silent
for longest goes, so that there is always room for a STOP. The socket and its folder
belong to one user (mode 0600): who may write to it may write to the ports as well.

A name belongs to whoever holds the lock on NAME.lock beside the socket, and nobody else removes that socket: a daemon
that starts, or is slow, does not answer either.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import socket
import threading
import time
from pathlib import Path
from typing import Any

from rig.core.file_lock import locked, tell_holder
from rig.core.json_text import parsed_json, usable
from rig.daemon.announce import encoded
from rig.daemon.answers import Answers, Refusal

LONGEST_LINE = 2_000_000  # bytes: a configuration of 1 MB, escaped
MOST_CONNECTIONS = 64
TRY_AGAIN_S = 0.1  # where no connection can be accepted: for want of descriptors, which are back when one closes


class ControlSocket:
    """Takes its place when it is made, listens from `start` to `close`, a thread for each connection. Raises PortHeld
    where another daemon of this name lives."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._answers: Answers
        lock = path.with_suffix(".lock")
        self._name_lock = locked(lock, f"the name {path.stem!r} (serve.name)", lock)
        tell_holder(lock)
        with contextlib.suppress(FileNotFoundError):
            path.unlink()  # of one that was killed
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        before = os.umask(0o177)
        try:
            self._listener.bind(str(self.path))
        except OSError:
            self._listener.close()
            os.close(self._name_lock)
            raise
        finally:
            os.umask(before)
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._silent_since_s: dict[socket.socket, float] = {}  # infinity while one is answered or told what happens

    def start(self, answers: Answers) -> None:
        """Answer from now on."""
        self._answers = answers
        self._listener.listen(MOST_CONNECTIONS)
        threading.Thread(target=self._accept, name="control socket", daemon=True).start()

    def close(self) -> None:
        """Listen no more."""
        self._ended.set()
        with contextlib.suppress(OSError):
            self._listener.close()
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._name_lock)

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:  # closed, or no descriptor is left for now
                if self._ended.wait(TRY_AGAIN_S):
                    return
                continue
            if not self._has_room():
                connection.close()
                continue
            self._mark(connection, time.monotonic())
            threading.Thread(target=self._serve, args=(connection,), name="connection", daemon=True).start()

    def _has_room(self) -> bool:
        """Where too many are connected, let the one go that has been silent for longest; False where none is."""
        with self._lock:
            if len(self._silent_since_s) < MOST_CONNECTIONS:
                return True
            oldest = min(self._silent_since_s, key=self._silent_since_s.__getitem__)
            if math.isinf(self._silent_since_s[oldest]):
                return False
            del self._silent_since_s[oldest]
        with contextlib.suppress(OSError):
            oldest.shutdown(socket.SHUT_RDWR)  # its thread reads the end, and closes it
        return True

    def _mark(self, connection: socket.socket, since_s: float) -> None:
        with self._lock:
            self._silent_since_s[connection] = since_s

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection, connection.makefile("rb") as lines:
                while True:
                    line = lines.readline(LONGEST_LINE)
                    if not line.endswith(b"\n"):
                        return
                    self._mark(connection, math.inf)
                    try:
                        question = _question(line)
                    except Refusal as refusal:
                        answer = _refused(refusal)
                    else:
                        if question.get("do") == "subscribe":
                            self._stream(connection)
                            return
                        answer = self._answer(question)
                    connection.sendall(encoded(answer))
                    self._mark(connection, time.monotonic())
        except OSError:
            return
        finally:
            with self._lock:
                self._silent_since_s.pop(connection, None)

    def _answer(self, question: dict[str, Any]) -> dict[str, Any]:
        try:
            return {"ok": True, **self._answers.answer(question)}
        except Refusal as refusal:
            return _refused(refusal)
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


def _refused(refusal: Refusal) -> dict[str, Any]:
    return {"ok": False, "status": refusal.status, "faults": refusal.lines}


def _question(line: bytes) -> dict[str, Any]:
    """What is asked. Raises Refusal; a STOP is taken whatever else is in its line."""
    try:
        question = parsed_json(line)
    except ValueError as error:
        if b'"stop"' not in line:
            raise Refusal(422, [f"question: {error}"]) from None
        question = _stop_in(line)
    return question if isinstance(question, dict) else {}


def _stop_in(line: bytes) -> dict[str, Any]:
    """The STOP in a line with text that cannot be kept, without that."""
    try:
        question = json.loads(line.decode("utf-8", "replace"))
    except (ValueError, RecursionError):
        question = None
    if not isinstance(question, dict) or question.get("do") != "stop":
        raise Refusal(422, ["question: expected JSON, UTF-8"])
    by = question.get("by")
    return {"do": "stop", "by": by if isinstance(by, str) and usable(by) else "somebody"}
