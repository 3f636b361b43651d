"""STOP until the controller's output is off: from the page in a browser, over the wire, by `peltier off`; in a crowd.

    ./peltier benchmark stop [--only alone,crowded] [--stops 9] [--half-open 1200] [--queries 40] [--days 30]

A daemon in a process of its own holds emulated instruments on pseudo-terminals, a history of so many days, and a job
with the output on; a page is open in a browser (playwright and chromium, where they are). STOP is sent in each way and
measured at the emulated controller: from the moment the request leaves, the key is pressed, or the command is begun,
the start of Python included. Then the same while another process keeps connections open that never ask for anything,
and as many questions over the whole history as were named under way. Asked: 200 ms, most.
"""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import multiprocessing
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from benchmarks._harness import ROOT, kept, options
from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.daemon.client import Client, Refusal
from rig.history.store import DAY_S, Retention, Store
from rig.ports.pseudo_terminal import PseudoTerminals

ASKED_MS = 200.0
RUN = 2  # parameter 104 of the emulated controller: its output is on
LONGEST_S = 240.0  # for a process to be there, on a busy computer
SETTLED_S = 3.0  # until all connections are there
AGAIN_S = 2.0  # before a connection that was dropped is opened anew
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
PELTIER = [sys.executable, "-c", "import sys; from rig.__main__ import main; sys.exit(main())"]


class Watched:
    """An emulated controller that notes when its output went off."""

    def __init__(self, instrument: Any) -> None:
        self.instrument, self.off_s, self._was_on = instrument, 0.0, False
        self.next_transmit_s = instrument.next_transmit_s

    @property
    def on(self) -> bool:
        return bool(self.instrument.status == RUN)

    def receive(self, data: bytes, time_s: float) -> None:
        self.instrument.receive(data, time_s)
        self._look()

    def transmit(self, time_s: float) -> bytes:
        data: bytes = self.instrument.transmit(time_s)
        self._look()
        return data

    def _look(self) -> None:
        if self._was_on and not self.on:
            self.off_s = time.perf_counter()
        self._was_on = self.on


def until(true: Callable[[], Any]) -> Any:
    """Wait until it is so."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s:
        if value := true():
            return value
        time.sleep(0.002)
    raise SystemExit("the daemon did not do it in time")


@contextlib.contextmanager
def process(words: list[str], place: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A verb of peltier in a process of its own, and the first line that it prints. place: the daemon's socket."""
    environment = {**os.environ, "PELTIER_SOCKET": str(place), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "rig", *words]
    one = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment, cwd=place.parent)
    try:
        assert one.stdout is not None
        line = one.stdout.readline()
        if not line:
            raise SystemExit(f"peltier {words[0]} did not start")
        yield one, line
    finally:
        one.terminate()
        one.wait()


@contextlib.contextmanager
def served(folder: Path, more: str = "") -> Iterator[tuple[Watched, str]]:
    """A daemon on emulated instruments, its configuration bench.toml and its socket bench.sock in the folder: the
    controller, and the page's address."""
    path = folder / "bench.toml"
    path.write_text(BENCH.format(controller="sim://", meter="sim://"))
    emulated = {role: one for role, _, one in emulated_instruments(read_configuration(path), 0.0)}
    watched = emulated["controller"] = Watched(emulated["controller"])
    with PseudoTerminals(emulated) as terminals:
        path.write_text(BENCH.format(**terminals.paths) + more)
        with process(["serve", str(path)], folder / "bench.sock") as (_, line):
            yield watched, line.split()[1]


def fill(path: Path, days: float) -> None:
    """A row a second until now."""
    path.parent.mkdir()
    store, end_s = Store(path, Retention()), time.time()
    row = {"resistance_ohm": 1e5, "current_A": 0.0}
    times = (end_s - k for k in range(int(days * DAY_S), 0, -1))
    store.add({"time_s": t, "temperature_degC": 25.0 + t % 7.0, **row} for t in times)
    store.roll_up(end_s, everything=True)
    store.close()


def crowd(host: str, port: int, half_open: int, queries: int, days: float) -> None:
    """In a process of its own: crowd the door until it is ended. It stands for other computers, so it is nice."""
    os.nice(19)
    begin_s = time.time() - days * DAY_S
    question = f"GET /api/history?from={begin_s}&to={time.time()}&points=5000 HTTP/1.1\r\nHost: {host}:{port}\r\n"

    async def ask(text: str, again_s: float) -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(host, port)
                writer.write(text.encode())
                await reader.read()
                writer.close()
            await asyncio.sleep(again_s)

    async def everybody() -> None:
        stay = [ask("GET /api/sta", AGAIN_S) for _ in range(half_open)]
        await asyncio.gather(*stay, *(ask(f"{question}Connection: close\r\n\r\n", 0.0) for _ in range(queries)))

    asyncio.run(everybody())


def post_stop(host: str, port: int) -> None:
    """As the page does; again where it got no answer."""
    for _ in range(100):
        connection = http.client.HTTPConnection(host, port, timeout=1.0)
        with contextlib.suppress(OSError, http.client.HTTPException), contextlib.closing(connection):
            connection.request("POST", "/api/stop", headers={"X-Peltier": "1", "Content-Type": "application/json"})
            assert json.loads(connection.getresponse().read())["confirmed"]
            return
    raise SystemExit(f"STOP found no way to port {port}")


@contextlib.contextmanager
def browser_page(url: str) -> Iterator[Any]:
    """The page in a browser; None where there is none."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        chromium = None
    if chromium is None:
        yield None
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(url)
        page.wait_for_selector("#link[data-link=live]")
        yield page
        browser.close()


def once(folder: Path, watched: Watched, way: Callable[[], Any]) -> float:
    """Seconds from one way's beginning to the output's being off."""
    with Client(folder / "bench.sock") as client:
        state = lambda: client.ask("GET", "/api/state")  # noqa: E731
        until(lambda: state()["output_confirmed"] and state()["job"] is None)
        with contextlib.suppress(Refusal):  # nothing is latched
            client.ask("POST", "/api/reset", reason="the next one")
        client.ask("POST", "/api/jobs", path=str(folder / "bench.toml"))
        until(lambda: (state()["job"] or {}).get("phase") == "profile" and watched.on)
        time.sleep(0.237)  # somewhere between two ticks
        begin = time.perf_counter()
        way()
        until(lambda: watched.off_s > begin)
    return watched.off_s - begin


def ways_to_stop(folder: Path, url: str, page: Any) -> dict[str, Callable[[], Any]]:
    """The ways by name."""
    place = urlsplit(url)
    host, port = str(place.hostname), int(place.port or 80)
    with Client(folder / "bench.sock") as client:
        stop_port = client.ask("GET", "/api/state")["stop_port"]

    def run(*words: str) -> None:
        environment = {**os.environ, "PELTIER_SOCKET": str(folder / "bench.sock")}
        subprocess.run(words, check=True, cwd=ROOT, stdout=subprocess.DEVNULL, env=environment)

    ways: dict[str, Callable[[], Any]] = {
        "POST, STOP's own listener": lambda: post_stop(host, stop_port),
        "POST, the page's address": lambda: post_stop(host, port),
        "peltier stop, installed": lambda: run(*PELTIER, "stop"),
        "peltier off, installed": lambda: run(*PELTIER, "off"),
        "./peltier off, in a checkout": lambda: run(str(ROOT / "peltier"), "off"),
    }
    if page is not None:
        ways["Escape in the page, in a browser"] = lambda: page.keyboard.press("Escape")
    return ways


def main() -> int:
    asked = options(__doc__, only=("alone", "crowded"), stops=9, half_open=1200, queries=40, days=30.0)
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        fill(folder / "kept" / "history.sqlite", asked.days)
        with served(folder) as (watched, url), browser_page(url) as page:
            for how in asked.only:
                place = urlsplit(url)
                words = (place.hostname, place.port, asked.half_open, asked.queries, asked.days)
                crowding = multiprocessing.Process(target=crowd, args=words, daemon=True)
                if how == "crowded":
                    crowding.start()
                    time.sleep(SETTLED_S)
                for name, way in ways_to_stop(folder, url, page).items():
                    found[f"{how}: {name}"] = [1e3 * once(folder, watched, way) for _ in range(asked.stops)]
                if how == "crowded":
                    crowding.kill()
    print(f"{'until the output is off, ms':<44}{'median':>8}{'most':>8}   asked {ASKED_MS:g}")
    for name, values in found.items():
        print(f"{name:<44}{statistics.median(values):>8.1f}{max(values):>8.1f}")
    kept(asked.json, found)
    return 0 if all(max(values) <= ASKED_MS for values in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
