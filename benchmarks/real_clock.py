"""A real clock, an empty cache, a busy computer: `calibrate`, then `run` of a minute, over pseudo-terminals.

    ./peltier benchmark real_clock [--trials 20] [--busy 2] [--rest] [--at-once 1] [--effect NAME:param=value]

Each trial has a bench of its own (plates of 10 and 30 J/K by turns, the default limits), a cache of compiled loops that
is empty, and `--busy` endless loops a core beside it; trials that run at once are a load for each other besides. Asked:
every trial to its end; the longest time with a current on and no reading, at the bench's end of the wire, 0.5 s. Told
besides: the run's error, to be compared with that of the same trial with --rest.
Stalls of the computer: `benchmark real_clock_stalls`.
--rest: without the loops. --effect: hidden in the rig; the run is then improved (`improve RUN --yes`) on that bench.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from rig.config.effect_tables import parse_effect  # noqa: E402

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


def hidden(effect: str) -> str:
    """An effect in words as a table of a configuration; nothing for nothing."""
    if not effect:
        return ""
    lines = [f"{name} = {json.dumps(value)}" for name, value in parse_effect(effect).items()]
    return "\n".join(["[[simulation.effects]]", *lines, ""])


def gained(folder: Path) -> dict[str, Any]:
    """What `improve` says: what it named or tried, and by which share the error became smaller; of other folders
    nothing."""
    path = folder / "improvement.json"
    if not path.is_file():
        return {}
    document = json.loads(path.read_text())
    return {key: document.get(key) for key in ("new", "tried", "reduction", "not_run_because")}


def followed(path: Path) -> dict[str, float]:
    """RMS and largest error of the run's readings against its target, decades; the ohmmeter's noise is in them."""
    score = json.loads(path.read_text())["scores"]["full"]
    return {key: score[key] for key in ("rms_dec", "max_dec")}


def verbs(effect: str) -> tuple[str, ...]:
    """What a trial runs, one after the other."""
    return ("calibrate", "run", "improve") if effect else ("calibrate", "run")


def trial(number: int, folder: Path, effect: str) -> dict[str, Any]:
    """One bench, one evening."""
    capacity = (10.0, 30.0)[number % 2]
    values = {"seed": number, "s": 0.048 / capacity, "r": 1.8 / capacity, "g": 0.54 / capacity}
    (folder / "film.toml").write_text(FILM)
    truth = folder / "truth.toml"
    text = CONFIGURATION.format(controller="sim://", meter="sim://", model="", **values)
    truth.write_text(text + hidden(effect))
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
        for verb in verbs(effect):
            out = folder / ("cal" if verb == "calibrate" else verb)
            words = ["run", "--config", "run.toml", "--yes"] if verb == "improve" else [f"{verb}.toml"]
            begin = time.monotonic()
            done = subprocess.run(
                [sys.executable, "-m", "rig", verb, *words, "--out", str(out), "--json", str(folder / f"{verb}.json")],
                env=cold,
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=LONGEST_S,
            )
            found[verb], found[f"{verb}_s"] = done.returncode, time.monotonic() - begin
            document = next(
                (p for p in (out / "run.json", folder / f"{out.name}.part" / "run.json") if p.is_file()), None
            )
            if document is not None:
                found[f"{verb}_ticks"] = json.loads(document.read_text()).get("stop", {}).get("ticks")
            if done.returncode:
                found["text"] = done.stderr[-600:]
                break
            cold["NUMBA_CACHE_DIR"] = str(folder / "cold again")
            found.update(gained(out))
            if verb == "run":
                found.update(followed(folder / "run.json"))
    except subprocess.TimeoutExpired:
        found["text"] = f"not over after {LONGEST_S:g} s"
    finally:
        time.sleep(1.1)
        bench.terminate()
        bench.wait(10.0)
        found.update(json.loads(noted.read_text()) if noted.is_file() else {})
    return found


def _in_a_folder(number: int, effect: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        return trial(number, Path(folder), effect)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--busy", type=int, default=2, help="endless loops a core")
    parser.add_argument("--at-once", type=int, default=1, help="trials that run beside each other")
    parser.add_argument("--rest", action="store_true", help="no endless loops")
    parser.add_argument("--effect", default="", metavar="NAME:param=value", help="hidden in the rig, and improved")
    options = parser.parse_args()
    trials = range(options.first, options.first + options.trials)
    loops = 0 if options.rest else options.busy * (os.cpu_count() or 1)
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(loops)]
    whole, longest_s = 0, 0.0
    try:
        with ThreadPoolExecutor(options.at_once) as pool:
            for found in pool.map(partial(_in_a_folder, effect=options.effect), trials):
                whole += all(found.get(verb) == 0 for verb in verbs(options.effect))
                longest_s = max(longest_s, found.get("unread_s", math.inf))
                print(json.dumps(found), flush=True)
    finally:
        for loop in busy:
            loop.kill()
    beside = f"{loops} endless loops and {options.at_once - 1} other trials"
    print(f"to their end: {whole} of {options.trials} (asked: all), beside {beside}")
    print(f"longest time with a current on and no reading: {longest_s:.3f} s (asked: 0.5)")
    return 0 if whole == options.trials and longest_s <= 0.5 else 1


if __name__ == "__main__":
    sys.exit(main())
