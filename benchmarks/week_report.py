"""The report of a week: a record of 600,000 rows, and `peltier report` of it in a process of its own.

    ./peltier benchmark week_report [--rows 600000]

The record is that of a short simulated run, its rows again and again, one a second. Printed: seconds and peak memory.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import chain, cycle, islice
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._harness import ROOT, options
from tests.rig.small import write_bench


def short_run(folder: Path) -> Path:
    """A run folder of half a minute's target, simulated."""
    path = write_bench(folder)
    words = [sys.executable, "-m", "rig", "run", path.name, "--out", "short"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True)
    return folder / "short"


def rows_of(record: Path, rows: int) -> Iterator[str]:
    """Its lines again and again, one a second."""
    head, *lines = record.read_text().splitlines()
    names = head.split(",")
    time_at, phase_at, tick_at = map(names.index, ("time_s", "phase", "tick"))
    fields = [line.split(",") for line in lines]
    tracked, before = ([row for row in fields if (row[phase_at] == "track") == is_it] for is_it in (True, False))
    yield head
    for k, row in enumerate(islice(chain(before, cycle(tracked)), rows)):
        changed = list(row)
        changed[time_at], changed[tick_at] = f"{k}.0", str(k)
        yield ",".join(changed)


def week(short: Path, folder: Path, rows: int) -> Path:
    """The same run with that many rows. Its folder."""
    shutil.copytree(short, folder, ignore=shutil.ignore_patterns("record.*", "report.html", "figures"))
    with (folder / "record.csv").open("w") as file:
        file.writelines(f"{line}\n" for line in rows_of(short / "record.csv", rows))
    document = json.loads((folder / "run.json").read_text())
    document["stop"]["rows"] = rows
    (folder / "run.json").write_text(json.dumps(document))
    return folder


def measured(words: list[str], folder: Path) -> tuple[float, float, int]:
    """Seconds, peak memory (MB), exit status of a process of its own.

    The peak is the kernel's (wait4); it is no less than that of this process, which is small.
    """
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    begin = time.perf_counter()
    process = subprocess.Popen(words, cwd=folder, env=environment, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return time.perf_counter() - begin, used.ru_maxrss / 1024.0, process.returncode


def main() -> int:
    asked = options(__doc__, rows=600_000)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run = week(short_run(folder), folder / "week", asked.rows)
        print(f"a record of {asked.rows} rows, {(run / 'record.csv').stat().st_size / 1e6:.0f} MB")
        report = [sys.executable, "-m", "rig", "report", str(run), "--out", str(folder / "report")]
        seconds, peak_MB, status = measured(report, folder)
        print(f"report: {seconds:.1f} s, {peak_MB:.0f} MB at most, exit status {status}")
    return status


if __name__ == "__main__":
    sys.exit(main())
