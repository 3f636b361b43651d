"""Many rigs: how soon an EPICS client has a reading and its STOP is at the instrument; twenty rigs under one overview.

    ./peltier benchmark many_rigs [--only epics|rigs] [--stops 10] [--readings 300] [--rigs 20] [--seconds 60]
                                  [--json FILE]

EPICS: a daemon holds emulated instruments on pseudo-terminals and runs a job at 10 Hz, `peltier epics` beside it; p4p
in this process is the client, on PV Access. A reading's way is from the moment at which the emulated controller looks
at its thermometer (the bytes on the wire, the rest of the tick and the commit to the disk included); beside it the part
that EPICS adds, from the daemon's socket to the client. STOP's way is from the put until the emulated controller's
output is off. Asked: 50 and 100 ms.

Rigs: so many daemons on simulated instruments, every other one with a job at 1 Hz, the others idle at 1 Hz. A stretch
without, then one with an overview that asks each once a second and that somebody looks at. Counted: ticks missed in
each, looks at which a bench was shown as silent. Then each running job is stopped through the overview. Asked: 0 ticks
missed. What else the computer does counts: its load stands beside the figures.
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stop_latency import BENCH, Watched, until

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.daemon.client import Client, Refusal
from rig.history.store import connect_to_read
from rig.ports.pseudo_terminal import PseudoTerminals

ROOT = Path(__file__).resolve().parents[1]
PREFIX = "RIG"
TEMPERATURE = 1000  # parameter
STARTS_S = 240.0  # for a process to be there, on a busy computer
HEADERS = {"X-Peltier": "1", "Content-Type": "application/json"}


def load() -> float:
    """Processes that want to run, on average over the last minute."""
    return os.getloadavg()[0]


@contextlib.contextmanager
def process(words: list[str], place: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A verb of peltier in a process of its own, and its first line."""
    environment = {**os.environ, "PELTIER_SOCKET": str(place), "PYTHONPATH": str(ROOT)}
    one = subprocess.Popen(
        [sys.executable, "-m", "rig", *words], stdout=subprocess.PIPE, text=True, env=environment, cwd=place.parent
    )
    try:
        assert one.stdout is not None
        line = one.stdout.readline()
        if not line:
            raise SystemExit(f"peltier {words[0]} did not start")
        yield one, line
    finally:
        one.terminate()
        one.wait()


def free_ports() -> int:
    """The first of two ports of the loopback that are free."""
    while True:
        with socket.socket() as first, socket.socket() as second, contextlib.suppress(OSError, OverflowError):
            first.bind(("127.0.0.1", 0))
            second.bind(("127.0.0.1", int(first.getsockname()[1]) + 1))
            return int(first.getsockname()[1])


# EPICS


def epics(options: argparse.Namespace) -> dict[str, list[float]]:
    """Latencies, s."""
    from p4p.client.thread import Context

    pva = free_ports()
    table = f'[epics]\nprefix = "{PREFIX}"\nca_port = {free_ports()}\npva_port = {pva}\n'
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folder = Path(temporary)
        path, place = folder / "bench.toml", folder / "bench.sock"
        path.write_text(BENCH.format(controller="sim://", meter="sim://"))
        emulated = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
        watched = emulated["controller"] = Watched(emulated["controller"])
        answered = note_answers(watched)
        terminals = stack.enter_context(PseudoTerminals(emulated))
        path.write_text(BENCH.format(**terminals.paths) + table)
        stack.enter_context(process(["serve", str(path)], place))
        stack.enter_context(process(["epics", str(path)], place))
        where = {"EPICS_PVA_ADDR_LIST": f"127.0.0.1:{pva + 1}", "EPICS_PVA_AUTO_ADDR_LIST": "NO"}
        context = Context("pva", conf={**where, "EPICS_PVA_BROADCAST_PORT": str(pva + 1)}, useenv=False)
        stack.callback(context.close)
        context.put(f"{PREFIX}:STOP", 1, timeout=STARTS_S, wait=True)  # a first one, so that all is connected
        found = readings(context, path, place, watched, answered, options.readings)
        return {**found, "STOP, until the controller has it": stops(context, path, place, watched, options.stops)}


def note_answers(watched: Watched) -> list[float]:
    """When the emulated controller looked at its thermometer, Unix s; the list grows as it is asked."""
    asked_s: list[float] = []
    measured = watched.instrument._measured
    read = measured[TEMPERATURE]

    def noted() -> float:
        asked_s.append(time.time())
        return float(read())

    measured[TEMPERATURE] = noted
    return asked_s


def begin(path: Path, place: Path, watched: Watched) -> None:
    """A job with the output on."""
    with Client(place) as client:
        with contextlib.suppress(Refusal):  # nothing is latched
            client.ask("POST", "/api/reset", reason="the benchmark")
        client.ask("POST", "/api/jobs", path=str(path))
    until(lambda: watched.on)


def readings(
    context: Any, path: Path, place: Path, watched: Watched, answered: list[float], count: int
) -> dict[str, list[float]]:
    """How long readings took, from the instrument and from the daemon's socket."""
    begin(path, place, watched)
    at_client: dict[int, float] = {}
    at_socket: dict[int, float] = {}
    enough = threading.Event()

    def listen() -> None:
        with contextlib.closing(Client(place)) as client:
            for told in client.events(STARTS_S):
                if told["event"] == "row":
                    at_socket[round(told["data"]["time_s"] * 1e4)] = time.time()
                if enough.is_set():
                    return

    def take(value: Any) -> None:
        at_client.setdefault(round(value.timestamp * 1e4), time.time())
        if len(at_client) > count:
            enough.set()

    thread = threading.Thread(target=listen)
    thread.start()
    subscription = context.monitor(f"{PREFIX}:TEMPERATURE", take)
    enough.wait(STARTS_S)
    subscription.close()
    enough.set()
    thread.join()
    first = min(at_client)  # what was there before
    both = sorted(set(at_client) & set(at_socket) - {first})
    # the last answer before a reading's own time stamp is the one that it came from
    taken_s = [max((at_s for at_s in answered if at_s <= k / 1e4), default=0.0) for k in both]
    return {
        "reading, from the thermometer": [at_client[k] - at_s for k, at_s in zip(both, taken_s, strict=True)],
        "of that, from the daemon's socket": [at_client[k] - at_socket[k] for k in both],
    }


def stops(context: Any, path: Path, place: Path, watched: Watched, count: int) -> list[float]:
    """How long each STOP took."""
    found = []
    for _ in range(count):
        if not watched.on:
            begin(path, place, watched)
        time.sleep(0.5)
        watched.off_s = 0.0
        began_s = time.perf_counter()
        context.put(f"{PREFIX}:STOP", 1, timeout=STARTS_S, wait=True)
        until(lambda: watched.off_s)
        found.append(watched.off_s - began_s)
    return found


# many rigs

RIG = BENCH.format(controller="sim://", meter="sim://").replace("period_s = 0.1", "period_s = 1.0")


def rigs(options: argparse.Namespace) -> dict[str, Any]:
    """What came of many daemons under one overview."""
    with tempfile.TemporaryDirectory() as temporary, contextlib.ExitStack() as stack:
        folders = [Path(temporary) / f"rig{k:02}" for k in range(options.rigs)]
        pids, lines = [], ["[overview]", "port = 0"]
        for folder in folders:
            folder.mkdir()
            (folder / "bench.toml").write_text(RIG.replace("[serve]", f'[serve]\nname = "{folder.name}"'))
            one, line = stack.enter_context(process(["serve", "bench.toml"], folder / "bench.sock"))
            pids.append(one.pid)
            lines += ["[[bench]]", f'name = "{folder.name}"', f'address = "{line.split()[1].rstrip("/")}"']
            print(f"\r{folder.name}", end="", file=sys.stderr, flush=True)
        running = folders[::2]
        for folder in running:
            with Client(folder / "bench.sock") as client:
                client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
        until(lambda: all(state(folder)["state"] == "running" for folder in running))
        time.sleep(5.0)
        found: dict[str, Any] = {"load_before": load()}
        found["without"] = stretch(folders, pids, options.seconds, None)
        (folders[0] / "overview.toml").write_text("\n".join(lines) + "\n")
        overview, line = stack.enter_context(process(["overview", "overview.toml"], folders[0] / "none"))
        place = line.split()[1].split("//")[1].rstrip("/")
        until(lambda: not silent(place))
        found["with"] = stretch(folders, [*pids, overview.pid], options.seconds, place)
        found["overview_MB"] = resident_MB(overview.pid)
        found["rig_MB"] = statistics.median(resident_MB(pid) for pid in pids)
        found["stops_s"] = [stop(place, folder.name) for folder in running]
        return found


def state(folder: Path) -> dict[str, Any]:
    """A daemon's state."""
    with Client(folder / "bench.sock", STARTS_S) as client:
        found: dict[str, Any] = client.ask("GET", "/api/state")
        return found


def stretch(folders: list[Path], pids: list[int], seconds: float, overview: str | None) -> dict[str, float]:
    """Rows and ticks missed meanwhile, and what it took."""
    looks = quiet = 0
    cpu_s, began_s, from_s = sum(map(processor_s, pids)), time.monotonic(), time.time()
    while time.monotonic() < began_s + seconds:
        time.sleep(1.0)
        if overview is not None:
            looks, quiet = looks + len(folders), quiet + len(silent(overview))
    took_s, to_s = time.monotonic() - began_s, time.time()
    rows = [times_s(folder, from_s, to_s) for folder in folders]
    return {
        "rows": sum(map(len, rows)),
        "missed": sum(max(0, round(b - a) - 1) for each in rows for a, b in pairwise(each)),
        "longest_s": max((b - a for each in rows for a, b in pairwise(each)), default=0.0),
        "processors": (sum(map(processor_s, pids)) - cpu_s) / took_s,
        "looks": looks,
        "shown_silent": quiet,
        "load": load(),
    }


def times_s(folder: Path, from_s: float, to_s: float) -> list[float]:
    """When a rig's rows of a stretch were read, as its history has it: a tick that was missed has none."""
    connection = connect_to_read(folder / "kept" / "history.sqlite")
    try:
        question = "SELECT time_s FROM raw WHERE time_s > ? AND time_s < ? ORDER BY time_s"
        return [float(row[0]) for row in connection.execute(question, (from_s, to_s))]
    finally:
        connection.close()


def asked(place: str, method: str, path: str, body: Any = None) -> Any:
    """An answer of the overview."""
    connection = http.client.HTTPConnection(place, timeout=STARTS_S)
    connection.request(method, path, json.dumps(body) if body is not None else None, HEADERS)
    answer = json.loads(connection.getresponse().read())
    connection.close()
    return answer


def silent(place: str) -> list[str]:
    """The benches that the overview shows as not answering."""
    return [bench["name"] for bench in asked(place, "GET", "/api/state")["benches"] if bench["trouble"]]


def stop(place: str, name: str) -> float:
    """STOP through the overview, until it was confirmed, s."""
    began_s = time.perf_counter()
    answer = asked(place, "POST", "/api/stop", {"bench": name})
    assert answer.get("confirmed"), answer
    return time.perf_counter() - began_s


def family(pid: int) -> list[int]:
    """A process and those that it began."""
    children = [child for path in Path(f"/proc/{pid}/task").glob("*/children") for child in path.read_text().split()]
    return [pid, *(one for child in children for one in family(int(child)))]


def processor_s(pid: int) -> float:
    """Processor time of a process and those that it began, s."""
    fields = (Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split() for one in family(pid))
    return sum(int(each[11]) + int(each[12]) for each in fields) / os.sysconf("SC_CLK_TCK")


def resident_MB(pid: int) -> float:
    """Their memory, shared parts shared out (PSS)."""
    lines = (Path(f"/proc/{one}/smaps_rollup").read_text().splitlines() for one in family(pid))
    return sum(float(line.split()[1]) for each in lines for line in each if line.startswith("Pss:")) / 1e3


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--only", choices=["epics", "rigs"])
    parser.add_argument("--stops", type=int, default=10)
    parser.add_argument("--readings", type=int, default=300)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json")
    options = parser.parse_args()
    found: dict[str, Any] = {}
    if options.only != "rigs":
        found["epics"] = epics(options)
        print(f"{'EPICS, ms':<44}{'count':>7}{'median':>9}{'95 %':>9}{'most':>9}   load {load():.1f}")
        for name, values in found["epics"].items():
            told = sorted(1e3 * value for value in values)
            asked_ms = "asked 100" if name.startswith("STOP") else "asked 50" if name.startswith("reading") else ""
            figures = (statistics.median(told), told[int(0.95 * (len(told) - 1))], told[-1])
            print(f"{name:<44}{len(told):>7}" + "".join(f"{value:>9.1f}" for value in figures) + f"   {asked_ms}")
    if options.only != "epics":
        found["rigs"] = rigs(options)
        tell_rigs(found["rigs"], options)
    if options.json:
        Path(options.json).write_text(json.dumps(found) + "\n")
    return 0


def tell_rigs(found: dict[str, Any], options: argparse.Namespace) -> None:
    """The figures of many rigs."""
    print(f"\n{options.rigs} rigs, half of them with a job, {options.seconds:g} s; load {found['load_before']:.1f}")
    for name in ("without", "with"):
        one = found[name]
        print(
            f"{name + ' an overview':<22}{one['rows']:>7.0f} rows, {one['missed']:.0f} ticks missed (asked 0), "
            f"longest step {one['longest_s']:.2f} s, {one['processors']:.2f} processors, load {one['load']:.1f}"
        )
    shown = found["with"]
    print(f"shown as silent: {shown['shown_silent']} of {shown['looks']} looks, though it was not")
    print(f"memory: {found['rig_MB']:.0f} MB a rig, {found['overview_MB']:.0f} MB the overview")
    stopped = [1e3 * value for value in found["stops_s"]]
    print(f"STOP through the overview: {statistics.median(stopped):.0f} ms in the median, {max(stopped):.0f} at most")


if __name__ == "__main__":
    sys.exit(main())
