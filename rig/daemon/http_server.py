"""The daemon's interface, docs/bench_api.md: HTTP on a Unix socket, for the verbs, the page's process and EPICS.

    curl --unix-socket /run/user/1000/peltier/bench.sock http://bench/api/state

The page's process forwards to it what comes over TCP, with the caller's name in the header X-Peltier-For. Such callers
may not name files of this computer. Only on the Unix socket there are also

    GET /api/jobs/ID     a job with its messages and its result
    GET /daemon          process number, configuration, ports, and the settings of the page, tokens included
    POST /api/jobs {"path": "...", "out": "..."}    files of this computer

A STOP is never refused, whatever its headers and its body are. If too many are connected, the connection that has been
silent for longest is closed, so that there is always room for a STOP. Socket and folder belong to one user (mode 0600):
whoever may write to the socket may write to the ports as well.

A name belongs to the holder of the lock on NAME.lock beside the socket; nobody else removes that socket, because a
daemon that starts, or is slow, does not answer either.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import re
import socket
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from pydantic import SecretStr

from rig.config.configuration import read_configuration
from rig.core.faults import Faults
from rig.core.file_writing import locked, tell_holder
from rig.core.json_text import parsed_json
from rig.daemon.announcer import encoded, sent_event
from rig.daemon.client import CALIBRATION, Refusal
from rig.daemon.command_queue import HISTORY, CommandQueue
from rig.daemon.configurations import USUAL_S, by_name, by_text, configurations, hold_of
from rig.daemon.latch import NotCleared

STOP = "/api/stop"
FOR = "X-Peltier-For"  # who asks through the page's process
STOP_LINE = re.compile(rb"POST\s+/+api/stop[\s?]")
LONGEST_BODY, DIGITS = 2_000_000, 10  # bytes: a configuration of 1 MB, escaped; of a length
MOST_CONNECTIONS = 64
TRY_AGAIN_S = 0.1  # if no connection can be accepted for want of descriptors
SEND_S, STATE_EVERY_S = 5.0, 5.0  # a listener takes an event within the one, and gets a state every other
LONGEST_REASON = 2000  # characters, a page of text: reasons are kept in the history
LONGEST_NAME = 80  # characters
PRESSES_KEPT = 100  # of STOP: the page's second copy of a press comes within seconds
OK, CREATED, BAD_REQUEST, NOT_FOUND, TOO_LARGE, WRONG, SERVER_FAULT = 200, 201, 400, 404, 413, 422, 500  # HTTP

Body = dict[str, Any]


class Requests:
    """Answers requests to a command queue: (status, JSON value). Raises Refusal."""

    def __init__(self, commands: CommandQueue) -> None:
        self.commands = commands
        self._presses: dict[str | None, Body] = {}  # confirmed presses of STOP, and their answers
        self._get: dict[str, Callable[[], Any]] = {
            "/api/state": lambda: commands.state(),
            "/api/jobs": lambda: commands.queue.tables(),
            "/api/configurations": lambda: configurations(commands.configurations),
            "/daemon": self._daemon,
        }

    def answer(self, method: str, path: str, body: Body, remote: str | None = None) -> tuple[int, Any]:
        """Answer a request. remote: who asks through the page's process; None for a user of the Unix socket."""
        if (method, path) == ("POST", STOP):
            return OK, self._stop(body, remote)
        if (method, path) == ("POST", "/api/reset"):
            return OK, self._reset(body)
        if (method, path) == ("POST", "/api/jobs"):
            return CREATED, self._submit(body, remote is not None)
        if method == "GET" and path in self._get:
            return OK, self._get[path]()
        start, _, number = path.rpartition("/")
        if start == "/api/jobs" and method == "DELETE":
            return OK, self._cancel(number, remote or _text(body, "by", "somebody"))
        if start == "/api/jobs" and method == "GET":
            return OK, self._job(number)
        raise Refusal(NOT_FOUND, [f"{method} {path[:LONGEST_NAME]}: Not Found"])

    def _stop(self, body: Body, remote: str | None) -> Body:
        press, by = body.get("press"), remote or body.get("by")
        press = press[:LONGEST_NAME] if isinstance(press, str) else None  # they are kept
        if press in self._presses:
            return self._presses[press]  # one press on two ways: the second must not stop what was reset since
        off = self.commands.stop(by if isinstance(by, str) else "somebody")
        answer: Body = {"off": off.confirmed, "confirmed": off.confirmed, "took_s": off.took_s}
        answer["confirmed_by"] = off.confirmed_by
        if press is not None and off.confirmed:
            self._presses[press] = answer
            while len(self._presses) > PRESSES_KEPT:
                self._presses.pop(next(iter(self._presses)), None)
        return answer

    def _reset(self, body: Body) -> Body:
        reason = _text(body, "reason", "").strip()
        if not reason:
            raise Refusal(WRONG, ["reason: missing; expected why it is safe to go on"])
        try:
            done = self.commands.reset(reason[:LONGEST_REASON])
        except NotCleared as error:
            raise Refusal(503, [f"not reset: {error}"]) from None
        if not done:
            raise Refusal(409, ["nothing is latched; expected a trip or a stop"])
        return {"reset": True, "queue": len(self.commands.queue)}

    def _submit(self, body: Body, remote: bool) -> Body:
        commands = self.commands
        name, kind, out = body.get("name"), body.get("kind"), None
        if kind not in (None, CALIBRATION):
            raise Refusal(WRONG, [f"kind: {kind!r}: expected {CALIBRATION!r}, or none for the experiment itself"])
        experiment = kind != CALIBRATION
        try:
            if isinstance(body.get("path"), str) and not remote:
                path = Path(body["path"])
                file = read_configuration(path, experiment)
                name = name or path.stem
                out = Path(body["out"]) if isinstance(body.get("out"), str) else None
            elif "configuration" in body:
                file = by_name(body["configuration"], commands.configurations, experiment)
                name = name or str(body["configuration"])
            elif "text" in body:
                file = by_text(body["text"], name, commands.configurations, experiment)
            elif "hold_degC" in body and experiment:
                seconds = body.get("hold_s", USUAL_S)
                file = hold_of(commands.file, body["hold_degC"], seconds, commands.model)
                name = name or f"hold {float(body['hold_degC']):g} degC"
            else:
                raise Refusal(WRONG, ["configuration: missing; expected a name, a text, or hold_degC"])
            job = commands.submit(file, str(name)[:LONGEST_NAME] if name else None, out, kind)
        except Refusal:
            raise
        except Faults as faults:
            raise Refusal(WRONG, faults.lines) from None
        return job.table()

    def _cancel(self, number: str, by: str) -> Body:
        job = self.commands.cancel(number, by)
        if job is None:
            raise Refusal(NOT_FOUND, [f"job {number[:LONGEST_NAME]!r}: expected one that waits or runs"])
        return {**job.table(), "bench": self.commands.state()}

    def _job(self, number: str) -> Body:
        job = self.commands.queue.find(number)
        if job is None:
            raise Refusal(NOT_FOUND, ["job: expected one that waits, runs, or has just ended"])
        return {"job": job.table(), "messages": job.messages, "result": job.result}

    def _daemon(self) -> Body:
        """Return what other processes of this user need to know."""
        commands = self.commands
        content = commands.file.content
        bench, serve = content.bench, content.serve
        return {
            "pid": os.getpid(),
            "name": serve.name,
            "configuration": str(commands.file.path),
            "ports": [bench.controller.port, *([bench.meter.port] if bench.meter else [])],
            "address": serve.address,
            "port": serve.port,
            "stop_port": commands.stop_port,
            "token": _revealed(serve.token),
            "metrics_token": _revealed(serve.metrics_token),
            "hosts": serve.hosts,
            "history": str(commands.folder / HISTORY),
            "period_s": serve.idle_period_s,
            "model": str(commands.model) if commands.model is not None else None,
            "memory_since_s": commands.memory_since_s,
            "limits_degC": list(content.limits.temperature_degC),
        }


def _revealed(secret: SecretStr | None) -> str | None:
    """Return a token for the page's process, which compares it."""
    return secret.get_secret_value() if secret is not None else None


def _text(body: Body, key: str, otherwise: str) -> str:
    value = body.get(key, otherwise)
    if not isinstance(value, str):
        raise Refusal(WRONG, [f"{key}: {type(value).__name__}: expected text"])
    return value


class UnixServer:
    """Takes the name when it is made, and answers from `start` to `close`, a thread for each connection. Raises
    PortHeld if another daemon has the name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lock = path.with_suffix(".lock")
        self._name_lock = locked(lock, f"the name {path.stem!r} (serve.name)", lock)
        tell_holder(lock)
        with contextlib.suppress(FileNotFoundError):
            path.unlink()  # of a daemon that was killed
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
        self._silent_since_s: dict[socket.socket, float] = {}  # infinity while a request is answered

    def start(self, requests: Requests) -> None:
        self.requests = requests
        self._listener.listen(MOST_CONNECTIONS)
        threading.Thread(target=self._accept, name="HTTP server", daemon=True).start()

    def close(self) -> None:
        self._ended.set()
        with contextlib.suppress(OSError):
            self._listener.close()
        with contextlib.suppress(OSError):
            self.path.unlink()
        os.close(self._name_lock)

    def mark(self, connection: socket.socket, since_s: float) -> None:
        """Note since when a connection has been silent."""
        with self._lock:
            self._silent_since_s[connection] = since_s

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
            self.mark(connection, time.monotonic())
            threading.Thread(target=self._serve, args=(connection,), name="connection", daemon=True).start()

    def _has_room(self) -> bool:
        """Close the connection that has been silent for longest if there are too many; False if none is silent."""
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

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection:
                _Connection(connection, "", self)  # type: ignore[arg-type]
        except OSError:
            return
        finally:
            with self._lock:
                self._silent_since_s.pop(connection, None)


class _Connection(BaseHTTPRequestHandler):
    """One connection; its requests one after the other."""

    protocol_version = default_request_version = "HTTP/1.1"
    server: UnixServer  # type: ignore[assignment]
    raw_requestline: bytes

    def do_GET(self) -> None:
        """Answer a request of any method."""
        try:
            path = unquote(urlsplit(self.path).path)
            body = self._body(path)
            self.server.mark(self.connection, math.inf)
            if (self.command, path) == ("GET", "/api/events"):
                self._stream()
                return
            status, answer = self._answer(self.command, path, body, self.headers.get(FOR))
        except Refusal as refusal:
            status, answer = refusal.status, {"faults": refusal.lines}
        self._send(status, answer)

    do_POST = do_DELETE = do_GET

    def handle_one_request(self) -> None:
        """Answer a request. An address or a header that raises is the caller's fault: it gets an answer, and the log no
        traceback."""
        try:
            super().handle_one_request()
        except OSError:  # the caller has gone
            raise
        except Exception as error:
            self.send_error(BAD_REQUEST, f"{type(error).__name__}: {error}")

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse a request whose head cannot be read, as JSON, and close the connection; but take a STOP."""
        self.close_connection = True
        self.server.mark(self.connection, math.inf)
        if STOP_LINE.match(self.raw_requestline):
            self._send(*self._answer("POST", STOP, {}, None))
        else:
            self._send(code, {"faults": [f"request: {message or explain}"]})

    def _send(self, status: int, answer: Any) -> None:
        content = encoded(answer)
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)
        self.server.mark(self.connection, time.monotonic())

    def _answer(self, method: str, path: str, body: Body, remote: str | None) -> tuple[int, Any]:
        """Answer a request; an unexpected error must not take the connection with it. Raises Refusal."""
        try:
            return self.server.requests.answer(method, path, body, remote)
        except Refusal:
            raise
        except Exception as error:
            return SERVER_FAULT, {"faults": [f"{type(error).__name__}: {error}"]}

    def _body(self, path: str) -> Body:
        """Return the object in the body. Raises Refusal, but not for a STOP: what is wrong in its body is left out."""
        length = self.headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit() and len(length) <= DIGITS and int(length) <= LONGEST_BODY):
            self.close_connection = True  # the next request would begin somewhere in this body
            if path != STOP:
                raise Refusal(TOO_LARGE, [f"body: expected at most {LONGEST_BODY} bytes"])
            length = "0"
        content = self.rfile.read(int(length))
        try:
            body = parsed_json(content) if content else {}
            if not isinstance(body, dict):
                raise Refusal(WRONG, ["body: expected an object"])
        except (ValueError, Refusal) as error:
            if path == STOP:
                return {}
            raise error if isinstance(error, Refusal) else Refusal(BAD_REQUEST, [f"body: {error}"]) from None
        return body

    def _stream(self) -> None:
        """Send events until the caller goes, the state first and every few seconds."""
        self.close_connection = True
        self.send_response(OK)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        commands = self.server.requests.commands
        listener = commands.announcer.listen()
        try:
            self.connection.settimeout(SEND_S)
            self.wfile.write(sent_event("state", commands.state()))
            while True:
                try:
                    event = listener.get(timeout=STATE_EVERY_S)
                except queue.Empty:
                    event = sent_event("state", commands.state())
                if event is None:
                    return
                self.wfile.write(event)
        finally:
            commands.announcer.leave(listener)

    def log_message(self, format: str, *values: Any) -> None:
        """Log nothing: the command queue logs what matters."""
