"""Many cases: what kills lose, what memory the sweep's own process takes, what changes a trend finds.

    ./peltier benchmark many [--only kills,memory,trend] [--kills 20] [--cases 10000] [--series 200]

kills    a sweep is killed in its parts, first its workers and then itself, each `--kills` times, at a random moment
         after another case has ended; begun again until it is whole, its table has to be that of a sweep that nobody
         disturbed, to the bit, and no finished case may have been computed again.
memory   the largest resident size (VmHWM) of the sweep's own process over `--cases` short experiments.
trend    series of 60 nights with a change of three intervals half-way, and without one: found within three nights, told
         falsely on any night.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks._bench import SIMULATED_BENCH
from benchmarks._harness import ROOT, options

CONFIGURATION = """
[limits]
temperature_degC = [0, 95]
current_A = 3.0
[experiment]
kind = "current_profile"
period_s = 0.1
target = ["start 1 A", "hold {hold_s} s", "ramp to 2 A in 5 s"]
[simulation]
thermometer_noise_K = 0.01
[sweep]
plan = "latin_hypercube"
samples = {cases}
[sweep.ranges]
"simulation.ohmmeter_noise_dec" = [0.0005, 0.004]
"simulation.thermometer_noise_K" = [0.001, 0.02]
"""


def _configured(folder: Path, cases: int, hold_s: float) -> Path:
    path = folder / "sweep.toml"
    path.write_text(SIMULATED_BENCH + CONFIGURATION.format(cases=cases, hold_s=hold_s))
    return path


def _sweep(path: Path, out: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "rig", "sweep", str(path), "--out", str(out)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(words, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def _children(pid: int, depth: int = 4) -> list[int]:
    """Processes below one, that compute cases."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if int(fields[1]) == pid:
                below = _children(int(entry.name), depth - 1) if depth else []
                found += [*([int(entry.name)] if b"spawn_main" in command or b"forkserver" in command else []), *below]
    return found


def _journal(out: Path) -> list[int]:
    path = out / "cases.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    return [json.loads(line)["case"]["number"] for line in lines if line.endswith("}")]


def kills(count: int) -> bool:
    """The table of kills."""
    with tempfile.TemporaryDirectory() as name:
        folder, cases = Path(name), 12 * count  # on a quick computer six of them end between two kills
        path = _configured(folder, cases, 6000.0)
        assert _sweep(path, folder / "whole").wait() == 0
        whole = (folder / "whole" / "sweep.csv").read_bytes()
        found = [_killed(path, folder / what, what, count, cases, whole) for what in ("worker", "sweep")]
        return all(found)


def _killed(path: Path, out: Path, what: str, count: int, cases: int, whole: bytes) -> bool:
    chance, done, began, known = random.Random(what), 0, 1, 0
    process = _sweep(path, out)
    while process.poll() is None or done < count:
        time.sleep(0.05)
        if process.poll() is not None:
            if process.returncode == 0 and len(_journal(out)) >= cases:
                break
            process, began = _sweep(path, out), began + 1
        elif done < count and len(_journal(out)) > known and _children(process.pid):  # it has come to its cases
            time.sleep(chance.uniform(0.0, 1.0))
            victims = _children(process.pid) if what == "worker" else [process.pid]
            if victims:
                os.kill(chance.choice(victims), signal.SIGKILL)
                done, known = done + 1, len(_journal(out))
    process.wait()
    numbers = _journal(out)
    same = (out / "sweep.csv").exists() and (out / "sweep.csv").read_bytes() == whole
    twice = len(numbers) - len(set(numbers))
    words = f"kill -9 of the {what:10s} {done:3d} times, begun {began:3d} times:"
    print(f"{words} table the same {same}, finished cases computed again {twice}", flush=True)
    return same and twice == 0 and done == count


def memory(cases: int) -> bool:
    """The sweep's own process."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = _sweep(_configured(folder, cases, 1.0), folder / "out")
        largest, began = 0, time.monotonic()
        while process.poll() is None:
            time.sleep(0.2)
            try:
                status = Path(f"/proc/{process.pid}/status").read_text()
            except OSError:
                break
            found = re.search(r"VmHWM:\s+(\d+) kB", status)
            largest = int(found.group(1)) if found else largest
        rows = len(_journal(folder / "out"))
        size = sum(file.stat().st_size for file in (folder / "out").iterdir())
    took = f"{rows} cases in {time.monotonic() - began:.0f} s"
    print(f"{took}: the sweep's own process took {largest / 1024:.0f} MB at most (asked 300); ", end="")
    print(f"its files take {size / 1e6:.1f} MB", flush=True)
    return rows == cases and largest < 300 * 1024


def trend(series: int) -> bool:
    """Found within three nights of a change, told on any night without one."""
    import numpy as np

    from rig.analysis.trend import latest_change

    nights, half, found, false = 60, 30, 0, 0
    for k in range(series):
        chance = np.random.default_rng(k)
        error = chance.uniform(0.7, 1.4, nights)
        noise = error * (chance.standard_normal(nights) if k % 2 else chance.standard_t(4, nights))
        value = 10.0 + noise
        false += any(latest_change(value[:n], error[:n]) is not None for n in range(4, nights + 1))
        value = value + np.where(np.arange(nights) >= half, 3.0 * 2.0 * 1.96, 0.0)
        changes = (latest_change(value[:n], error[:n]) for n in range(half + 1, half + 4))
        found += any(c is not None and abs(c.since - half) <= 1 for c in changes)
    print(f"{series} series of {nights} nights (half of them with tails of Student's t, 4 degrees):")
    print(f"found within three nights {100 * found / series:.1f} % (asked 95), ", end="")
    print(f"a change that was none on any night {100 * false / series:.1f} % (asked at most 5)", flush=True)
    return found >= 0.95 * series and false <= 0.05 * series


def main() -> int:
    asked = options(__doc__, only=("kills", "memory", "trend"), kills=20, cases=10_000, series=200)
    parts: dict[str, Callable[[], bool]] = {
        "kills": lambda: kills(asked.kills),
        "memory": lambda: memory(asked.cases),
        "trend": lambda: trend(asked.series),
    }
    good = [parts[name]() for name in asked.only]  # each of them, whatever the one before gives
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
