"""What is left of a trip: kill -9, a damaged history, a full disk and restarts in any order; and benches without one.

    ./peltier benchmark latch [--count 100] [--seed 1] [--workers 2]

Each case is a bench of its own, with `peltier serve` as a process on simulated instruments, whose history and latch are
on a small disk in memory. It starts for the first time, in every fourth case on a disk that is already full. Some of
them are killed, damaged and filled up before anything has happened. Then it trips, on a temperature limit or because
the disk fills up in a run; in half the cases the process is killed within 50 ms of the announcement. Then follow, in a
random order, at least a kill, a damaged history (truncated, random bytes, deleted; while the daemon runs or not) and a
full disk, with starts in between. At last somebody makes room and resets it with a reason; it is ended in one of two
ways and started again. Asked: tripped at every start after the trip, and tripped at none before it or after the reset.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks._harness import ROOT, kept, options
from benchmarks._small_disk import SmallDisk, small_disk, with_own_mounts
from rig.daemon.client import Client, NoDaemon

DISK_MB = 16
SOON_S = 0.05
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


class Case:
    """A bench in a folder, what happened to it in order, and how it was found at its starts. disk: what its history
    and its latch are on, None for the folder's own."""

    def __init__(self, folder: Path, disk: SmallDisk | None, chance: random.Random) -> None:
        self.folder, self.disk, self._chance = folder, disk, chance
        self._kept = (disk.folder if disk is not None else folder) / "kept"
        self._socket, self._said = folder / "s", (folder / "said.txt").open("ab")
        self._process: subprocess.Popen[bytes] | None = None
        self.steps: list[str] = []
        self.found: Counter[str] = Counter()  # "new", "after the trip", "reset", each with "tripped" or "not"
        self.failure = ""
        for name, current_A in (("bench", 0.5), ("hot", 3.0)):
            (folder / f"{name}.toml").write_text(BENCH.format(folder=self._kept, current=current_A))

    def run(self) -> None:
        """From the first start to the one after the reset."""
        chance = self._chance
        if chance.random() < 0.25:
            self.do("full disk")
        self.start("new")
        for _ in range(chance.randrange(3)):
            self.do(chance.choice(["kill -9", "end", "full disk", *DAMAGES]))
        self.do("room")
        if self._process is not None and self.state()["no_job_because"]:
            self.do("end")  # its history was damaged while it ran: a start puts it aside
        if self._process is None:
            self.start("new")
        self.until(lambda state: not state["no_job_because"])
        self.trip(self.disk is not None and chance.random() < 0.5)
        steps = ["kill -9", chance.choice(DAMAGES), "full disk"]
        steps += chance.sample(["kill -9", "end", "room", *DAMAGES], chance.randrange(1, 4))
        chance.shuffle(steps)
        for step in steps:
            self.do(step)
            if self._process is None and chance.random() < 0.4:
                self.start("after the trip")
        self.do("kill -9")
        self.start("after the trip")
        self.do("room")
        with Client(self._socket) as client:
            client.ask("POST", "/api/reset", reason="the benchmark has looked at it")
        self.do(chance.choice(["kill -9", "end"]))
        if chance.random() < 0.5:
            self.do(chance.choice(DAMAGES))
        self.start("reset")

    def start(self, what: str) -> None:
        """Begin a life, and count how the bench is found as soon as it is held, or latched."""
        words = [sys.executable, "-m", "rig", "serve", str(self.folder / "bench.toml")]
        more = {**os.environ, "PELTIER_SOCKET": str(self._socket), "PYTHONPATH": str(ROOT)}
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": self._said}
        self._process = subprocess.Popen(words, cwd=ROOT, env=more, **quiet)
        word = self.until(lambda state: state["state"] != "offline")["state"]
        self.steps.append(f"start: {word}")
        self.found[f"{what}: {'tripped' if word == 'tripped' else 'not'}"] += 1

    def state(self) -> Any:
        """As `peltier status` has it; None where nobody answers yet."""
        try:
            with Client(self._socket) as client:
                return client.ask("GET", "/api/state")
        except (NoDaemon, KeyError):
            return None

    def until(self, true: Callable[[Any], Any]) -> Any:
        """The first state of which something is so."""
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            if self._process is not None and self._process.poll() is not None:
                said = (self.folder / "said.txt").read_text()
                raise RuntimeError(f"serve ended with status {self._process.returncode}: {said}")
            state = self.state()
            if state is not None and true(state):
                return state
            time.sleep(0.02)
        raise RuntimeError(f"nothing of the kind in {PATIENCE_S:g} s")

    def trip(self, by_full_disk: bool) -> None:
        """Run into a trip; in half the cases SIGKILL soon after its announcement."""
        with Client(self._socket, PATIENCE_S) as told, Client(self._socket) as client:
            events = told.events(PATIENCE_S)
            next(events)
            client.ask("POST", "/api/jobs", configuration="bench" if by_full_disk else "hot")
            for message in events:
                event, data = message["event"], message["data"]
                if by_full_disk and event == "state" and data["job"] is not None and data["output"] == "on":
                    self.do("full disk")
                    by_full_disk = False
                if event == "trip" or (event == "state" and data["trip"] is not None):
                    break
            self.steps.append("trip")
            if self._chance.random() < 0.5:
                time.sleep(self._chance.uniform(0.0, SOON_S))
                self.do("kill -9")

    def do(self, step: str) -> None:
        """One of the things that happen to a bench."""
        self.steps.append(step)
        if step in ("kill -9", "end"):
            process, self._process = self._process, None
            if process is not None:
                process.send_signal(signal.SIGKILL if step == "kill -9" else signal.SIGTERM)
                process.wait(PATIENCE_S)
        elif step in DAMAGES:
            self._damage(step)
        elif self.disk is not None:
            (self.disk.fill if step == "full disk" else self.disk.free)()

    def _damage(self, how: str) -> None:
        """What disks, and people who make room on them, do to a history."""
        history = self._kept / "history.sqlite"
        if how == "deleted":
            for path in self._kept.glob("history.sqlite*"):
                path.unlink()
        elif history.is_file():
            size = history.stat().st_size
            with contextlib.suppress(OSError), history.open("r+b") as file:  # a full disk may have no room for noise
                if how == "truncated":
                    file.truncate(self._chance.randrange(size + 1))
                else:
                    begin = file.seek(self._chance.randrange(max(size, 1)))
                    file.write(self._chance.randbytes(self._chance.randrange(1, max(size - begin, 1) + 1)))


def one_case(folder: Path, seed: int) -> Case:
    """A case from its beginning to its end; one that does not come to its end is told, and counts as none."""
    folder.mkdir()
    with small_disk(folder / "disk", DISK_MB) as disk:
        case = Case(folder, disk, random.Random(seed))
        try:
            case.run()
        except Exception as error:
            case.failure = f"{type(error).__name__}: {error}"
        finally:
            case.do("kill -9")
    return case


def main() -> int:
    asked = options(__doc__, count=100, seed=1)
    with_own_mounts()
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(asked.workers) as pool:
        seeds = range(asked.seed, asked.seed + asked.count)
        cases = list(pool.map(lambda seed: one_case(Path(temporary) / str(seed), seed), seeds))
    found: Counter[str] = sum((case.found for case in cases), Counter())
    held = sum(not case.failure and not case.found["after the trip: not"] for case in cases)
    disk = "" if all(case.disk for case in cases) else "  (without full disks: none can be mounted here)"
    print(f"tripped, then mistreated: still tripped {held} of {asked.count}{disk}        asked: all")
    for what in ("new", "after the trip", "reset"):
        print(f"starts, {what}: tripped {found[f'{what}: tripped']}, not {found[f'{what}: not']}")
    wrong = ("after the trip: not", "new: tripped", "reset: tripped")
    for case in cases:
        if case.failure or any(case.found[name] for name in wrong):
            print(f"    {'; '.join([*case.steps, case.failure])}")
    kept(asked.json, {"count": asked.count, "still_tripped": held, **found})
    return 0 if held == asked.count and not any(found[name] for name in wrong) else 1


if __name__ == "__main__":
    sys.exit(main())
