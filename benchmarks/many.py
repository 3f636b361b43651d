"""Many cases: what kills lose, what memory the sweep's own process takes, what an engine costs over the bare work.

    ./peltier benchmark many [--only kills|memory|speed|trend] [--kills 20] [--cases 10000] [--diagnoses 200]
                             [--engines processes,dask]

kills    a sweep is killed in all its parts, one kind after the other, each `--kills` times: workers, the sweep itself
         and (dask) the scheduler, each kill at a random moment after another case has ended; begun again until it is
         whole, its table has to be that of a sweep that nobody disturbed, to the bit, and no finished case may have
         been computed again.
memory   the largest resident size (VmHWM) of the sweep's own process over `--cases` short experiments.
speed    `--diagnoses` diagnoses of 6,000 rows on all cores, over the time of the same on one core divided by their
         number; beside it the machine's own loss: the same cases in bare processes, one a core, over one process.
trend    series of 60 nights with a change of three intervals half-way, and without one: found within three nights, told
         falsely on any night.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

CONFIGURATION = """
[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
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
    path.write_text(CONFIGURATION.format(cases=cases, hold_s=hold_s))
    return path


def _sweep(path: Path, out: Path, *more: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "rig", "sweep", str(path), "--out", str(out), *more]
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


def kills(count: int, engines: list[str]) -> bool:
    """The table of kills."""
    good = True
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = _configured(folder, 12 * count, 6000.0)  # on a quick computer six of them end between two kills
        assert _sweep(path, folder / "whole").wait() == 0
        whole = (folder / "whole" / "sweep.csv").read_bytes()
        for engine in engines:
            for what in ("worker", "sweep", *(["scheduler"] if engine == "dask" else [])):
                good &= _killed(path, folder / f"{engine}_{what}", engine, what, count, whole)
    return good


def _killed(path: Path, out: Path, engine: str, what: str, count: int, whole: bytes) -> bool:
    chance, done, began = random.Random(what), 0, 1
    with _cluster(what == "scheduler") as cluster:
        more = ["--engine", engine, *(["--address", cluster.address] if cluster else [])]
        process = _sweep(path, out, *more)
        known = 0
        while process.poll() is None or done < count:
            time.sleep(0.05)
            if process.poll() is not None:
                if process.returncode == 0 and len(_journal(out)) >= _cases(path):
                    break
                if cluster:
                    cluster.begin()
                    more[-1] = cluster.address
                process, began = _sweep(path, out, *more), began + 1
            elif done < count and len(_journal(out)) > known and _busy(process.pid, what):
                time.sleep(chance.uniform(0.0, 1.0))
                victims = {"worker": _children(process.pid), "sweep": [process.pid]}
                victim = cluster.scheduler.pid if cluster else chance.choice(victims[what] or [0])
                if victim:
                    os.kill(victim, signal.SIGKILL)
                    done, known = done + 1, len(_journal(out))
        process.wait()
    numbers = _journal(out)
    same = (out / "sweep.csv").exists() and (out / "sweep.csv").read_bytes() == whole
    twice = len(numbers) - len(set(numbers))
    words = f"{engine:10s} kill -9 of the {what:10s} {done:3d} times, begun {began:3d} times:"
    print(f"{words} table the same {same}, finished cases computed again {twice}", flush=True)
    return same and twice == 0 and done == count


def _cases(path: Path) -> int:
    found = re.search(r"samples = (\d+)", path.read_text())
    assert found is not None
    return int(found.group(1))


def _busy(pid: int, what: str) -> bool:
    """Whether the sweep has come to its cases: before that a kill shows nothing."""
    return what == "scheduler" or bool(_children(pid))


class _Cluster:
    """A scheduler and two workers, each a process of its own."""

    def begin(self) -> None:
        """Anew."""
        self.end()
        port = 20000 + random.randrange(20000)
        self.address = f"tcp://127.0.0.1:{port}"
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "DASK_DISTRIBUTED__DASHBOARD__LINK": ""}

        def started(*words: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", f"distributed.cli.{words[0]}", *words[1:]]
            return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        self.scheduler = started("dask_scheduler", "--port", str(port), "--no-dashboard", "--host", "127.0.0.1")
        worker = ("dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "10")
        self.workers = [started(*worker) for _ in range(2)]
        time.sleep(3.0)

    def end(self) -> None:
        for process in [getattr(self, "scheduler", None), *getattr(self, "workers", [])]:
            if process is not None:
                process.kill()
                process.wait()


@contextmanager
def _cluster(wanted: bool) -> Iterator[_Cluster | None]:
    if not wanted:
        yield None
        return
    cluster = _Cluster()
    try:
        cluster.begin()
        yield cluster
    finally:
        cluster.end()


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
    took = time.monotonic() - began
    print(
        f"{rows} cases in {took:.0f} s: the sweep's own process took {largest / 1024:.0f} MB at most (asked 300); ",
        end="",
    )
    print(f"its files take {size / 1e6:.1f} MB", flush=True)
    return rows == cases and largest < 300 * 1024


def _diagnose(seed: int) -> tuple[str, float]:

    from rig.analysis.diagnosed import diagnosed
    from rig.records.record import Record
    from tests.truth import drawn_effects, record

    columns = record(seed, drawn_effects(seed, 1), rows=6000)
    began = time.perf_counter()
    document = diagnosed(Record(columns))[0].document()
    return json.dumps(document["effects"], default=float, sort_keys=True), time.perf_counter() - began


def _bare_s(seeds: list[int], cores: int) -> float:
    """The time of the same cases in processes that know nothing of one another, one a core, each with its share of
    the seeds, summed: it is longer than in one process, because they share the machine's memory."""
    with ExitStack() as stack:
        pools = [stack.enter_context(ProcessPoolExecutor(1)) for _ in range(cores)]
        for pool in pools:
            pool.submit(_diagnose, seeds[0]).result()  # compiled
        shares = [pool.map(_diagnose, seeds[k::cores]) for k, pool in enumerate(pools)]
        return sum(seconds for share in shares for _, seconds in share)


def speed(count: int, engines: list[str]) -> bool:
    """Engines over the bare work."""
    from rig.batch import Case, EngineChoice, each_ended, opened

    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["PYTHONPATH"] = str(ROOT)
    cores = os.cpu_count() or 1
    seeds = list(range(50_000, 50_000 + count))
    with ProcessPoolExecutor(1) as pool:
        list(pool.map(_diagnose, seeds[:1]))  # compiled
        began = time.perf_counter()
        alone = list(pool.map(_diagnose, seeds))
        one_s = time.perf_counter() - began
    alone_s = sum(seconds for _, seconds in alone)
    loss = _bare_s(seeds, cores) / alone_s
    print(f"{count} diagnoses: {one_s:.0f} s in one process; the machine's own loss with {cores} processes: {loss:.3f}")
    good = True
    for engine in engines:
        with opened(EngineChoice(engine), count) as many:
            list(each_ended([Case(k, _diagnose, (seeds[0],)) for k in range(cores)], many))
            began = time.perf_counter()
            ended = {
                e.number: (e, time.perf_counter() - began)
                for e in each_ended([Case(k, _diagnose, (s,)) for k, s in enumerate(seeds)], many)
            }
            took = time.perf_counter() - began
        same = [ended[k][0].value[0] for k in range(count)] == [text for text, _ in alone]
        ratio = took * cores / one_s
        busy_s = sum(e.seconds for e, _ in ended.values())
        last = sorted(at for _, at in ended.values())[-cores:]
        idle_s = sum(took - at for at in last)  # a worker has nothing left, while another computes the last case
        print(f"{engine:10s} {took:7.0f} s: {ratio:.3f} of the bare work; the same to the bit: {same}; of it")
        print(f"{'':10s} the cases themselves {busy_s / one_s:.3f}, ", end="")
        print(f"idle beside the last case {idle_s / one_s:.3f}", end="")
        print(f", the engine {ratio - (busy_s + idle_s) / one_s:.3f}", flush=True)
        good &= same and ratio <= (1.05 if engine == "processes" else 1.10)
    return good


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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("kills", "memory", "speed", "trend"))
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--diagnoses", type=int, default=200)
    parser.add_argument("--series", type=int, default=200)
    parser.add_argument("--engines", default="processes,dask")
    options = parser.parse_args()
    engines = options.engines.split(",")
    parts: dict[str, Any] = {
        "kills": lambda: kills(options.kills, engines),
        "memory": lambda: memory(options.cases),
        "speed": lambda: speed(options.diagnoses, engines),
        "trend": lambda: trend(options.series),
    }
    good = [part() for name, part in parts.items() if options.only in (None, name)]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
