"""Bad input ends in one clear line: mutated inputs over all verbs and files, and over HTTP.

    ./peltier benchmark mutated_input [--count 10000] [--http 10000] [--seed 0] [--json FILE]

Good inputs (configurations, records, models, targets, effects of one's own, run folders, words on the command line)
are changed by bytes and by structure, and given to a verb: each in a process of its own, forked from one that has
everything loaded. The HTTP half is sent to a daemon's page and to STOP's own listener: methods, addresses, headers,
bodies. Wrong is a traceback, an end by a signal, a status that is not documented, a 500, and whatever takes over 60 s.
Asked: none. What is wrong is printed with its seed; --first N --count 1 does that one again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._mutations import DIGITS, by_bytes, json_text, mutated
from rig.__main__ import main as peltier

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 60.0
AT_ONCE = 48  # requests
ENDS_S = 1.5  # verbs that run until they are stopped are stopped after this
PATIENCE_S = 30.0  # and an experiment that a mutation has made long after this
ENDLESS = {"emulate", "serve"}
LONG = {"run", "calibrate", "simulate", "sweep", "replay", "check"}
MEMORY = 8 << 30  # bytes of address space: beyond it, an input made something much too large
DOCUMENTED = {0, 1, 2, 10, 11, 75, 128 + signal.SIGTERM}
TRACEBACK = 99
MODEL = """[film]
kind = "extended_generalized_pi"
output = "minus_log10_ohm"
radii = [0.05, 0.2, 0.5]
weights = [0.4, 0.3, 0.2]
initial = "cooled"
[film.rising]
function = "tanh"
a = 0.2
b = -12.6
[film.falling]
function = "tanh"
a = 0.2
b = -11.8
[film.memoryless]
function = "tanh"
amplitude = 0.4
a = 0.03
b = -1.6
offset = -4.0
[plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = 1.6e-3
resistance_over_capacity_K_per_A2_s = 0.06
conductance_over_capacity_per_s = 0.018
ambient_degC = 25.0
[[effects]]
name = "film_lag"
tau_s = 2.0
"""
BENCH = """[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
baud = 57600
dead_man_s = 5.0
[bench.meter]
driver = "keithley2000"
port = "sim://"
nplc = 1.0
[limits]
temperature_degC = [10, 95]
current_A = 4.0
meter_current_A = 1e-3
stale_s = 2.0
rate_K_per_s = 20.0
runaway_s = 20.0
polarity_share = 0.0
[experiment]
kind = "{kind}"
name = "film-7"
target = {target}
model = "model.toml"
law = "full"
period_s = 0.1
settle_s = 0.5
[control]
ms = 1.4
preview_s = 2.0
[calibration]
rate_K_per_s = 5.0
minor_loops = 2
[simulation]
first_degC = 60.0
seed = 1
[simulation.film]
kind = "preisach"
relays = 20
[[simulation.effects]]
name = "film_lag"
tau_s = 2.0
[sweep]
seeds = 1
[sweep.parameters]
"control.ms" = [1.4]
[serve]
port = 0
folder = "kept"
token = "a token of many letters"
hosts = ["https://bench.lab.example"]
"""
TRACK = '["start 20 kohm", "hold 1 s", "ramp to 15 kohm at 0.5 dec/s"]'
OWN = (ROOT / "docs" / "own_effect.md").read_text(encoding="utf-8")
ANSWERS = [["--json", "-"], ["--json", "out.json"], ["--json", "no/such/folder.json"], ["--json", "config.toml"], []]
OUTS = ["out", "out.csv", "taken", "link", "dangling", "no/such/out", "/", "x" * 300, "new/deep", "a?b#c%41"]
WORDS = ["0", "-1", "1e308", "nan", DIGITS, "", "é", "a=b", "temperature_degC=T@K", "film_lag:tau_s=1e308", "-50,200"]


@dataclass(frozen=True)
class Case:
    """A verb with its words, and the one file that is made bad (or none)."""

    verb: str
    words: tuple[str, ...]
    files: tuple[str, ...]


CASES = [
    Case("run", ("config.toml", "--out", "OUT"), ("config.toml", "model.toml")),
    Case("run", ("profile.toml", "--out", "OUT"), ("profile.toml", "target.csv")),
    Case("calibrate", ("config.toml", "--out", "OUT"), ("config.toml",)),
    Case("identify", ("record.csv", "--out", "OUT", "--operators", "4"), ("record.csv",)),
    Case("identify", ("record.csv", "--column=WORD", "--kind", "generalized_pi", "--operators=WORD"), ("record.csv",)),
    Case("predict", ("model.toml", "record.csv", "--out", "OUT"), ("model.toml", "record.csv")),
    Case("predict", ("model.toml", "record.csv", "--initial", "fitted", "--column=WORD"), ("model.toml", "record.csv")),
    Case("diagnose", ("short.csv", "--report", "OUT"), ("short.csv",)),
    Case("invert", ("model.toml", "target.csv", "--out", "OUT"), ("model.toml", "target.csv")),
    Case("invert", ("model.toml", "target.csv", "--limits=WORD"), ("model.toml", "target.csv")),
    Case("simulate", ("config.toml", "--out", "OUT"), ("config.toml", "model.toml")),
    Case("simulate", ("current.toml", "--effect-file=own.py", "--effect=plate_fin", "--out", "OUT"), ("own.py",)),
    Case("simulate", ("current.toml", "--out", "OUT", "--effect=WORD"), ("current.toml", "model.toml")),
    Case("simulate", ("current.toml", "--out", "OUT", "--seed=WORD"), ("current.toml", "target.csv")),
    Case(
        "replay", ("run",), ("run/run.json", "run/record.csv", "run/events.jsonl", "run/config.toml", "run/model.toml")
    ),
    Case("replay", ("run", "--config", "config.toml", "--out", "OUT"), ("config.toml", "run/model.toml")),
    Case("tune", ("config.toml",), ("config.toml", "model.toml")),
    Case("check", ("config.toml",), ("config.toml",)),
    Case("off", ("config.toml",), ("config.toml",)),
    Case("emulate", ("config.toml", "--speed=WORD"), ("config.toml",)),
    Case("serve", ("config.toml",), ("config.toml",)),
    Case("sweep", ("config.toml", "--out", "OUT", "--workers", "1"), ("config.toml",)),
    Case("init", ("OUT",), ()),
    Case("reset", ("--reason=WORD"), ()),
    Case("ports", ("WORD",), ()),
]
RARE = {
    "sweep": 0.1,
    "own.py": 0.05,
    "serve": 0.2,
    "calibrate": 0.2,
    "emulate": 0.4,
    "init": 0.2,
    "reset": 0.2,
    "ports": 0.2,
    "diagnose": 0.5,
}


def lay_out(folder: Path) -> None:
    """Good inputs for every verb."""
    (folder / "model.toml").write_text(MODEL)
    (folder / "own.py").write_text(_own_effect())
    (folder / "config.toml").write_text(BENCH.format(kind="track_resistance", target=TRACK))
    (folder / "profile.toml").write_text(BENCH.format(kind="temperature_profile", target='"target.csv"'))
    (folder / "current.toml").write_text(
        BENCH.format(kind="current_profile", target='["start 0 A", "ramp to 1 A in 4 s"]')
    )
    rows = [f"{t},{60 + 0.2 * t:.3f},{20_000 - 50 * t},{0.1 * t:.2f}" for t in range(20)]
    (folder / "target.csv").write_text("time_s,setpoint_degC,target_ohm,current_A\n" + "\n".join(rows) + "\n")
    said = peltier(["simulate", str(folder / "current.toml"), "--out", str(folder / "record.csv")])
    assert said == 0
    lines = (folder / "record.csv").read_text().splitlines(keepends=True)
    (folder / "short.csv").write_text("".join(lines[:13]))
    assert peltier(["run", str(folder / "config.toml"), "--out", str(folder / "run")]) in (0, 10)
    (folder / "taken").mkdir()
    (folder / "taken" / "file").write_text("")
    (folder / "link").symlink_to("taken")
    (folder / "dangling").symlink_to("nowhere")


def _own_effect() -> str:
    """The example of docs/own_effect.md."""
    return OWN.partition("```python\n")[2].partition("```")[0]


def warm_up(folder: Path) -> None:
    """Each verb once with good inputs, so that what is forked has everything loaded and compiled."""
    here = os.getcwd()
    os.chdir(folder)
    try:
        for case in CASES:
            if case.verb not in ("emulate", "serve", "sweep", "init", "run", "ports", "calibrate", "reset"):
                words = [f"warm-{k}" if w == "OUT" else w for k, w in enumerate(case.words) if "WORD" not in w]
                peltier([case.verb, *words])
                for name in [word for word in words if word.startswith("warm-")]:
                    shutil.rmtree(name, ignore_errors=True)
                    Path(name).unlink(missing_ok=True)
    finally:
        os.chdir(here)


def one(number: int, good: Path, folder: Path) -> tuple[str, int, str, float]:
    """(what was done, exit status or TRACEBACK, stderr, seconds) of one mutated input."""
    chance = random.Random(number)
    while True:
        case = chance.choice(CASES)
        if chance.random() < RARE.get("own.py" if "own.py" in case.files else case.verb, 1.0):
            break
    words = [w.replace("OUT", chance.choice(OUTS)).replace("WORD", chance.choice(WORDS)) for w in case.words]
    words += chance.choice(ANSWERS) if case.verb not in ("emulate", "serve", "init", "reset") else []
    shutil.copytree(good, folder, symlinks=True)
    name = ""
    if case.files and chance.random() < 0.93:
        name = chance.choice(case.files)
        content = (folder / name).read_bytes()
        for _ in range(chance.choice([1, 1, 1, 2])):
            content = mutated(name, content, chance)
        (folder / name).write_bytes(content)
    begin = time.monotonic()
    status = _forked([case.verb, *words], folder)
    took_s = time.monotonic() - begin
    said = (folder / "stderr").read_text(errors="replace")
    shutil.rmtree(folder)
    return f"{case.verb} {' '.join(words)[:100]} [{name}]", status, said, took_s


def _forked(words: list[str], folder: Path) -> int:
    """The exit status of the verb in a process of its own; -n where signal n ended it."""
    child = os.fork()
    if child == 0:
        _child(words, folder)
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -signal.SIGKILL


def _child(words: list[str], folder: Path) -> None:
    status = TRACEBACK
    try:
        os.setsid()
        os.chdir(folder)
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        for number, name, mode in (
            (0, os.devnull, os.O_RDONLY),
            (1, "stdout", os.O_CREAT | os.O_WRONLY),
            (2, "stderr", os.O_CREAT | os.O_WRONLY),
        ):
            os.dup2(os.open(name, mode), number)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        if words[0] in ENDLESS | LONG:
            signal.setitimer(signal.ITIMER_REAL, ENDS_S if words[0] in ENDLESS else PATIENCE_S)
            signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
        status = peltier(words)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(status)


def wrong_with(status: int, said: str) -> str:
    """What is wrong with how a verb ended; nothing where nothing is."""
    if status == TRACEBACK or "Traceback (most recent call last)" in said:
        return f"traceback: {said.strip().splitlines()[-1][:200] if said.strip() else ''}"
    if status == -signal.SIGKILL:
        return f"longer than {LONGEST_S:g} s, or killed"
    if status not in DOCUMENTED:
        return f"status {status}"
    if status == 2 and not said.strip():
        return f"status {status} without a line"
    return ""


def verbs(first: int, count: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """So many mutated inputs over the verbs, in one process after the other, two at a time."""
    statuses: Counter[int] = Counter()
    wrong, longest_s = [], 0.0
    with tempfile.TemporaryDirectory() as temporary:
        good = Path(temporary) / "good"
        good.mkdir()
        lay_out(good)
        warm_up(good)
        for number in range(first, first + count):
            what, status, said, took_s = one(number, good, Path(temporary) / f"case{number}")
            statuses[status] += 1
            longest_s = max(longest_s, took_s)
            if fault := wrong_with(status, said):
                wrong.append(f"{number}: {what}: {fault}")
                tell(f"WRONG {wrong[-1]}\n{said[-1500:]}")
    return {"inputs": count, "statuses": dict(sorted(statuses.items())), "wrong": wrong, "longest_s": longest_s}


# -- over HTTP ------------------------------------------------------------------------------------------------------

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
        (folder / "own.py").write_text(_own_effect())
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
            from rig.daemon.client import Client

            with Client(folder / "bench.sock") as client:
                stop_port = int(client.ask("state")["state"]["stop_port"])
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--http", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, metavar="N", help="seed of the first input")
    parser.add_argument("--json")
    options = parser.parse_args()
    figures = {}
    if options.count:
        tell = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
        figures["verbs"] = verbs(options.first, options.count, tell)
    if options.http:
        figures["http"] = over_http(options.first, options.http)
    for name, found in figures.items():
        print(
            f"{name}: {found['inputs']} mutated inputs, {len(found['wrong'])} wrong (asked: 0), the longest took "
            f"{found['longest_s']:.1f} s (asked: 60); by status: {found['statuses']}"
        )
        for line in found["wrong"][:50]:
            print(f"  {line}")
    if options.json:
        Path(options.json).write_text(json.dumps(figures, indent=1) + "\n")
    return 1 if any(found["wrong"] for found in figures.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
