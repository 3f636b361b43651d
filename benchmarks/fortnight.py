"""A fortnight of the daemon's bench process, simulated at one tick a second, with unplugs, garbage and kills.

    ./peltier benchmark fortnight [--days 14] [--json FILE]

The whole bench process on a virtual clock: supervisor, command queue, history with roll-ups, retention; instruments
byte by byte. Every eight hours or so the instruments are unplugged (new ones are there 3 s later), one reply in 5000
has a byte garbled, one in 20000 is lost, a job runs every two hours, and in the first four days the process is killed
with SIGKILL every sixteen hours or so and begun again. Asked: memory does not grow after the first day; late and missed
ticks are counted; the history is whole and has every row that was shown.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

DAY_S, HOUR_S = 86400.0, 3600.0
KILLED_DAYS = 4.0
JOBS_S = 2.0 * HOUR_S
BENCH = """
[bench]
time = "virtual"
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
[limits]
temperature_degC = [10, 95]
current_A = 4.0
[experiment]
kind = "current_profile"
name = "daily"
target = ["start 0 A", "hold 60 s", "step to 0.5 A", "hold 300 s", "step to -0.5 A", "hold 240 s"]
period_s = 1.0
[serve]
folder = "kept"
raw_days = 3.0
[simulation.film]
relays = 40
"""


class Cable:
    """An instrument's cable: now and then a byte of a reply is garbled, or a reply is lost."""

    def __init__(self, instrument: Any, chance: random.Random) -> None:
        self._instrument, self._chance = instrument, chance
        self.receive = instrument.receive
        self.next_transmit_s = instrument.next_transmit_s

    def transmit(self, time_s: float) -> bytes:
        """What arrives."""
        data: bytes = self._instrument.transmit(time_s)
        if data:
            drawn = self._chance.random()
            if drawn < 1 / 20000:
                return b""
            if drawn < 1 / 5000:
                at = self._chance.randrange(len(data))
                return data[:at] + bytes([self._chance.randrange(256)]) + data[at + 1 :]
        return data


def life(folder: Path, seed: int, from_s: float, to_s: float) -> None:
    """One life of the bench process, from a simulated second to another; a line of JSON a simulated hour."""
    import rig.bench.assembly as benches
    from rig.config.configuration import read_configuration
    from rig.core.clock import VirtualClock
    from rig.core.outcome import Stopped
    from rig.daemon.command_queue import CommandQueue
    from rig.daemon.supervisor import Supervisor
    from rig.daemon.systemd import Notifier
    from rig.ports import protocol_sim

    chance = random.Random(seed)
    plain = benches.register
    plugged: list[str] = []

    def register(name: str, instrument: Any, clock: Any) -> str:
        plugged[:] = [*plugged, name][-2:]
        return plain(name, Cable(instrument, chance), clock)

    benches.register = register  # type: ignore[assignment]
    file = read_configuration(folder / "bench.toml")
    commands = CommandQueue(file, VirtualClock(), [])
    begun_s = commands.label_s() - from_s  # labels begin at the same moment in every life
    commands._epoch_s += 1_790_000_000.0 - begun_s
    supervisor = Supervisor(file, commands, Notifier())
    shown = commands._published
    events = {"unplugs": 0, "lost": 0}
    next_s = {"hour": from_s + HOUR_S, "unplug": from_s + chance.uniform(0.5, 1.5) * 8 * HOUR_S, "job": from_s + HOUR_S}

    def told(row: dict[str, Any]) -> None:
        shown(row)
        last["row_s"] = row["time_s"]

    last = {"row_s": 0.0}
    commands.writer._publish = told
    plain_row = commands.row

    def row(row: dict[str, Any]) -> None:
        plain_row(row)
        now_s = row["time_s"] - 1_790_000_000.0
        if now_s >= next_s["job"]:
            next_s["job"] += JOBS_S
            commands.submit(file)
        if now_s >= next_s["unplug"]:
            next_s["unplug"] = now_s + chance.uniform(0.5, 1.5) * 8 * HOUR_S
            events["unplugs"] += 1
            for name in plugged:
                protocol_sim.unregister(name)
        if commands.latch is not None:
            events["lost"] += 1
            commands.reset("the benchmark goes on")
        if now_s >= next_s["hour"]:
            next_s["hour"] += HOUR_S
            line = {"at_s": now_s, "rss_kB": resident_kB(), "row_s": last["row_s"], **commands.ticks.__dict__, **events}
            print(json.dumps(line), flush=True)
        if now_s >= to_s:
            supervisor.end()

    commands.row = row  # type: ignore[method-assign]
    try:
        supervisor.keep()
    except Stopped:
        if commands.writer.store is not None:
            commands.writer.store.close()


def resident_kB() -> int:
    """Memory of this process that is in use."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * (os.sysconf("SC_PAGE_SIZE") // 1024)


def lives(folder: Path, days: float) -> list[list[dict[str, Any]]]:
    """Life after life until the time is over: the lines of each."""
    chance = random.Random(1)
    found, at_s, end_s = [], 0.0, days * DAY_S
    while at_s < end_s:
        killed_s = at_s + chance.uniform(0.5, 1.5) * 16 * HOUR_S
        killed = killed_s < min(KILLED_DAYS * DAY_S, end_s)
        command = [sys.executable, __file__, "--life", str(folder), str(len(found) + 1), str(at_s), str(end_s)]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert child.stdout is not None
        lines = []
        for text in child.stdout:
            lines.append(json.loads(text))
            if killed and lines[-1]["at_s"] >= killed_s:
                child.send_signal(signal.SIGKILL)
                break
        child.stdout.close()
        child.wait()
        found.append(lines)
        if not lines or (not killed and child.returncode != 0):
            raise SystemExit(f"the bench process ended with status {child.returncode} after {at_s} s")
        at_s = lines[-1]["at_s"] if killed else end_s
    return found


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--days", type=float, default=14.0)
    parser.add_argument("--json")
    parser.add_argument("--life", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.life:
        folder, seed, from_s, to_s = options.life
        life(Path(folder), int(seed), float(from_s), float(to_s))
        return 0
    from rig.history.store import connect_to_read, what_is_wrong

    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "bench.toml").write_text(BENCH)
        found = lives(folder, options.days)
        history = folder / "kept" / "history.sqlite"
        wrong = what_is_wrong(history)
        connection = connect_to_read(history)
        lost = 0
        for lines in found:
            shown_s = lines[-1]["row_s"]
            if not connection.execute("SELECT 1 FROM raw WHERE time_s >= ?", (shown_s,)).fetchone():
                lost += 1
        hours = connection.execute("SELECT count(*) FROM hour").fetchone()[0]
        connection.close()
        size_MB = history.stat().st_size / 1e6
    whole = found[-1]
    began_s = whole[0]["at_s"] - HOUR_S
    after = [line["rss_kB"] for line in whole if line["at_s"] - began_s >= DAY_S] or [whole[-1]["rss_kB"]]
    growth_kB = after[-1] - after[0]
    total = {key: sum(lines[-1][key] for lines in found) for key in ("done", "missed", "unplugs", "lost")}
    latest_s = max(lines[-1]["latest_s"] for lines in found)
    days = (whole[-1]["at_s"] - began_s) / DAY_S
    print(f"{options.days:g} days simulated in {time.perf_counter() - begin:.0f} s")
    print(f"memory after the first day, over the {max(days - 1.0, 0.0):.1f} days of the longest life, kB")
    print(f"    from {after[0]} to {after[-1]}: growth {growth_kB:+d}        asked: none")
    print(f"    at the end of each day: {', '.join(str(rss) for rss in after[::24])}")
    print(
        f"ticks done {total['done']}, missed {total['missed']}, latest {latest_s:.2f} s        asked: told and counted"
    )
    print(f"unplugs {total['unplugs']}, kills {len(found) - 1}, trips and their resets {total['lost']}")
    print(f"lives whose last shown row is not in the history {lost}        asked: 0")
    print(f"history: {wrong or 'whole'}, {size_MB:.0f} MB, {hours} hours rolled up        asked: whole")
    if options.json:
        result = {
            "growth_kB": growth_kB,
            "lost": lost,
            "damage": wrong,
            "hours": hours,
            "kills": len(found) - 1,
            **total,
        }
        Path(options.json).write_text(json.dumps(result) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
