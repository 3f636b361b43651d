"""Steps of the wanted resistance that nobody announced: how far the film overshoots.

    ./peltier benchmark causal_steps [--seeds N] [--steps 50] [--only class,outside]

Plate and films are those of `benchmark tracking`, the model is what `calibrate` makes of them. The law sees a target
that never changes until it does: steps of 0.5 decades to and fro across the middle 80 % of the film's range, 30 s each.
It runs beside the plate with the emulated instruments' moments (`_bench`). An overshoot writes a turning point into the
film's memory that nobody planned. "Settled" is within 0.01 decades to the end of the step.
"""

from __future__ import annotations

import math
import random
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks._bench import NOMINAL, PERIOD_S, calibrated, driven, middle_of, placed
from benchmarks._harness import options, side_by_side
from rig.config.configuration import read_configuration
from rig.control.law_units import chain_observer
from rig.experiment.tracking import law_and_design
from tests.truth import FILMS, Film, Plant

STEP_DEC, DWELL_S, WITHIN_DEC = 0.5, 30.0, 0.01
ASKED_DEC = {"class": 0.002, "outside": 0.010}  # largest overshoot by the kind of film


def levels(film: Film, seed: int, count: int) -> list[float]:
    """Wanted log10 R, one after the other."""
    low, high = middle_of(film)
    middle = 0.5 * (low + high)  # of a narrow film no step fits from there
    chance, found = random.Random(seed), [middle if high - low > 2.0 * STEP_DEC else middle - 0.5 * STEP_DEC]
    for _ in range(count):
        found.append(chance.choice([y for y in (found[-1] - STEP_DEC, found[-1] + STEP_DEC) if low < y < high]))
    return found


def stepped(case: tuple[str, int, int]) -> list[tuple[float, float]]:
    """Return overshoot (decades) and time until it has settled (s) of each step of one film."""
    kind, seed, count = case
    film = FILMS[kind](seed)
    with tempfile.TemporaryDirectory(prefix="steps-") as folder:
        model = calibrated(Path(folder), film, seed)
        content = read_configuration(Path(folder) / "config.toml").content
    assert model.film is not None
    observer = chain_observer([], model.plate, model.film, PERIOD_S)
    law, _ = law_and_design("full", content, model.film, model.plate, observer)
    plant, wanted = Plant(NOMINAL, film, seed), levels(film, seed, count)
    begun_s = [0.0]  # the law is told of a step at its tick, and sees no other target ahead until then

    def announced(times_s: np.ndarray) -> np.ndarray:
        if np.ndim(times_s) == 0:
            begun_s[0] = float(times_s)
        return np.full(np.shape(times_s), wanted[min(int(begun_s[0] / DWELL_S), len(wanted) - 1)])

    driven(plant, law, placed(plant, law, model.film, wanted[0]), announced, DWELL_S * len(wanted))
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
    asked = options(__doc__, only=tuple(ASKED_DEC), seeds=10, first=0, steps=50)
    good = True
    for kind in asked.only:
        cases = [(kind, seed, asked.steps) for seed in range(asked.first, asked.first + asked.seeds)]
        rows = [row for found in side_by_side(stepped, cases, asked.workers) for row in found]
        overshoot_dec, settled_s = np.array(rows).T
        good &= bool(overshoot_dec.max() <= ASKED_DEC[kind])
        words = f"overshoot median {np.median(overshoot_dec):.4f}, largest {overshoot_dec.max():.5f} decades"
        print(
            f"{kind:8s} {len(rows)} steps: {words} (asked {ASKED_DEC[kind]:g}); within {WITHIN_DEC:g} decades ", end=""
        )
        print(f"after {np.median(settled_s):.1f} s (median), {settled_s.max():.1f} s (most)", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
