"""A real clock, an empty cache, a busy computer: `calibrate`, then `run` of a minute, over pseudo-terminals.

    ./peltier benchmark real_clock [--trials 20] [--busy 2] [--at-once 1]

Each trial has a bench of its own (plates of 10 and 30 J/K by turns, the default limits), a cache of compiled loops that
is empty, and `--busy` endless loops a core beside it; trials that run at once are a load for each other besides. Asked:
every trial to its end; the longest time with a current on and no reading, at the bench's end of the wire, 0.5 s. Told
besides: the run's error, to be compared with that of the same trial with --busy 0.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks._harness import ROOT, options

BUSY = "while True: sum(k * k for k in range(100000))"
LONGEST_S = 900.0

CONFIGURATION = """
[bench]
time = "real"
[bench.controller]
driver = "meerstetter"
port = "{controller}"
[bench.meter]
driver = "keithley2000"
port = "{meter}"
[limits]
temperature_degC = [5, 95]
current_A = 4.0
[experiment]
kind = "track_resistance"
target = [
    "start 20 kohm", "hold 10 s", "ramp to 5 kohm at 0.05 dec/s", "hold 10 s",
    "ramp to 20 kohm at 0.05 dec/s", "hold 16 s"
]
{model}
[calibration]
temperature_degC = [30, 80]
rate_K_per_s = 1.5
minor_loops = 2
[simulation]
seed = {seed}
first_degC = 25.0
[simulation.plate]
seebeck_over_capacity_per_A_s = {s}
resistance_over_capacity_K_per_A2_s = {r}
conductance_over_capacity_per_s = {g}
ambient_degC = 25.0
[simulation.film]
kind = "model"
model = "film.toml"
"""

FILM = """
[film]
kind = "extended_generalized_pi"
output = "minus_log10_ohm"
radii = [0.05, 0.2, 0.5, 0.8]
weights = [0.4, 0.3, 0.2, 0.1]
initial = "heated"
[film.rising]
function = "tanh"
a = 0.2
b = -12.6
[film.falling]
function = "tanh"
a = 0.2
b = -11.8
[film.memoryless]
function = "tanh"
amplitude = 0.4
a = 0.03
b = -1.6
offset = -4.0
"""


def trial(number: int, folder: Path) -> dict[str, Any]:
    """One bench, one evening."""
    capacity = (10.0, 30.0)[number % 2]
    values = {"seed": number, "s": 0.048 / capacity, "r": 1.8 / capacity, "g": 0.54 / capacity}
    (folder / "film.toml").write_text(FILM)
    truth = folder / "truth.toml"
    text = CONFIGURATION.format(controller="sim://", meter="sim://", model="", **values)
    truth.write_text(text)
    noted = folder / "noted.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    bench = subprocess.Popen(
        [sys.executable, str(ROOT / "benchmarks" / "_real_bench.py"), str(truth), str(noted)],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    found: dict[str, Any] = {"number": number, "capacity": capacity}
    try:
        assert bench.stdout is not None
        ports = {line.split()[0]: line.split()[2] for line in (bench.stdout.readline(), bench.stdout.readline())}
        cold = {**environment, "NUMBA_CACHE_DIR": str(folder / "cold")}
        for verb, model in (("calibrate", ""), ("run", 'model = "cal/MODEL.toml"')):
            text = CONFIGURATION.format(**ports, model=model, **values)
            (folder / f"{verb}.toml").write_text(text)
        for verb, out in (("calibrate", folder / "cal"), ("run", folder / "run")):
            begin = time.monotonic()
            done = subprocess.run(
                [
                    sys.executable,
                    "-m",
                    "rig",
                    verb,
                    f"{verb}.toml",
                    "--out",
                    str(out),
                    "--json",
                    str(folder / f"{verb}.json"),
                ],
                env=cold,
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=LONGEST_S,
            )
            found[verb], found[f"{verb}_s"] = done.returncode, time.monotonic() - begin
            if done.returncode:
                found["text"] = done.stderr[-600:]
                break
            cold["NUMBA_CACHE_DIR"] = str(folder / "cold again")
            if verb == "run":  # the ohmmeter's noise is in its error
                found["rms_dec"] = json.loads((folder / "run.json").read_text())["scores"]["full"]["rms_dec"]
    except subprocess.TimeoutExpired:
        found["text"] = f"not over after {LONGEST_S:g} s"
    finally:
        time.sleep(1.1)
        bench.terminate()
        bench.wait(10.0)
        found.update(json.loads(noted.read_text()) if noted.is_file() else {})
    return found


def in_a_folder(number: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        return trial(number, Path(folder))


def main() -> int:
    asked = options(__doc__, trials=20, first=0, busy=2, at_once=1)
    loops = asked.busy * (os.cpu_count() or 1)
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(loops)]
    whole, longest_s = 0, 0.0
    try:
        with ThreadPoolExecutor(asked.at_once) as pool:
            for found in pool.map(in_a_folder, range(asked.first, asked.first + asked.trials)):
                whole += all(found.get(verb) == 0 for verb in ("calibrate", "run"))
                longest_s = max(longest_s, found.get("unread_s", math.inf))
                print(json.dumps(found), flush=True)
    finally:
        for loop in busy:
            loop.kill()
    print(f"to their end: {whole} of {asked.trials} (asked: all), beside {loops} endless loops")
    print(f"longest time with a current on and no reading: {longest_s:.3f} s (asked: 0.5)")
    return 0 if whole == asked.trials and longest_s <= 0.5 else 1


if __name__ == "__main__":
    sys.exit(main())
