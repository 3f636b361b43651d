"""Mutated requests over HTTP: methods, addresses, headers and bodies, against a daemon's page and STOP's listener."""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from benchmarks._good_inputs import BENCH, MODEL, ROOT, TRACK, own_effect
from benchmarks._mutations import DIGITS, by_bytes, json_text, mutated
from rig.daemon.client import Client

LONGEST_S = 60.0
AT_ONCE = 48  # requests
PATHS = [
    "/",
    "/api/state",
    "/api/history",
    "/api/history?from=0&to=1&points=5",
    "/api/loop",
    "/api/trips",
    "/api/jobs",
    "/api/jobs/1",
    "/api/configurations",
    "/api/stop",
    "/api/reset",
    "/api/session",
    "/runs/1/report.html",
    "/metrics",
    "/health",
    "/app.js",
    "/nothing",
]
METHODS = [
    "GET",
    "GET",
    "POST",
    "POST",
    "POST",
    "DELETE",
    "HEAD",
    "OPTIONS",
    "PUT",
    "PATCH",
    "TRACE",
    "CONNECT",
    "get",
    "\x00",
]
PARTS = [
    "%00",
    "%ff",
    "%ed%a0%80",
    "%2e%2e%2f",
    "..",
    "//",
    "?",
    "&points=",
    "&from=nan",
    "&to=1e308",
    "&points=" + DIGITS,
    "&from=" + "9" * 400,
    "#",
    "é",
    "%",
    "x" * 3000,
]
HEADERS = [
    "Host: evil",
    "Host:",
    "Origin: null",
    "Origin: http://",
    "Content-Length: -1",
    "Content-Length: 5",
    "Expect: 100-continue",
    f"Content-Length: {DIGITS}",
    "Transfer-Encoding: chunked",
    "Cookie: peltier_session=\xff",
    "Cookie: " + "=;" * 500,
    "X: " + "y" * 70_000,
    "Authorization: Bearer \xff",
    "Upgrade: websocket\r\nConnection: upgrade",
    "Range: bytes=5-1",
    "Range: bytes=0-",
    "If-None-Match: *",
    "Content-Type: text/plain",
    "X-Forwarded-For: \xff\xfe",
    "Connection: close",
]


def request(number: int, token: str, host: str) -> bytes:
    """The bytes of one mutated request."""
    chance = random.Random(number)
    path, method = chance.choice(PATHS), chance.choice(METHODS)
    if chance.random() < 0.6:
        path, method = chance.choice(["/api/jobs", "/api/jobs", "/api/reset", "/api/session", "/api/stop"]), "POST"
    else:
        for _ in range(chance.choice([0, 0, 1, 2])):
            path += chance.choice(PARTS)
    bodies = [
        {"configuration": "config"},
        {"text": BENCH.format(kind="hold", target=TRACK), "name": "own"},
        {"reason": "well"},
        {"token": token},
        {"configuration": "config", "kind": "calibration"},
        {"press": "x", "by": "y"},
    ]
    tree = chance.choice(bodies)
    body = json.dumps(tree).encode()
    if "text" in tree and chance.random() < 0.7:
        text = mutated("text.toml", str(tree["text"]).encode(), chance).decode("utf-8", "replace")
        body = json.dumps({**tree, "text": text}).encode()
    elif chance.random() < 0.7:
        body = json_text(body, chance) if chance.random() < 0.6 else by_bytes(body, chance)
    body = body if method in ("POST", "PUT", "PATCH", "DELETE") else b""
    heads = [f"Host: {host}", "X-Peltier: 1", "Content-Type: application/json", f"Authorization: Bearer {token}"]
    heads = [head for head in heads if chance.random() < 0.97] + [f"Content-Length: {len(body)}"] * (
        chance.random() < 0.97
    )
    for _ in range(chance.choice([0, 0, 1, 2])):
        heads.append(chance.choice(HEADERS))
    head = f"{method} {path} HTTP/1.1\r\n" + "".join(f"{line}\r\n" for line in heads) + "\r\n"
    whole = head.encode("latin-1", "replace") + body
    return by_bytes(whole, chance) if chance.random() < 0.1 else whole


def answered(host: str, port: int, sent: bytes) -> tuple[int, float]:
    """(status, seconds) of an answer; 0 where the connection was closed without one, -1 where nothing came."""
    begin = time.monotonic()
    try:
        with socket.create_connection((host, port), timeout=LONGEST_S) as connection:
            connection.sendall(sent)
            line = connection.makefile("rb").readline(200)
    except TimeoutError:
        return -1, time.monotonic() - begin
    except OSError:
        line = b""
    word = line.split(b" ")[1:2]
    return int(word[0]) if word and word[0].isdigit() else 0, time.monotonic() - begin


def http_wrong(host: str, port: int, numbers: range, token: str) -> dict[str, Any]:
    """So many mutated requests to one listener, some at a time: one that is incomplete waits for its time-out."""

    def send(number: int) -> tuple[int, int, float]:
        return number, *answered(host, port, request(number, token, f"{host}:{port}"))

    with ThreadPoolExecutor(AT_ONCE) as pool:
        answers = list(pool.map(send, numbers))
    wrong = [
        f"http {number}: status {status} after {took_s:.1f} s"
        for number, status, took_s in answers
        if status == 500 or status < 0 or took_s > LONGEST_S
    ]
    statuses = Counter(status for _, status, _ in answers)
    return {"statuses": statuses, "wrong": wrong, "longest_s": max((took_s for *_, took_s in answers), default=0.0)}


def over_http(first: int, count: int) -> dict[str, Any]:
    """The same against a daemon in a process of its own; every tenth to STOP's own listener."""
    token = "a token of many letters"
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "model.toml").write_text(MODEL)
        (folder / "own.py").write_text(own_effect())
        (folder / "config.toml").write_text(BENCH.format(kind="track_resistance", target=TRACK))
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        log = folder / "log.txt"
        command = [sys.executable, "-m", "rig", "serve", str(folder / "config.toml")]
        with log.open("w") as stderr:
            daemon = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=stderr, text=True)
        try:
            assert daemon.stdout is not None
            place = urlsplit(daemon.stdout.readline().split()[1])
            host, port = str(place.hostname), int(place.port or 0)
            with Client(folder / "bench.sock") as client:
                stop_port = int(client.ask("GET", "/api/state")["stop_port"])
            tenth = count // 10
            found = http_wrong(host, port, range(first, first + count - tenth), token)
            more = http_wrong(host, stop_port, range(first + count - tenth, first + count), token)
            healthy = answered(host, port, f"GET /health HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())[0]
        finally:
            daemon.terminate()
            daemon.wait()
        said = log.read_text(errors="replace")
    wrong = [*found["wrong"], *more["wrong"]]
    wrong += [f"the daemon's log: {line}" for line in said.splitlines() if line.startswith(("Traceback", "Exception"))]
    wrong += [] if healthy == 200 else [f"/health answers {healthy} afterwards"]
    statuses = found["statuses"] + more["statuses"]
    longest_s = max(found["longest_s"], more["longest_s"])
    return {"inputs": count, "statuses": dict(sorted(statuses.items())), "wrong": wrong, "longest_s": longest_s}
