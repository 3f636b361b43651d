"""The report of a week: a record of 600,000 rows, and `peltier report` of it in a process of its own.

    ./peltier benchmark week_report [--rows 600000]

The record is that of a short simulated run, its rows again and again, one a second, with a spike of the resistance in
one row. Printed: seconds and peak memory of `report`, and which figures have the spike. Asked: one has it.
"""

from __future__ import annotations

import json
import os
import re
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

SPIKE, SPIKE_AT = 30.0, 0.37  # times the largest resistance; of the target's rows: at none that is taken evenly
MOST_OFF = 0.01  # of the axis, from where the spike is to where a figure has it
MOST_OTHERS = 0.9  # of the spike's height, that any other point of its line has
POINTS = re.compile(r"[ML] (-?[\d.]+) (-?[\d.]+)")


def short_run(folder: Path) -> Path:
    """A run folder of half a minute's target, simulated."""
    path = write_bench(folder)
    words = [sys.executable, "-m", "rig", "run", path.name, "--out", "short"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True)
    return folder / "short"


def rows_of(record: Path, rows: int) -> Iterator[str]:
    """Its lines again and again, one a second; one of them with the spike."""
    head, *lines = record.read_text().splitlines()
    names = head.split(",")
    time_at, ohm_at, phase_at, tick_at = map(names.index, ("time_s", "resistance_ohm", "phase", "tick"))
    fields = [line.split(",") for line in lines]
    tracked = [row for row in fields if row[phase_at] == "track"]
    before = [row for row in fields if row[phase_at] != "track"]
    spike = len(before) + int(SPIKE_AT * (rows - len(before)))
    yield head
    for k, row in enumerate(islice(chain(before, cycle(tracked)), rows)):
        changed = list(row)
        changed[time_at], changed[tick_at] = f"{k}.0", str(k)
        if k == spike:
            changed[ohm_at] = repr(SPIKE * max(float(one[ohm_at]) for one in tracked if one[ohm_at]))
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


def has_spike(figure: Path) -> bool:
    """Whether a line of the figure has one point far above all others, where the spike is."""
    for path in re.findall(r'<path d="([^"]*)"', figure.read_text()):
        points = [(float(x), float(y)) for x, y in POINTS.findall(path)]
        if len(points) < 100:
            continue
        ordered = sorted(points, key=lambda point: point[1])  # the SVG's ordinate points down
        (left, right), (top, bottom) = (f(x for x, _ in points) for f in (min, max)), (ordered[0][1], ordered[-1][1])
        near = MOST_OFF * (right - left)
        others = [y for x, y in points if abs(x - ordered[0][0]) > near]
        at = (ordered[0][0] - left) / max(right - left, 1e-9)
        if abs(at - SPIKE_AT) < MOST_OFF and others and (bottom - min(others)) < MOST_OTHERS * (bottom - top):
            return True
    return False


def main() -> int:
    asked = options(__doc__, rows=600_000)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run = week(short_run(folder), folder / "week", asked.rows)
        print(f"a record of {asked.rows} rows, {(run / 'record.csv').stat().st_size / 1e6:.0f} MB")
        report = [sys.executable, "-m", "rig", "report", str(run), "--out", str(folder / "report")]
        seconds, peak_MB, status = measured(report, folder)
        spiked = sorted(figure.name for figure in (folder / "report" / "figures").glob("*.svg") if has_spike(figure))
        print(f"report: {seconds:.1f} s, {peak_MB:.0f} MB at most, exit status {status}")
        print(f"the spike of one row is in: {', '.join(spiked) or 'no figure'}")
    return 0 if status == 0 and spiked else 1


if __name__ == "__main__":
    sys.exit(main())
