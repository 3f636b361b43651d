"""Stalls of the computer in mid run: a minute's target over pseudo-terminals, calm, then with three stalls of 1.5 s.

    ./peltier benchmark real_clock_stalls [--stalls 3] [--seconds 1.5]

A plate of 30 J/K and a film of which the run has the exact model, the emulated bench in a process that is not held up.
For each run: RMS and largest error of the readings against the target (the ohmmeter's noise is in them), decades, how
it ended, and the longest time with a current on and no reading, at the bench's end of the wire. Asked: every run to its
end. A stall is shorter than `limits.stale_s` (2 s); a longer one ends a run, as it should. Skipped, with the reason,
where no process can be held up (ptrace).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks._frozen import freeze, impossible_because  # noqa: E402
from benchmarks.real_clock import CONFIGURATION, FILM, LONGEST_S, followed  # noqa: E402
from rig.ports.open import holder  # noqa: E402

CAPACITY = 30.0  # J/K
PLATE = {"seed": 1, "s": 0.048 / CAPACITY, "r": 1.8 / CAPACITY, "g": 0.54 / CAPACITY}
MODEL = f"""
[plate]
kind = "peltier"
seebeck_over_capacity_per_A_s = {PLATE["s"]}
resistance_over_capacity_K_per_A2_s = {PLATE["r"]}
conductance_over_capacity_per_s = {PLATE["g"]}
ambient_degC = 25.0
"""
FIRST_S, BETWEEN_S = 2.0, 8.0  # of the target, until the first stall; from the end of one to the next


def tracks(part: Path) -> bool:
    """Whether the target has begun."""
    try:
        lines = (part / "record.csv").read_text().splitlines()
    except OSError:
        return False
    return len(lines) > 2 and lines[-2].endswith(",track")


def stall(run: subprocess.Popen[str], part: Path, port: str, stalls: int, seconds: float, held: list[int]) -> None:
    """Hold up the process that holds the port, so many times; the threads that it had each time."""
    while run.poll() is None and not tracks(part):
        time.sleep(0.2)
    for number in range(stalls):
        time.sleep(BETWEEN_S if number else FIRST_S)
        pid, _ = holder(port)
        if pid is None or run.poll() is not None:
            return
        held.append(freeze(pid, seconds))


def trial(folder: Path, stalls: int, seconds: float) -> dict[str, Any]:
    """One run on a bench of its own."""
    (folder / "film.toml").write_text(FILM)
    (folder / "model.toml").write_text(FILM + MODEL)
    truth, noted = folder / "truth.toml", folder / "noted.json"
    truth.write_text(CONFIGURATION.format(controller="sim://", meter="sim://", model="", **PLATE))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / "benchmarks" / "_real_bench.py"), str(truth), str(noted)]
    bench = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    held: list[int] = []
    try:
        assert bench.stdout is not None
        ports = {line.split()[0]: line.split()[2] for line in (bench.stdout.readline(), bench.stdout.readline())}
        (folder / "run.toml").write_text(CONFIGURATION.format(**ports, model='model = "model.toml"', **PLATE))
        words = ["run", "run.toml", "--out", "run", "--json", "run.json"]
        command = [sys.executable, "-m", "rig", *words]
        run = subprocess.Popen(
            command, cwd=folder, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        )
        by = threading.Thread(target=stall, args=(run, folder / "run.part", ports["controller"], stalls, seconds, held))
        by.start()
        try:
            _, err = run.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            run.terminate()
            _, err = run.communicate()
        by.join()
        time.sleep(1.1)  # until the bench has noted
    finally:
        bench.terminate()
        bench.wait(10.0)
    found: dict[str, Any] = {"stalls": len(held), "status": run.returncode, "ended": ended(folder)}
    if noted.is_file():
        found["unread_s"] = json.loads(noted.read_text())["unread_s"]
    return found | (followed(folder / "run.json") if run.returncode == 0 else {"err": err[-600:]})


def ended(folder: Path) -> dict[str, Any]:
    """How the run itself says that it ended."""
    for part in ("run", "run.part"):
        if (path := folder / part / "run.json").is_file():
            stop = json.loads(path.read_text()).get("stop", {})
            return {key: stop.get(key) for key in ("reason", "output_off_confirmed", "ticks")}
    return {}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stalls", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=1.5)
    options = parser.parse_args()
    if why := impossible_because():
        print(f"skipped: {why}")
        return 0
    whole = True
    for name, stalls in (("calm", 0), (f"{options.stalls} stalls of {options.seconds:g} s", options.stalls)):
        with tempfile.TemporaryDirectory() as folder:
            found = trial(Path(folder), stalls, options.seconds)
        print(json.dumps(found), flush=True)
        whole &= found["status"] == 0 and found["stalls"] == stalls
        rms, largest = found.get("rms_dec", math.nan), found.get("max_dec", math.nan)
        unread_s = found.get("unread_s", math.nan)
        print(
            f"{name}: RMS error {rms:.4f}, largest {largest:.4f} decades; ended: {found['ended'].get('reason')}; "
            f"longest time without a reading {unread_s:.2f} s",
            flush=True,
        )
    return 0 if whole else 1


if __name__ == "__main__":
    sys.exit(main())
