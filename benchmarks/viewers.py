"""Fifty viewers at 10 Hz: does the control loop notice?

    ./peltier benchmark viewers [--viewers 50] [--seconds 20] [--rounds 3] [--json FILE]

A daemon in a process of its own runs a job at 10 Hz on simulated instruments. Stretches without and with fifty readers
of /api/events follow each other, so that what else the computer does touches both alike. A tick's lateness is how far
its row's time lies from a grid of 0.1 s through the stretch. Asked: no effect that can be measured.
"""

from __future__ import annotations

import argparse
import json
import os
import selectors
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.daemon.client import Client
from rig.history.store import connect_to_read

PERIOD_S, SETTLE_S = 0.1, 2.0
BENCH = """
[bench]
time = "real"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
[limits]
temperature_degC = [10, 95]
current_A = 4.0
polarity_share = 0.0
[experiment]
kind = "current_profile"
target = ["start 0.2 A", "hold 6000 s"]
period_s = 0.1
[serve]
port = 0
folder = "kept"
[simulation.film]
relays = 40
"""


def watch(url: str, viewers: int, seconds: float) -> int:
    """Read events on so many connections for a time; returns how many rows came in all."""
    place, rows = urlsplit(url), 0
    selector = selectors.DefaultSelector()
    for _ in range(viewers):
        connection = socket.create_connection((str(place.hostname), place.port or 80))
        connection.sendall(f"GET /api/events HTTP/1.1\r\nHost: {place.netloc}\r\n\r\n".encode())
        connection.setblocking(False)
        selector.register(connection, selectors.EVENT_READ)
    end_s = time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0.0:
        for key, _ in selector.select(left_s):
            assert isinstance(key.fileobj, socket.socket)
            rows += key.fileobj.recv(1 << 16).count(b"event: row")
    for key in list(selector.get_map().values()):
        assert isinstance(key.fileobj, socket.socket)
        key.fileobj.close()
    selector.close()
    return rows


def lateness_s(history: Path, from_s: float, to_s: float) -> list[float]:
    """How far each row lies from the grid, s; the grid goes through the median."""
    connection = connect_to_read(history)
    found = connection.execute(
        "SELECT time_s FROM raw WHERE time_s > ? AND time_s < ? AND phase = 'profile' ORDER BY time_s", (from_s, to_s)
    ).fetchall()
    connection.close()
    phases = [(row[0] - found[0][0] + PERIOD_S / 2.0) % PERIOD_S - PERIOD_S / 2.0 for row in found]
    middle = statistics.median(phases)
    return sorted(abs(phase - middle) for phase in phases)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--viewers", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "bench.toml").write_text(BENCH)
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        root = Path(__file__).resolve().parents[1]
        command = [sys.executable, "-m", "rig", "serve", str(folder / "bench.toml")]
        daemon = subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, text=True)
        try:
            assert daemon.stdout is not None
            url = daemon.stdout.readline().split()[1]
            with Client(folder / "bench.sock") as client:
                client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
                while (client.ask("GET", "/api/state")["job"] or {}).get("phase") != "profile":
                    time.sleep(0.1)
                stretches: dict[str, list[float]] = {"without": [], "with": []}
                seen = 0
                for _ in range(options.rounds):
                    for name, viewers in (("without", 0), ("with", options.viewers)):
                        begin_s = time.time()
                        seen += watch(url, viewers, options.seconds) if viewers else 0
                        if not viewers:
                            time.sleep(options.seconds)
                        history = folder / "kept" / "history.sqlite"
                        stretches[name] += lateness_s(history, begin_s + SETTLE_S, time.time())
                missed = client.ask("GET", "/api/state")["ticks"]["missed"]
                client.ask("POST", "/api/stop", by="the benchmark")
        finally:
            daemon.terminate()
            daemon.wait()
    result: dict[str, list[float]] = {}
    print(f"{'lateness of ticks, ms':<28}{'ticks':>8}{'median':>9}{'95 %':>9}{'99 %':>9}{'most':>9}")
    for name, values in stretches.items():
        values.sort()
        result[name] = [1e3 * values[min(len(values) - 1, int(q * len(values)))] for q in (0.5, 0.95, 0.99, 1.0)]
        told = f"{name} {options.viewers} viewers" if name == "with" else "without viewers"
        print(f"{told:<28}{len(values):>8}" + "".join(f"{value:>9.2f}" for value in result[name]))
    expected = options.viewers * options.rounds * options.seconds / PERIOD_S
    print(f"rows that the viewers got: {seen} of {expected:.0f}; ticks missed: {missed}        asked: no effect")
    if options.json:
        Path(options.json).write_text(json.dumps({**result, "rows": seen, "missed": missed}) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
