"""What is left of a trip: kill -9, a damaged history, a full disk and restarts in any order; and benches without one.

    ./peltier benchmark latch [--count 100] [--workers 2] [--json FILE]

Each case is a bench of its own, with `peltier serve` as a process on simulated instruments, whose history and latch are
on a small disk in memory. It starts for the first time, in every fourth case on a disk that is already full. Some of
them are killed, damaged and filled up before anything has happened. Then it trips, on a temperature limit or because
the disk fills up in a run; in half the cases the process is killed within 50 ms of the announcement. Then follow, in a
random order, at least a kill, a damaged history (truncated, random bytes, deleted; while the daemon runs or not) and a
full disk, with starts in between. At last somebody makes room and resets it with a reason; it is ended in one of two
ways and started again. Asked: tripped at every start after the trip, and tripped at none before it or after the reset.
"""

from __future__ import annotations

import random
import signal
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._harness import kept, options
from benchmarks._latched_bench import DAMAGES, LatchedBench
from benchmarks._small_disk import small_disk, with_own_mounts

DISK_MB = 16
SOON_S = 0.05


@dataclass
class Case:
    """What happened to one bench, in order, and how it was found at its starts."""

    steps: list[str] = field(default_factory=list)
    new_tripped: int = 0
    tripped: int = 0
    lost: int = 0
    reset_tripped: int = 0
    failure: str | None = None


def one_case(folder: Path, seed: int) -> Case:
    """A bench from its first start to the one after its reset."""
    chance = random.Random(seed)
    case = Case()
    folder.mkdir()
    with small_disk(folder / "disk", DISK_MB) as disk:
        bench = LatchedBench(folder, disk, chance)
        try:
            _begin(bench, chance, case)
            _trip(bench, chance, case)
            _mistreat(bench, chance, case)
            _reset(bench, chance, case)
        except Exception as error:  # a case that does not come to its end is told, and counts as none
            case.failure = f"{type(error).__name__}: {error}"
        finally:
            bench.close()
    return case


def _begin(bench: LatchedBench, chance: random.Random, case: Case) -> None:
    """A new bench, started; perhaps mistreated before anything has happened."""
    if bench.disk is not None and chance.random() < 0.25:
        _do("full disk", bench, chance, case)
    _start(bench, case, "new_tripped")
    for _ in range(chance.randrange(3)):
        _do(chance.choice(["kill -9", "end", "full disk", *DAMAGES]), bench, chance, case)
    _make_room(bench, case)
    if bench.alive and (bench.state() or {}).get("no_job_because"):
        bench.end(signal.SIGTERM)  # its history was damaged while it ran: a start puts it aside
    if not bench.alive:
        _start(bench, case, "new_tripped")
    bench.until(lambda state: not state["no_job_because"])


def _trip(bench: LatchedBench, chance: random.Random, case: Case) -> None:
    by_full_disk = bench.disk is not None and chance.random() < 0.5
    kill_after_s = chance.uniform(0.0, SOON_S) if chance.random() < 0.5 else None
    cause = bench.trip(by_full_disk, kill_after_s)
    case.steps.append(f"trip ({cause})" + (f", kill -9 after {1e3 * kill_after_s:.0f} ms" if kill_after_s else ""))


def _mistreat(bench: LatchedBench, chance: random.Random, case: Case) -> None:
    """At least a kill, a damage and a full disk, in a random order, with starts in between."""
    steps = ["kill -9", chance.choice(DAMAGES), "full disk"]
    steps += chance.sample(["kill -9", "end", "room", *DAMAGES], chance.randrange(1, 4))
    chance.shuffle(steps)
    for step in steps:
        _do(step, bench, chance, case)
        if not bench.alive and chance.random() < 0.4:
            _start(bench, case, "tripped")
    bench.end(signal.SIGKILL)
    _start(bench, case, "tripped")


def _reset(bench: LatchedBench, chance: random.Random, case: Case) -> None:
    """Somebody looks at it, makes room, and clears the trip: it stays cleared."""
    _make_room(bench, case)
    bench.ask("POST", "/api/reset", reason="the benchmark has looked at it")
    bench.end(chance.choice([signal.SIGKILL, signal.SIGTERM]))
    case.steps.append("reset")
    if chance.random() < 0.5:
        _do(chance.choice(DAMAGES), bench, chance, case)
    _start(bench, case, "reset_tripped")


def _do(step: str, bench: LatchedBench, chance: random.Random, case: Case) -> None:
    case.steps.append(step)
    if step == "kill -9":
        bench.end(signal.SIGKILL)
    elif step == "end":
        bench.end(signal.SIGTERM)
    elif step == "full disk" and bench.disk is not None:
        bench.disk.fill()
    elif step == "room" and bench.disk is not None:
        bench.disk.free()
    elif step in DAMAGES:
        bench.damage(step)


def _make_room(bench: LatchedBench, case: Case) -> None:
    if bench.disk is not None:
        bench.disk.free()
        case.steps.append("room")


def _start(bench: LatchedBench, case: Case, count: str) -> None:
    """A start, and how the bench is found: after the trip it should be tripped, else it should not."""
    state = bench.start()
    is_tripped = state["state"] == "tripped"
    case.steps.append(f"start: {state['state']}")
    if count != "tripped":
        setattr(case, count, getattr(case, count) + is_tripped)
    elif is_tripped:
        case.tripped += 1
    else:
        case.lost += 1


def told(cases: list[Case], with_disks: bool) -> dict[str, Any]:
    """Print what came out; the same as numbers."""
    whole = [case for case in cases if case.failure is None]
    held = sum(case.lost == 0 and case.tripped > 0 for case in whole)
    starts = sum(case.tripped + case.lost for case in whole)
    new, again = sum(case.new_tripped > 0 for case in whole), sum(case.reset_tripped > 0 for case in whole)
    disk = "" if with_disks else "  (without full disks: none can be mounted here)"
    count = len(cases)
    print(f"tripped, then mistreated: still tripped {held} of {count}, at {starts} starts{disk}        asked: all")
    print(f"new benches: tripped at a start {new} of {count}        asked: none")
    print(f"properly reset benches: tripped at the next start {again} of {count}        asked: none")
    for case in cases:
        if case.failure is not None or case.lost or case.new_tripped or case.reset_tripped:
            print(f"    {'; '.join([*case.steps, *(case.failure or '').splitlines()[:1]])}")
            print("".join(f"        {line}\n" for line in (case.failure or "").splitlines()[-1:]), end="")
    return {
        "count": count,
        "still_tripped": held,
        "starts_after_a_trip": starts,
        "new_tripped": new,
        "reset_tripped": again,
        "not_ended": count - len(whole),
        "with_full_disks": with_disks,
    }


def main() -> int:
    asked = options(__doc__, count=100, seed=1)
    with_own_mounts()
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with small_disk(folder / "trial", 1) as disk:
            with_disks = disk is not None
        with ThreadPoolExecutor(asked.workers) as pool:
            numbers = range(asked.seed, asked.seed + asked.count)
            cases = list(pool.map(lambda number: one_case(folder / str(number), number), numbers))
    result = told(cases, with_disks)
    print(f"{time.perf_counter() - begin:.0f} s")
    kept(asked.json, result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
