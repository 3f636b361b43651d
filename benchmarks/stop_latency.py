"""From STOP to the instrument: how long until the controller has the command.

    ./peltier benchmark stop_latency [--stops 7] [--json FILE]

A daemon in a process of its own holds emulated instruments on pseudo-terminals and runs a job with the output on. Then
STOP is sent as the page sends it (HTTP), as `peltier stop` sends it (the daemon's socket, from this process), and by
`peltier off` as one types it, in a checkout and installed, the start of Python included. Measured at the emulated
controller: from the moment the request leaves, or the command is begun, until its output is off. Asked: 200 ms in the
median. (How long a browser takes to send it is measured with the page.)
"""

from __future__ import annotations

import argparse
import contextlib
import http.client
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.daemon.client import Client, NoDaemon, Refusal
from rig.ports.pseudo_terminal import PseudoTerminals

ROOT = Path(__file__).resolve().parents[1]
RUN = 2  # parameter 104
LONGEST_S = 60.0
BENCH = """
[bench]
[bench.controller]
driver = "meerstetter"
port = "{controller}"
[bench.meter]
driver = "keithley2000"
port = "{meter}"
[limits]
temperature_degC = [10, 95]
current_A = 4.0
polarity_share = 0.0
[experiment]
kind = "current_profile"
target = ["start 0.5 A", "hold 600 s"]
period_s = 0.1
[serve]
port = 0
folder = "kept"
[simulation.film]
relays = 40
"""


class Watched:
    """An emulated controller that notes when its output went off."""

    def __init__(self, instrument: Any) -> None:
        self.instrument = instrument
        self.off_s = 0.0
        self._was_on = False

    @property
    def on(self) -> bool:
        """Whether the output is on."""
        return bool(self.instrument.status == RUN)

    def receive(self, data: bytes, time_s: float) -> None:
        """Bytes of the wire."""
        self.instrument.receive(data, time_s)
        self._look()

    def transmit(self, time_s: float) -> bytes:
        """Bytes to the wire."""
        data: bytes = self.instrument.transmit(time_s)
        self._look()
        return data

    def next_transmit_s(self) -> float | None:
        """When there will be some."""
        due: float | None = self.instrument.next_transmit_s()
        return due

    def _look(self) -> None:
        if self._was_on and not self.on:
            self.off_s = time.perf_counter()
        self._was_on = self.on


def until(true: Callable[[], Any]) -> Any:
    """Wait until it is so."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        value = true()
        if value:
            return value
        time.sleep(0.002)
    raise SystemExit("the daemon did not do it in time")


def post_stop(url: str) -> None:
    """As the page does."""
    connection = http.client.HTTPConnection(url.split("//")[1].rstrip("/"), timeout=LONGEST_S)
    connection.request("POST", "/api/stop", headers={"X-Peltier": "1", "Content-Type": "application/json"})
    answer = json.loads(connection.getresponse().read())
    connection.close()
    assert answer["confirmed"], answer


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--stops", type=int, default=7)
    parser.add_argument("--json")
    options = parser.parse_args()
    figures = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "bench.toml").write_text(BENCH.format(controller="sim://", meter="sim://"))
        emulated = {role: one for role, _, one in emulated_instruments(read_configuration(folder / "bench.toml"), 0.0)}
        watched = emulated["controller"] = Watched(emulated["controller"])
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        with PseudoTerminals(emulated) as terminals:
            (folder / "bench.toml").write_text(BENCH.format(**terminals.paths))
            daemon = subprocess.Popen(
                [sys.executable, "-m", "rig", "serve", str(folder / "bench.toml")],
                cwd=ROOT,
                stdout=subprocess.PIPE,
                text=True,
            )
            try:
                assert daemon.stdout is not None
                url = daemon.stdout.readline().split()[1]
                figures = measure(folder, watched, url, options.stops)
            finally:
                daemon.terminate()
                daemon.wait()
    print(f"{'until the controller has the command, ms':<50}{'median':>8}{'most':>8}   asked 200 in the median")
    for name, values in figures.items():
        print(f"{name:<50}{1e3 * statistics.median(values):>8.1f}{1e3 * max(values):>8.1f}")
    if options.json:
        Path(options.json).write_text(json.dumps(figures) + "\n")
    return 0


def measure(folder: Path, watched: Watched, url: str, stops: int) -> dict[str, list[float]]:
    """Seconds of each way to stop."""
    installed = [sys.executable, "-c", "import sys; from rig.__main__ import main; sys.exit(main())", "off"]

    def ask() -> None:
        with Client(folder / "bench.sock") as client:
            assert client.ask("POST", "/api/stop", by="the benchmark")["confirmed"]

    ways: dict[str, Callable[[], Any]] = {
        "POST /api/stop": lambda: post_stop(url),
        "the daemon's socket": ask,
        "peltier off, installed": lambda: subprocess.run(installed, check=True, cwd=ROOT, stdout=subprocess.DEVNULL),
        "./peltier off, in a checkout": lambda: subprocess.run(
            [str(ROOT / "peltier"), "off"], check=True, stdout=subprocess.DEVNULL
        ),
    }
    found = {}
    for name, way in ways.items():
        found[name] = [once(folder, watched, way) for _ in range(stops)]
    return found


def once(folder: Path, watched: Watched, way: Callable[[], Any]) -> float:
    """Seconds from one way's beginning to the output's being off."""
    until(lambda: listening(folder))
    with Client(folder / "bench.sock") as client:
        with contextlib.suppress(Refusal):  # nothing is latched
            client.ask("POST", "/api/reset", reason="the next one")
        client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
        until(lambda: running(client) and watched.on)
        time.sleep(0.237)  # somewhere between two ticks
        begin = time.perf_counter()
        way()
        until(lambda: watched.off_s > begin)
        until(lambda: client.ask("GET", "/api/state")["job"] is None)
    return watched.off_s - begin


def running(client: Client) -> bool:
    """Whether the job has come to its profile; ends the benchmark where it never will."""
    state = client.ask("GET", "/api/state")
    if state["trip"]:
        raise SystemExit(f"the job tripped: {state['trip']['text']}")
    return bool((state["job"] or {}).get("phase") == "profile")


def listening(folder: Path) -> bool:
    """Whether the daemon's bench is there."""
    try:
        with Client(folder / "bench.sock") as client:
            return bool(client.ask("GET", "/api/state")["output_confirmed"])
    except NoDaemon:
        return False


if __name__ == "__main__":
    sys.exit(main())
