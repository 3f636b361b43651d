"""Many rigs: how soon an EPICS client has a reading and its STOP is at the instrument; twenty rigs under one overview.

    ./peltier benchmark many_rigs [--only epics,rigs] [--stops 10] [--readings 300] [--rigs 20] [--seconds 60]

EPICS: a daemon holds emulated instruments on pseudo-terminals and runs a job at 10 Hz, `peltier epics` beside it; p4p
in this process is the client, on PV Access. A reading's way is from the moment at which the emulated controller looks
at its thermometer (the bytes on the wire, the rest of the tick and the commit to the disk included). STOP's way is from
the put until the emulated controller's output is off. Asked: 50 and 100 ms.

Rigs: so many daemons on simulated instruments, every other one with a job at 1 Hz, the others idle at 1 Hz, under an
overview that asks each once a second and that somebody looks at. Asked: 0 ticks missed. What else the computer does
counts: its load stands beside the figures.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import statistics
import sys
import tempfile
import threading
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks._harness import kept, options
from benchmarks.stop import BENCH, LONGEST_S, Watched, process, served, until
from rig.daemon.client import Client, Refusal
from rig.history.store import connect_to_read

PREFIX = "RIG"
TEMPERATURE = 1000  # parameter
RIG = BENCH.format(controller="sim://", meter="sim://").replace("period_s = 0.1", "period_s = 1.0")
HEADERS = {"X-Peltier": "1", "Content-Type": "application/json"}


def free_ports() -> int:
    """The first of two ports of the loopback that are free."""
    while True:
        with socket.socket() as first, socket.socket() as second, contextlib.suppress(OSError, OverflowError):
            first.bind(("127.0.0.1", 0))
            second.bind(("127.0.0.1", int(first.getsockname()[1]) + 1))
            return int(first.getsockname()[1])


def epics(stops: int, readings: int) -> dict[str, list[float]]:
    """Latencies, s."""
    from p4p.client.thread import Context

    pva = free_ports()
    table = f'[epics]\nprefix = "{PREFIX}"\nca_port = {free_ports()}\npva_port = {pva}\n'
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        watched, _ = stack.enter_context(served(folder, table))
        stack.enter_context(process(["epics", str(folder / "bench.toml")], folder / "bench.sock"))
        where = {"EPICS_PVA_ADDR_LIST": f"127.0.0.1:{pva + 1}", "EPICS_PVA_AUTO_ADDR_LIST": "NO"}
        context = Context("pva", conf={**where, "EPICS_PVA_BROADCAST_PORT": str(pva + 1)}, useenv=False)
        stack.callback(context.close)
        context.put(f"{PREFIX}:STOP", 1, timeout=LONGEST_S, wait=True)  # a first one, so that all is connected
        begin(folder, watched)
        return {
            **readings_of(context, folder, watched, readings),
            "STOP, until the controller has it": [stopped(context, folder, watched) for _ in range(stops)],
        }


def begin(folder: Path, watched: Watched) -> None:
    """A job with the output on."""
    with Client(folder / "bench.sock") as client:
        with contextlib.suppress(Refusal):  # nothing is latched
            client.ask("POST", "/api/reset", reason="the benchmark")
        client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
    until(lambda: watched.on)


def readings_of(context: Any, folder: Path, watched: Watched, count: int) -> dict[str, list[float]]:
    """How long readings took to the client, from the emulated thermometer and from the daemon's socket."""
    looked_s: list[float] = []
    at_client: dict[int, float] = {}
    at_socket: dict[int, float] = {}
    enough = threading.Event()
    read = watched.instrument._measured[TEMPERATURE]

    def looked() -> float:
        looked_s.append(time.time())
        return float(read())

    def listen() -> None:
        with contextlib.closing(Client(folder / "bench.sock")) as client:
            for told in client.events(LONGEST_S):
                if told["event"] == "row":
                    at_socket[round(told["data"]["time_s"] * 1e4)] = time.time()
                if enough.is_set():
                    return

    def take(value: Any) -> None:
        at_client.setdefault(round(value.timestamp * 1e4), time.time())
        if len(at_client) > count:
            enough.set()

    watched.instrument._measured[TEMPERATURE] = looked
    thread = threading.Thread(target=listen)
    thread.start()
    with contextlib.closing(context.monitor(f"{PREFIX}:TEMPERATURE", take)):
        enough.wait(LONGEST_S)
    enough.set()
    thread.join()
    both = sorted(set(at_client) & set(at_socket) - {min(at_client)})  # without what was there before
    # the last look before a reading's own time stamp is the one that it came from
    taken_s = [max((s for s in looked_s if s <= k / 1e4), default=0.0) for k in both]
    return {
        "reading, from the thermometer": [at_client[k] - s for k, s in zip(both, taken_s, strict=True)],
        "of that, from the daemon's socket": [at_client[k] - at_socket[k] for k in both],
    }


def stopped(context: Any, folder: Path, watched: Watched) -> float:
    """How long a STOP took."""
    if not watched.on:
        begin(folder, watched)
    time.sleep(0.5)
    watched.off_s, began_s = 0.0, time.perf_counter()
    context.put(f"{PREFIX}:STOP", 1, timeout=LONGEST_S, wait=True)
    until(lambda: watched.off_s)
    return watched.off_s - began_s


def rigs(count: int, seconds: float) -> dict[str, Any]:
    """What came of many daemons under one overview."""
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folders = [Path(temporary) / f"rig{k:02}" for k in range(count)]
        lines = ["[overview]", "port = 0"]
        for folder in folders:
            folder.mkdir()
            (folder / "bench.toml").write_text(RIG.replace("[serve]", f'[serve]\nname = "{folder.name}"'))
            _, line = stack.enter_context(process(["serve", "bench.toml"], folder / "bench.sock"))
            lines += ["[[bench]]", f'name = "{folder.name}"', f'address = "{line.split()[1].rstrip("/")}"']
        for folder in folders[::2]:
            with Client(folder / "bench.sock", LONGEST_S) as client:
                client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
                until(lambda client=client: client.ask("GET", "/api/state")["state"] == "running")
        (folders[0] / "overview.toml").write_text("\n".join(lines) + "\n")
        _, line = stack.enter_context(process(["overview", "overview.toml"], folders[0] / "none"))
        place = line.split()[1].split("//")[1].rstrip("/")
        until(lambda: not silent(place))
        looks, began_s = [], time.time()
        while time.time() < began_s + seconds:
            time.sleep(1.0)
            looks.append(len(silent(place)))
        rows = [times_s(folder, began_s, time.time()) for folder in folders]
        stops_s = [through_the_overview(place, folder.name) for folder in folders[::2]]
    steps = [b - a for each in rows for a, b in pairwise(each)]
    return {
        "rows": sum(map(len, rows)),
        "ticks missed": sum(max(0, round(step) - 1) for step in steps),
        "longest step, s": max(steps, default=0.0),
        "shown as silent": sum(looks),
        "STOP through the overview, median, ms": 1e3 * statistics.median(stops_s),
        "load": os.getloadavg()[0],
    }


def times_s(folder: Path, from_s: float, to_s: float) -> list[float]:
    """When a rig's rows of a stretch were read, as its history has it: a tick that was missed has none."""
    with contextlib.closing(connect_to_read(folder / "kept" / "history.sqlite")) as connection:
        question = "SELECT time_s FROM raw WHERE time_s > ? AND time_s < ? ORDER BY time_s"
        return [float(row[0]) for row in connection.execute(question, (from_s, to_s))]


def asked_of(place: str, method: str, path: str, body: Any = None) -> Any:
    """An answer of the overview."""
    connection = http.client.HTTPConnection(place, timeout=LONGEST_S)
    connection.request(method, path, json.dumps(body) if body is not None else None, HEADERS)
    with contextlib.closing(connection):
        return json.loads(connection.getresponse().read())


def silent(place: str) -> list[str]:
    """The benches that the overview shows as not answering."""
    return [bench["name"] for bench in asked_of(place, "GET", "/api/state")["benches"] if bench["trouble"]]


def through_the_overview(place: str, name: str) -> float:
    """STOP through the overview, until it was confirmed, s."""
    began_s = time.perf_counter()
    answer = asked_of(place, "POST", "/api/stop", {"bench": name})
    assert answer.get("confirmed"), answer
    return time.perf_counter() - began_s


def main() -> int:
    asked = options(__doc__, only=("epics", "rigs"), stops=10, readings=300, rigs=20, seconds=60.0)
    found: dict[str, Any] = {}
    if "epics" in asked.only:
        found["epics"] = epics(asked.stops, asked.readings)
        print(f"{'EPICS, ms':<40}{'count':>7}{'median':>9}{'95 %':>9}{'most':>9}   load {os.getloadavg()[0]:.1f}")
        for (name, values), most in zip(found["epics"].items(), ("asked 50", "", "asked 100"), strict=True):
            told = sorted(1e3 * value for value in values)
            figures = (statistics.median(told), told[int(0.95 * (len(told) - 1))], told[-1])
            print(f"{name:<40}{len(told):>7}" + "".join(f"{value:>9.1f}" for value in figures) + f"   {most}")
    if "rigs" in asked.only:
        found["rigs"] = rigs(asked.rigs, asked.seconds)
        print(f"\n{asked.rigs} rigs, half of them with a job, {asked.seconds:g} s (asked: no ticks missed)")
        for name, value in found["rigs"].items():
            print(f"{name:<40}{value:>9.5g}")
    kept(asked.json, found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
