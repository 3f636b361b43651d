"""Steps of the wanted resistance that nobody announced: how far the film overshoots, and when it is there.

    ./peltier benchmark causal_steps [--seeds N] [--steps 50] [--only class,outside,wrong]

Plate and films are those of `benchmark tracking`, the model is what `calibrate` makes of them. The law sees a target
that never changes until it does: steps of 0.5 decades to and fro across the middle 80 % of the film's range, 30 s each.
It runs beside the plate with the emulated instruments' moments (`_beside_the_plant`). An overshoot writes a turning
point into the film's memory that nobody planned.

"Settled" is within 0.01 decades to the end of the step; it is told over the time that the fastest plan needs from the
moment of the step, which knows plate and film as they are: all the current until the film is within 0.01 decades.
wrong: film outside the class, the wrong plate of `benchmark tracking`; the model knows the thermometer's lag.
"""

from __future__ import annotations

import contextlib
import copy
import io
import math
import random
import shutil
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks._beside_the_plant import PERIOD_S, driven, placed
from benchmarks._harness import options
from benchmarks._hidden_effects import EffectPlant, Hidden
from benchmarks._own_plant import KELVIN, behind_the_instruments
from benchmarks._tracked_plant import Plate, TrackedPlant
from benchmarks._tracking_runs import COLD_DEGC, CONFIGURATION, FILMS, HOT_DEGC, NOMINAL, WRONG, WRONG_LAG_S, span
from compensator.control.law import Law
from rig.config.configuration import read_configuration
from rig.config.model_file import Model, read_model
from rig.experiment.extended_model import chain_observer
from rig.experiment.tracking import law_and_design
from sim.effects.effect import switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG

LIMIT_A, STEP_DEC, DWELL_S, WITHIN_DEC = 4.0, 0.5, 30.0, 0.01
PLAN_STEP_S = 0.01


@dataclass(frozen=True)
class Asked:
    """Of a kind of rig: largest overshoot (decades; None: nothing), settled over the fastest plan."""

    overshoot_dec: float | None
    median: float
    most: float


ASKED = {
    "class": Asked(0.002, 1.05, 1.15),
    "outside": Asked(0.010, 1.15, 1.4),
    "wrong": Asked(None, 1.3, 2.0),
}


@dataclass
class Rows:
    """Of each step: overshoot (decades), settled after (s), the same over the fastest plan."""

    overshoot_dec: list[float] = field(default_factory=list)
    settled_s: list[float] = field(default_factory=list)
    over_fastest: list[float] = field(default_factory=list)


def calibrated(kind: str, seed: int) -> tuple[Model, Law]:
    """What `calibrate` makes of such a rig, and the full law on it as a run has it."""
    from rig.__main__ import main

    folder = Path(tempfile.mkdtemp(prefix="steps-"))
    (folder / "target.csv").write_text("time_s,target_ohm\n0,1e4\n1,1e4\n")
    path, film = folder / "config.toml", "outside" if kind == "wrong" else kind
    path.write_text(CONFIGURATION.format(current=LIMIT_A, model="target.csv", law="full", low=COLD_DEGC, high=HOT_DEGC))
    made = behind_the_instruments(lambda start_s: TrackedPlant(NOMINAL, FILMS[film](seed), seed, start_s))
    with made, contextlib.redirect_stdout(io.StringIO()):
        assert main(["calibrate", str(path), "--out", str(folder / "cal")]) == 0
    model = read_model(folder / "cal" / "MODEL.toml", needs=("film", "plate"))
    law = law_of(replace(model, effects=()) if kind != "wrong" else model, kind, path)
    shutil.rmtree(folder, ignore_errors=True)
    return model, law


def law_of(model: Model, kind: str, path: Path) -> Law:
    """The full law as a run of this configuration has it; of a wrong rig the thermometer's lag is known."""
    assert model.film is not None
    assert model.plate is not None
    effects = [switched(SENSOR_LAG, {"tau_s": WRONG_LAG_S})] if kind == "wrong" else []
    observer = chain_observer(effects, model.plate, model.film, PERIOD_S)
    return law_and_design("full", read_configuration(path).content, model.film, model.plate, observer)[0]


def levels(kind: str, seed: int, count: int) -> list[float]:
    """Wanted log10 R, one after the other."""
    low, high = span(FILMS[kind](seed))
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    middle = 0.5 * (low + high)  # of a narrow film no step fits from there
    chance, found = random.Random(seed), [middle if high - low > 2.0 * STEP_DEC else middle - 0.5 * STEP_DEC]
    for _ in range(count):
        there = [y for y in (found[-1] - STEP_DEC, found[-1] + STEP_DEC) if low < y < high]
        found.append(chance.choice(there))
    return found


def plant_for(kind: str, seed: int) -> TrackedPlant:
    """The film on its plate, from the cold."""
    if kind != "wrong":
        return TrackedPlant(NOMINAL, FILMS[kind](seed), seed, 0.0)
    return EffectPlant(WRONG, FILMS["outside"](seed), seed, 0.0, Hidden(sensor_lag_s=WRONG_LAG_S))


def fastest_s(plant: TrackedPlant, target: float) -> float:
    """How long the fastest plan takes from here until the film is within `WITHIN_DEC` of the target (log10 R)."""
    film, degC, plate = copy.deepcopy(plant.film), plant.degC, plant.plate
    log_ohm, k = plant.log_ohm, 0
    sign = 1.0 if log_ohm > target else -1.0  # heating lowers the resistance
    while sign * (log_ohm - target) > WITHIN_DEC:
        degC += PLAN_STEP_S * fastest_rate(plate, degC, sign)
        log_ohm = film.log_ohm(degC)
        k += 1
        assert k * PLAN_STEP_S < DWELL_S, "the step is not to be had"
    return k * PLAN_STEP_S


def fastest_rate(plate: Plate, degC: float, sign: float) -> float:
    """K/s at all the current, or what cools most."""
    current = LIMIT_A if sign > 0.0 else -min(LIMIT_A, plate.seebeck * (degC + KELVIN) / plate.resistance)
    heat = plate.seebeck * current * (degC + KELVIN) + 0.5 * plate.resistance * current**2
    return (heat - plate.conductance * (degC - plate.ambient_degC)) / plate.capacity


def stepped(case: tuple[str, int, int]) -> Rows:
    """What one film gave."""
    kind, seed, count = case
    (model, law), wanted = calibrated(kind, seed), levels("outside" if kind == "wrong" else kind, seed, count)
    assert model.film is not None
    plant = plant_for(kind, seed)
    state = placed(plant, law, model.film, wanted[0], HOT_DEGC)
    ticks, plans = round(DWELL_S / PERIOD_S), []

    def planned(k: int) -> None:
        if k % ticks == 0 and k > 0:
            plans.append(fastest_s(plant, wanted[k // ticks]))

    begun_s = [0.0]  # the law is told of a step at its tick, and sees no other target ahead until then

    def announced(times_s: np.ndarray) -> np.ndarray:
        if np.ndim(times_s) == 0:
            begun_s[0] = float(times_s)
        return np.full(np.shape(times_s), wanted[min(int(begun_s[0] / DWELL_S), len(wanted) - 1)])

    driven(plant, law, state, announced, DWELL_S * len(wanted), planned)
    time, _, log_ohm = np.array(plant.course).T
    found = Rows()
    for k, ((before, after), fastest) in enumerate(zip(pairwise(wanted), plans, strict=True), 1):
        inside = (time >= k * DWELL_S) & (time < (k + 1) * DWELL_S)
        off = log_ohm[inside] - after
        away = np.flatnonzero(np.abs(off) > WITHIN_DEC)
        settled_s = float(time[inside][away[-1]] - k * DWELL_S) if away.size else 0.0
        found.overshoot_dec.append(max(float(np.max(math.copysign(1.0, after - before) * off)), 0.0))
        found.settled_s.append(settled_s)
        found.over_fastest.append(settled_s / fastest)
    return found


def measured(pool: Executor, kind: str, seeds: Iterable[int], steps: int) -> Rows:
    """The steps of several films of a kind."""
    whole = Rows()
    for rows in pool.map(stepped, [(kind, seed, steps) for seed in seeds]):
        whole.overshoot_dec += rows.overshoot_dec
        whole.settled_s += rows.settled_s
        whole.over_fastest += rows.over_fastest
    return whole


def main() -> int:
    options_ = options(__doc__, only=tuple(ASKED), seeds=10, first=0, steps=50)
    good = True
    with ProcessPoolExecutor(options_.workers) as pool:
        for kind in options_.only:
            asked, seeds = ASKED[kind], range(options_.first, options_.first + options_.seeds)
            rows = measured(pool, kind, seeds, options_.steps)
            most, over = max(rows.overshoot_dec), rows.over_fastest
            good &= asked.overshoot_dec is None or most <= asked.overshoot_dec
            good &= float(np.median(over)) <= asked.median and max(over) <= asked.most
            limit = f" (asked {asked.overshoot_dec:g})" if asked.overshoot_dec is not None else ""
            median = float(np.median(rows.overshoot_dec))
            print(f"{kind:8s} {len(over)} steps: overshoot median {median:.4f}, largest {most:.5f} decades{limit}")
            times = f"after {np.median(rows.settled_s):.1f} s (median), {max(rows.settled_s):.1f} s (most)"
            print(
                f"{'':8s} within {WITHIN_DEC:g} decades {times}; over the fastest plan {np.median(over):.2f} (asked ",
                end="",
            )
            print(f"{asked.median:g}), most {max(over):.2f} (asked {asked.most:g})", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
