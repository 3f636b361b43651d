"""kill -9 of the process that holds the port, at random moments: how soon the guard's off command is on the wire.

    ./peltier benchmark guard [--kills 200] [--driver meerstetter] [--at-once 3] [--json FILE]

Asked: output off at the instrument every time, 20 ms in the median. Each kill is a real `peltier run` on
pseudo-terminals. `told` is from the kill to the last byte of the off command at the instrument's end of the line;
`off` until no current flows there (the emulated line takes its time for each byte, and so does the instrument). Runs
come up side by side, on pseudo-terminals of their own, because a run's imports take the most time.
"""

from __future__ import annotations

import random
import statistics
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks._harness import kept, options
from benchmarks._killed_run import OFF, Killed, KilledRuns

LONGEST_S = 1.0  # after the output came on


def quantile(values: list[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def killed(driver: str, kills: int, seed: int) -> tuple[list[Killed], tuple[int, int]]:
    """So many kills, one after the other, and the guard's memory (kB)."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder, KilledRuns(Path(folder), driver) as runs:
        found = []
        for k in range(kills):
            found.append(runs.kill(chance.uniform(0.0, LONGEST_S)))
            print(f"{driver} {k + 1} of {kills}: {1e3 * found[-1].told_after_s:.1f} ms", file=sys.stderr, flush=True)
        return found, runs.guard_kB


def main() -> int:
    asked = options(__doc__, kills=200, driver=tuple(sorted(OFF)), seed=1, at_once=3)
    rows = {}
    print(
        f"{'controller':<15}{'kills':>6}{'off':>6}  {'told: median':>12}{'95 %':>8}{'max':>8}"
        f"  {'off: median':>12}{'max':>8}"
    )
    for driver in asked.driver:
        shares = [asked.kills // asked.at_once + (k < asked.kills % asked.at_once) for k in range(asked.at_once)]
        jobs = [(driver, share, asked.seed + k) for k, share in enumerate(shares) if share]
        with ThreadPoolExecutor(len(jobs)) as pool:
            parts = list(pool.map(killed, *zip(*jobs, strict=True)))
        kills = [kill for found, _ in parts for kill in found]
        resident, private = parts[0][1]
        told, off = [1e3 * k.told_after_s for k in kills], [1e3 * k.off_after_s for k in kills]
        confirmed = sum(k.off_at_the_end and k.status == 137 and "output off, confirmed" in k.err for k in kills)
        rows[driver] = {
            "kills": len(kills),
            "off_and_confirmed": confirmed,
            "told_ms": {"median": statistics.median(told), "p95": quantile(told, 0.95), "max": max(told)},
            "off_ms": {"median": statistics.median(off), "max": max(off)},
            "guard_resident_kB": resident,
            "guard_private_kB": private,
        }
        print(
            f"{driver:<15}{len(kills):>6}{confirmed:>6}  {statistics.median(told):>9.1f} ms{quantile(told, 0.95):>8.1f}"
            f"{max(told):>8.1f}  {statistics.median(off):>9.1f} ms{max(off):>8.1f}   guard: {resident / 1e3:.1f} MB "
            f"resident, {private / 1e3:.1f} MB its own",
            flush=True,
        )
        for kill in kills:
            if not (kill.off_at_the_end and kill.status == 137):
                print(f"  status {kill.status}: {kill.err.strip()}")
    print("asked: off every time, 20 ms in the median")
    kept(asked.json, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
