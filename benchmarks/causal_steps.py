"""Steps of the wanted resistance that nobody announced: how far the film overshoots, and when it is there.

    ./peltier benchmark causal_steps [--seeds N] [--steps 50]

Plate and films are those of `benchmark tracking`, the model is what `calibrate` makes of them. The law sees a target
that never changes until it does: steps of 0.5 decades to and fro across the middle 80 % of the film's range, 30 s each.
It runs beside the plate with the emulated instruments' moments: ohmmeter, thermometer and command 27, 63 and 80 ms
after each tick. An overshoot writes a turning point into the film's memory that nobody planned.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
import random
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._own_plant import behind_the_instruments
from benchmarks._tracked_plant import Plate, TrackedPlant
from benchmarks.tracking import COLD_DEGC, CONFIGURATION, FILMS, HOT_DEGC, span
from compensator.control.design import design_temperature
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.inverse.inverse import Inverse
from rig.files.model_file import Model, read_model

PERIOD_S, OHMMETER_S, THERMOMETER_S, COMMAND_S = 0.1, 0.027, 0.063, 0.080
LIMIT_A, STEP_DEC, DWELL_S, WITHIN_DEC = 4.0, 0.5, 30.0, 0.01
HORIZON, SPACING_S = 8, 0.5
ASKED = {"class": 0.002, "outside": 0.010}


def calibrated(kind: str, seed: int) -> Model:
    """What `calibrate` makes of such a rig."""
    from rig.__main__ import main

    folder = Path(tempfile.mkdtemp(prefix="steps-"))
    (folder / "target.csv").write_text("time_s,target_ohm\n0,1e4\n1,1e4\n")
    path = folder / "config.toml"
    path.write_text(CONFIGURATION.format(current=LIMIT_A, model="target.csv", law="full", low=COLD_DEGC, high=HOT_DEGC))
    made = behind_the_instruments(lambda start_s: TrackedPlant(Plate(), FILMS[kind](seed), seed, start_s))
    with made, contextlib.redirect_stdout(io.StringIO()):
        assert main(["calibrate", str(path), "--out", str(folder / "cal")]) == 0
    model = read_model(folder / "cal" / "MODEL.toml", needs=("film", "plate"))
    shutil.rmtree(folder, ignore_errors=True)
    return model


def levels(kind: str, seed: int, count: int) -> list[float]:
    """Wanted log10 R, one after the other."""
    low, high = span(FILMS[kind](seed))
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    chance, found = random.Random(seed), [0.5 * (low + high)]
    for _ in range(count):
        there = [y for y in (found[-1] - STEP_DEC, found[-1] + STEP_DEC) if low < y < high]
        found.append(chance.choice(there))
    return found


def stepped(case: tuple[str, int, int]) -> list[tuple[float, float]]:
    """Overshoot (decades) and time until it stays within 0.01 decades (s), of each step."""
    kind, seed, count = case
    model, wanted = calibrated(kind, seed), levels(kind, seed, count)
    assert model.film is not None
    assert model.plate is not None
    gains = design_temperature(PERIOD_S, PERIOD_S, 1.4).gains
    settings = LawSettings("full", PERIOD_S, LIMIT_A, 10.0, 95.0, gains, HORIZON, SPACING_S)
    law, plant = Law(settings, model.plate, model.film), TrackedPlant(Plate(), FILMS[kind](seed), seed, 0.0)
    hot = model.film.initial_memory(HOT_DEGC, "heated")
    first_degC = Inverse(model.film, 10.0, 95.0).solve(-wanted[0], hot).temperature_degC
    for degC in (*np.arange(25.0, HOT_DEGC, 0.1), *np.arange(HOT_DEGC, first_degC, -0.02)):
        plant.film.log_ohm(float(degC))
    plant.degC = first_degC
    state = law.start(first_degC, model.film.step(first_degC, hot)[1])
    ticks = round(DWELL_S / PERIOD_S)
    for k in range(ticks * len(wanted)):
        tick_s, target = k * PERIOD_S, -wanted[k // ticks]
        plant.advance_to(tick_s + OHMMETER_S)
        output = -math.log10(plant.read_resistance_ohm(0.0))
        plant.advance_to(tick_s + THERMOMETER_S)
        reading = plant.read_temperature_degC()
        ages = THERMOMETER_S - OHMMETER_S, COMMAND_S - THERMOMETER_S
        command, state = law.step(state, Inputs(reading, output, target, np.full(HORIZON, target), *ages))
        plant.advance_to(tick_s + COMMAND_S)
        plant.set_current_A(command.current_A)
    time, _, log_ohm = np.array(plant.course).T
    found = []
    for k, (before, after) in enumerate(pairwise(wanted), 1):
        inside = (time >= k * DWELL_S) & (time < (k + 1) * DWELL_S)
        off = log_ohm[inside] - after
        away = np.flatnonzero(np.abs(off) > WITHIN_DEC)
        settled_s = float(time[inside][away[-1]] - k * DWELL_S) if away.size else 0.0
        found.append((max(float(np.max(math.copysign(1.0, after - before) * off)), 0.0), settled_s))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--steps", type=int, default=50, help="of each film")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    good = True
    for kind in FILMS:
        with ProcessPoolExecutor(options.workers) as pool:
            rows = [row for each in pool.map(stepped, [(kind, s, options.steps) for s in seeds]) for row in each]
        overshoot, settled_s = np.array(rows).T
        good &= float(np.max(overshoot)) <= ASKED[kind]
        largest = f"largest {np.max(overshoot):.4f} decades (asked {ASKED[kind]:g})"
        times = f"after {np.median(settled_s):.1f} s (median), {np.max(settled_s):.1f} s (most)"
        print(f"{kind:8s} {len(rows)} steps: overshoot median {np.median(overshoot):.4f}, {largest}")
        print(f"{'':8s} within {WITHIN_DEC:g} decades {times}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
