"""STOP while others crowd the door: half-open connections, and pictures of a month of history, all at once.

    ./peltier benchmark door [--stops 9] [--half-open 1200] [--queries 40] [--days 30] [--json FILE]

A daemon in a process of its own holds emulated instruments on pseudo-terminals, a history of a month, and a job with
the output on; a page is open. Then another process opens connections that never ask for anything, and opens new ones
for those that are dropped, while as many questions over the whole history as were named are always under way. STOP is
sent as the page sends it, to its own listener and to the page's address, and by `peltier stop` as one types it; with
a browser (playwright and chromium), by a press of its key in a page that was open before. Measured at the emulated
controller: from the moment the request leaves, or the key is pressed, until its output is off. Asked: 200 ms.
"""

from __future__ import annotations

import argparse
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

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stop_latency import BENCH, ROOT, Watched, once

from rig.bench.assembly import emulated_instruments
from rig.config.configuration import read_configuration
from rig.daemon.client import Client
from rig.history.store import DAY_S, Retention, Store
from rig.ports.pseudo_terminal import PseudoTerminals

ASKED_MS = 200.0
BATCH = 50_000  # rows
AGAIN_S = 2.0  # before a connection that was dropped is opened anew
SETTLED_S = 3.0  # until all connections are there


def fill(path: Path, days: float) -> None:
    """A row a second until now."""
    path.parent.mkdir()
    store, end_s = Store(path, Retention()), time.time()
    begin_s = end_s - days * DAY_S
    for first in range(0, int(days * DAY_S), BATCH):
        times = [begin_s + k for k in range(first, min(first + BATCH, int(days * DAY_S)))]
        store.add(
            {"time_s": t, "temperature_degC": 25.0 + t % 7.0, "resistance_ohm": 1e5, "current_A": 0.0} for t in times
        )
    store.roll_up(end_s, everything=True)
    store.close()


def crowd(host: str, port: int, half_open: int, queries: int, days: float, told: Any) -> None:
    """In a process of its own: crowd the door until it is ended. told: gets how long each question took, s.

    It stands for other computers, so it gets what this one has left.
    """
    os.nice(19)

    async def stay() -> None:
        """A connection that says half a line, and another one when it is dropped."""
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(host, port)
                writer.write(b"GET /api/sta")
                await reader.read()
                writer.close()
            await asyncio.sleep(AGAIN_S)

    async def ask() -> None:
        while True:
            begin, now_s, status = time.perf_counter(), time.time(), "none"
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection(host, port)
                target = f"/api/history?from={now_s - days * DAY_S}&to={now_s}&points=5000"
                writer.write(f"GET {target} HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: close\r\n\r\n".encode())
                status = (await reader.readline()).decode().partition(" ")[2][:3]
                await reader.read()
                writer.close()
            told.put((status, time.perf_counter() - begin))

    async def all_of_them() -> None:
        await asyncio.gather(*(stay() for _ in range(half_open)), *(ask() for _ in range(queries)))

    asyncio.run(all_of_them())


def post_stop(host: str, port: int) -> None:
    """As the page does; again where it got no answer."""
    for _ in range(100):
        connection = http.client.HTTPConnection(host, port, timeout=1.0)
        try:
            connection.request("POST", "/api/stop", headers={"X-Peltier": "1", "Content-Type": "application/json"})
            assert json.loads(connection.getresponse().read())["confirmed"]
            return
        except (OSError, http.client.HTTPException):
            continue
        finally:
            connection.close()
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


def measure(folder: Path, watched: Watched, url: str, options: argparse.Namespace) -> dict[str, Any]:
    """Milliseconds of each way to stop, and what became of the questions."""
    place = urlsplit(url)
    host, port = str(place.hostname), int(place.port or 80)
    with Client(folder / "bench.sock") as client:
        stop_port = client.ask("GET", "/api/state")["stop_port"]
    command = [sys.executable, "-c", "import sys; from rig.__main__ import main; sys.exit(main())", "stop"]
    ways: dict[str, Callable[[], Any]] = {
        "POST, STOP's own listener": lambda: post_stop(host, stop_port),
        "POST, the page's address": lambda: post_stop(host, port),
        "peltier stop": lambda: subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL),
    }
    told: Any = multiprocessing.Queue()
    found: dict[str, Any] = {}
    with browser_page(url) as page:
        if page is not None:
            ways["Escape in the page, in a browser"] = lambda: page.keyboard.press("Escape")
        crowding = multiprocessing.Process(
            target=crowd, args=(host, port, options.half_open, options.queries, options.days, told), daemon=True
        )
        crowding.start()
        try:
            time.sleep(SETTLED_S)
            for name, way in ways.items():
                found[name] = [1e3 * once(folder, watched, way) for _ in range(options.stops)]
        finally:
            crowding.kill()
            crowding.join()
    found["questions"] = [told.get() for _ in range(told.qsize())]
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stops", type=int, default=9)
    parser.add_argument("--half-open", type=int, default=1200)
    parser.add_argument("--queries", type=int, default=40)
    parser.add_argument("--days", type=float, default=30.0)
    parser.add_argument("--json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "bench.toml").write_text(BENCH.format(controller="sim://", meter="sim://"))
        emulated = {role: one for role, _, one in emulated_instruments(read_configuration(folder / "bench.toml"), 0.0)}
        watched = emulated["controller"] = Watched(emulated["controller"])
        os.environ["PELTIER_SOCKET"] = str(folder / "bench.sock")
        fill(folder / "kept" / "history.sqlite", options.days)
        log = folder / "log.txt"
        with PseudoTerminals(emulated) as terminals, log.open("w") as stderr:
            (folder / "bench.toml").write_text(BENCH.format(**terminals.paths))
            command = [sys.executable, "-m", "rig", "serve", str(folder / "bench.toml")]
            daemon = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=stderr, text=True)
            try:
                assert daemon.stdout is not None
                url = daemon.stdout.readline().split()[1]
                found = measure(folder, watched, url, options)
            finally:
                daemon.terminate()
                daemon.wait()
        written = log.stat().st_size
    questions = found.pop("questions")
    print(f"{'until the output is off, ms':<40}{'median':>8}{'most':>8}   asked {ASKED_MS:g}")
    for name, values in found.items():
        print(f"{name:<40}{statistics.median(values):>8.1f}{max(values):>8.1f}")
    statuses = {word: sum(status == word for status, _ in questions) for word in sorted({s for s, _ in questions})}
    longest = max((took_s for _, took_s in questions), default=0.0)
    print(f"questions over {options.days:g} days, by status: {statuses}; the longest took {longest:.1f} s")
    print(f"the daemon's log: {written} bytes")
    if options.json:
        Path(options.json).write_text(json.dumps({**found, "statuses": statuses, "longest_s": longest}) + "\n")
    return 0 if all(max(values) <= ASKED_MS for values in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
