"""How near the film's own resistance comes to the wanted one, on a plate and films that no part of the program wrote.

    ./peltier benchmark tracking [--seeds N] [--only class|outside] [--laws full,feedforward] [--current 4] [--repeat N]

The plant (`_tracked_plant`) is behind the emulated instruments, on the virtual clock: 30 J/K, 0.5 W/K, 0.05 V/K, 2 ohm,
25 degC, readings with 0.01 K and n = 0.002 decades of noise, at 10 Hz. The model is what `calibrate` makes of it. The
target stays in the middle 80 % of the film's range: ramps of 0.01 decades/s between random levels, dwells of 30 s, and
a sine of 0.8 decades peak to peak in 300 s. Errors are those of the film itself, in n, from the first row to the last.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import random
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._own_plant import SIMULATED_BENCH, behind_the_instruments, noted_phase
from benchmarks._tracked_plant import NOISE_DEC, FilmOfTheClass, FilmOutsideTheClass, Plate, TrackedPlant

HOT_DEGC, COLD_DEGC = 85.0, 35.0
RATE_DEC_PER_S, DWELL_S, LEVELS = 0.01, 30.0, 6
SINE_DEC, SINE_S = 0.8, 300.0
FILMS = {"class": FilmOfTheClass, "outside": FilmOutsideTheClass}

CONFIGURATION = (
    SIMULATED_BENCH
    + """
[limits]
temperature_degC = [10, 95]
current_A = {current}
[experiment]
kind = "track_resistance"
target = "target.csv"
model = "{model}"
law = "{law}"
repeat = {repeat}
period_s = 0.1
[calibration]
temperature_degC = [{low}, {high}]
rate_K_per_s = 0.7
minor_loops = 8
dwell_s = 2.0
"""
)


def span(film: Any) -> tuple[float, float]:
    """The film's range of log10 R over the calibration's temperatures: of its major loop."""
    up = [film.log_ohm(t) for t in np.arange(COLD_DEGC, HOT_DEGC, 0.1)]
    down = [film.log_ohm(t) for t in np.arange(HOT_DEGC, COLD_DEGC, -0.1)]
    return max(min(up), min(down)), min(max(up), max(down))


def course(low: float, high: float, seed: int) -> tuple[list[float], list[float]]:
    """Times and wanted log10 R within the middle 80 %."""
    chance = random.Random(seed)
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    times, values = [0.0, 10.0], [high - 0.3 * (high - low)] * 2

    def to(value: float) -> None:
        times.append(times[-1] + abs(value - values[-1]) / RATE_DEC_PER_S + 1.0)
        values.append(value)
        times.append(times[-1] + DWELL_S)
        values.append(value)

    for _ in range(LEVELS):
        to(chance.uniform(low, high))
    middle = 0.5 * (low + high)
    to(middle)
    begin = times[-1]
    for k in range(1, 601):
        times.append(begin + k * SINE_S / 600)
        values.append(middle + 0.5 * SINE_DEC * math.sin(2.0 * math.pi * k / 600))
    return times, values


def tracked(case: tuple[str, int, tuple[str, ...], float, float, int]) -> dict[str, Any]:
    """Calibrate and run with each law: RMS and largest error of the film, in n."""
    from rig.__main__ import main

    kind, seed, laws, current_A, noise, repeat = case
    folder = Path(tempfile.mkdtemp(prefix="tracking-"))
    low, high = span(FILMS[kind](seed))
    times, values = course(low, high, seed)
    lines = [f"{t:.3f},{10.0**y:.8g}" for t, y in zip(times, values, strict=True)]
    (folder / "target.csv").write_text("time_s,target_ohm\n" + "\n".join(lines) + "\n")
    found: dict[str, Any] = {"film": kind, "seed": seed}
    with behind_the_instruments(
        lambda start_s: TrackedPlant(Plate(), FILMS[kind](seed), seed, start_s, noise)
    ) as plants:
        for verb, law in (("calibrate", "full"), *(("run", law) for law in laws)):
            path = folder / "config.toml"
            model = "target.csv" if verb == "calibrate" else "cal/MODEL.toml"
            times_over = 1 if verb == "calibrate" else repeat
            path.write_text(
                CONFIGURATION.format(
                    current=current_A, model=model, law=law, low=COLD_DEGC, high=HOT_DEGC, repeat=times_over
                )
            )
            out = folder / ("cal" if verb == "calibrate" else law)
            err = io.StringIO()
            note = noted_phase(lambda name: name == "track", lambda: float(plants[-1].time_s))
            with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()), note as begin_s:
                status = main([verb, str(path), "--out", str(out)])
            if status:
                found["text"] = f"{verb} {law}: {err.getvalue()[-300:]}"
                break
            if verb == "run":
                errors = [error(plants[-1], begin, times, values) for begin in begin_s]
                found[law] = errors[-1]
                found[f"{law}, repetitions"] = [rms for rms, _ in errors]
    shutil.rmtree(folder, ignore_errors=True)
    return found


def error(plant: TrackedPlant, begin_s: float, times: list[float], values: list[float]) -> tuple[float, float]:
    """RMS and largest, in n, of the film itself over the whole target."""
    time, _, log_ohm = np.array(plant.course).T
    grid = np.arange(0.0, times[-1], 0.05)
    off = np.interp(begin_s + grid, time, log_ohm) - np.interp(grid, times, values)
    return float(np.sqrt(np.mean(off**2))) / NOISE_DEC, float(np.max(np.abs(off))) / NOISE_DEC


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=sorted(FILMS))
    parser.add_argument("--laws", default="full,feedforward")
    parser.add_argument("--current", type=float, default=4.0, help="limit, A")
    parser.add_argument("--noise", type=float, default=1.0, help="of both instruments, in times")
    parser.add_argument(
        "--repeat", type=int, default=1, help="repetitions that learn; the errors are those of the last"
    )
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    laws = tuple(options.laws.split(","))
    kinds = [options.only] if options.only else list(FILMS)
    seeds = range(options.first, options.first + options.seeds)
    cases = [(kind, seed, laws, options.current, options.noise, options.repeat) for kind in kinds for seed in seeds]
    with ProcessPoolExecutor(options.workers) as pool:
        found = list(pool.map(tracked, cases))
    print(f"errors of the film in n = {NOISE_DEC} decades: RMS (largest)")
    for result in found:
        words = "   ".join(f"{law} {result[law][0]:5.2f} ({result[law][1]:5.2f})" for law in laws if law in result)
        print(f"{result['film']:8s} {result['seed']:3d}   {words}   {json.dumps(result.get('text', ''))}")
        for law in laws if options.repeat > 1 else ():
            each = result.get(f"{law}, repetitions", [])
            print(f"{'':15s}{law}: " + ", ".join(f"{rms:.2f}" for rms in each) + " n, repetition by repetition")
    for kind in kinds:
        for law in laws:
            rms = [r[law][0] for r in found if r["film"] == kind and law in r]
            most = [r[law][1] for r in found if r["film"] == kind and law in r]
            if rms:
                print(f"{kind:8s} {law:12s} median {np.median(rms):5.2f}   worst {max(rms):5.2f}   ({max(most):5.2f})")
    return 0 if all("text" not in r for r in found) else 1


if __name__ == "__main__":
    sys.exit(main())
