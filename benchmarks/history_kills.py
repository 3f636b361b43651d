"""Rows that were shown as recorded and are lost: kills at random moments, and a full disk.

    ./peltier benchmark history_kills [--kills 200] [--json FILE]

A process commits rows as fast as it can and shows each only after its commit, as the daemon does; it is killed with
SIGKILL after a random time, 200 times over one history that goes on growing. Then the file may grow no further (a limit
of the operating system on its size, then one of SQLite on its pages) in the middle of writing. Asked: no row that was
shown is lost, and the database is intact every time.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

from rig.history.store import Retention, Store, connect_to_read, what_is_wrong
from rig.history.writer import Writer

ROOM = 3_000_000  # bytes beyond what is there, for the full disk


def write(path: Path, first_s: float, bytes_more: int, pages_more: int) -> None:
    """The child: rows a hundredth of a second apart, each shown on stdout when it is committed."""

    def show(row: dict[str, Any]) -> None:
        sys.stdout.write(f"{row['time_s']!r}\n")
        sys.stdout.flush()

    def failed(text: str) -> None:
        sys.stdout.write(f"failed: {text}\n")
        sys.stdout.flush()
        ended.append(text)

    ended: list[str] = []
    if bytes_more:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        room = path.stat().st_size + bytes_more
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    writer = Writer(path, lambda: Store(path, Retention(raw_days=0.02)), show, failed)
    writer.open()
    if pages_more and writer.store is not None:
        writer.store.limit_size(path.stat().st_size // 4096 + pages_more)
    writer.start()
    k = 0
    while not ended:
        values = {"temperature_degC": 25.0 + k % 7, "resistance_ohm": 1e5 + k, "current_A": 0.1, "phase": "track"}
        writer.row({"time_s": first_s + 0.01 * k, **values}, 0.01 * k)
        k += 1
        if k % 1000 == 0:
            writer.settle(1.0)


def one_life(path: Path, first_s: float, wait_s: float | None, more: list[str]) -> tuple[list[float], bool, int]:
    """Return the rows that a child showed before it told a failure (later ones are shown as not recorded), whether it
    told one, and its exit status. wait_s: until it is killed."""
    command = [sys.executable, __file__, "--write", str(path), repr(first_s), *more]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    lines = [child.stdout.readline()]
    if wait_s is not None:
        threading.Timer(wait_s, child.send_signal, (signal.SIGKILL,)).start()
    lines += child.stdout.read().splitlines(keepends=True)
    child.stdout.close()
    status = child.wait()
    before = itertools.takewhile(lambda line: not line.startswith("failed"), lines)
    shown = [float(line) for line in before if line.endswith("\n")]
    return shown, any(line.startswith("failed") for line in lines), status


def lost(path: Path, shown: list[float]) -> int:
    """How many rows that were shown are not there."""
    connection = connect_to_read(path)
    there = {row[0] for row in connection.execute("SELECT time_s FROM raw WHERE time_s >= ?", (shown[0],))}
    connection.close()
    return len(set(shown) - there)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--json")
    parser.add_argument("--write", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.write:
        path, first_s, bytes_more, pages_more = options.write
        write(Path(path), float(first_s), int(bytes_more), int(pages_more))
        return 0
    chance = random.Random(3)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "history.sqlite"
        missing = damaged = rows = 0
        for k in range(options.kills):
            shown, _, _ = one_life(path, 1.79e9 + 3600.0 * k, chance.uniform(0.0, 0.25), ["0", "0"])
            damaged += what_is_wrong(path) is not None
            missing += lost(path, shown)
            rows += len(shown)
        print(f"kill -9, {options.kills} times, {rows} rows shown: lost {missing}, databases damaged {damaged}"
              "        asked: 0, 0")  # fmt: skip
        full = []
        for name, more in (("disk (size of files)", [str(ROOM), "0"]), ("database (pages)", ["0", str(ROOM // 4096)])):
            shown, told, status = one_life(path, 1.79e9 + 3600.0 * (options.kills + 1 + len(full)), None, more)
            gone, wrong = lost(path, shown), what_is_wrong(path)
            full.append({"lost": gone, "damage": wrong, "told": told, "status": status, "rows": len(shown)})
            print(f"full {name}, {len(shown)} rows shown: lost {gone}, database {wrong or 'intact'}, "
                  f"{'told' if told else 'NOT TOLD'}        asked: 0, intact, told")  # fmt: skip
        size_MB = path.stat().st_size / 1e6
        print(f"history {size_MB:.0f} MB at the end")
    if options.json:
        result = {"kills": options.kills, "rows": rows, "lost": missing, "damaged": damaged, "full": full}
        Path(options.json).write_text(json.dumps(result) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
