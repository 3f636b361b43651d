"""A bench with `peltier serve` as a process of its own on simulated instruments: it can be tripped and mistreated."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from benchmarks._small_disk import SmallDisk
from rig.daemon.client import Client, NoDaemon

ROOT = Path(__file__).resolve().parent.parent
PATIENCE_S = 180.0  # on a busy computer
DAMAGES = ("truncated", "random bytes", "deleted")
BENCH = """
[bench.controller]
driver = "meerstetter"
port = "sim://"
[limits]
temperature_degC = [10, 61.5]
current_A = 4.0
polarity_share = 0.0
[experiment]
kind = "current_profile"
target = ["start {current} A", "hold 60 s"]
period_s = 0.05
[simulation]
first_degC = 60.0
[serve]
port = 0
folder = "{folder}"
idle_period_s = 0.1
"""


class LatchedBench:
    """One bench in a folder; `disk` is what its history and its latch are on, None for the folder's own."""

    def __init__(self, folder: Path, disk: SmallDisk | None, chance: random.Random) -> None:
        self.folder, self.disk, self._chance = folder, disk, chance
        self.kept = (disk.folder if disk is not None else folder) / "kept"
        self.history = self.kept / "history.sqlite"
        self._socket = folder / "s"
        self._process: subprocess.Popen[bytes] | None = None
        self._said = (folder / "said.txt").open("ab")
        for name, current_A in (("bench", 0.5), ("hot", 3.0)):
            (folder / f"{name}.toml").write_text(BENCH.format(folder=self.kept, current=current_A))

    @property
    def alive(self) -> bool:
        return self._process is not None

    def said(self) -> str:
        """What the daemon wrote to stderr, in all its lives."""
        return (self.folder / "said.txt").read_text()

    def start(self) -> dict[str, Any]:
        """Begin a life; the state as soon as the bench is held, or latched."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "rig", "serve", str(self.folder / "bench.toml")],
            cwd=ROOT,
            env={**os.environ, "PELTIER_SOCKET": str(self._socket), "PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
        )
        return self.until(lambda state: state["state"] != "offline")

    def state(self) -> dict[str, Any] | None:
        """As `peltier status` has it; None where nobody answers yet."""
        try:
            with Client(self._socket) as client:
                found: dict[str, Any] = client.ask("GET", "/api/state")
                return found
        except (NoDaemon, KeyError):
            return None

    def until(self, true: Any) -> dict[str, Any]:
        """The first state of which something is so."""
        end_s = time.monotonic() + PATIENCE_S
        state: dict[str, Any] | None = None
        while time.monotonic() < end_s:
            if self._process is not None and self._process.poll() is not None:
                raise RuntimeError(f"serve ended with status {self._process.returncode}: {self.said()}")
            state = self.state()
            if state is not None and true(state):
                return state
            time.sleep(0.02)
        raise RuntimeError(f"nothing of the kind in {PATIENCE_S:g} s: {state}; {self.said()}")

    def ask(self, method: str, path: str, /, **body: Any) -> Any:
        """A request to the daemon."""
        with Client(self._socket) as client:
            return client.ask(method, path, **body)

    def end(self, number: int) -> None:
        """End this life by a signal."""
        process, self._process = self._process, None
        if process is not None:
            process.send_signal(number)
            process.wait(PATIENCE_S)

    def trip(self, by_full_disk: bool, kill_after_s: float | None) -> str:
        """Run into a trip; its cause as it was announced. kill_after_s: SIGKILL so long after the announcement."""
        with Client(self._socket, PATIENCE_S) as told, Client(self._socket) as client:
            events = told.events(PATIENCE_S)
            next(events)
            client.ask("POST", "/api/jobs", configuration="bench" if by_full_disk else "hot")
            for message in events:
                data = message["data"]
                on = message["event"] == "state" and data["job"] is not None and data["output"] == "on"
                if by_full_disk and on and self.disk is not None:
                    self.disk.fill()
                    by_full_disk = False
                if message["event"] == "trip" or (message["event"] == "state" and data["trip"] is not None):
                    cause = str((data if message["event"] == "trip" else data["trip"])["cause"])
                    break
            if kill_after_s is not None:
                threading.Event().wait(kill_after_s)
                self.end(signal.SIGKILL)
        return cause

    def damage(self, how: str) -> None:
        """Do to the history what disks, and people who make room on them, do."""
        if not self.history.is_file():
            return
        if how == "deleted":
            for path in self.kept.glob("history.sqlite*"):
                path.unlink()
            return
        size = self.history.stat().st_size
        with contextlib.suppress(OSError), self.history.open("r+b") as file:  # a full disk may have no room for noise
            if how == "truncated":
                file.truncate(self._chance.randrange(size + 1))
                return
            begin = self._chance.randrange(max(size, 1))
            file.seek(begin)
            file.write(self._chance.randbytes(self._chance.randrange(1, max(size - begin, 1) + 1)))

    def close(self) -> None:
        """End it, whatever it does."""
        self.end(signal.SIGKILL)
        self._said.close()
