"""What a driver's delay costs on a film that no model tells exactly, whatever the law: corrections come that much late.

    ./peltier benchmark late_correction [--seeds N] [--first 10] [--film outside|class]

Plate, films, target and noise are those of `benchmark tracking`. For each film the rig is calibrated, and the full law
runs beside the plant (`_bench`) without a delay and with one of 1 s that it knows exactly. What the film
model gets wrong of the true course is an error along that course. It is then predicted from the ohmmeter's readings,
one a period and each the mean of two integrations as the law has them, as late as they reach the film: half a period,
the readings' age, and the delay. The predictor is a Kalman filter for a
random walk along the course, of the size that turns out best in hindsight, told the noise. What it leaves is about the
least that a law can leave which corrects this model so; plate and turning points cost nothing in it. Errors are RMS,
and in brackets the largest: the predictor's own largest, which another predictor might trade for a larger RMS.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks._bench import (
    AGES_S,
    HOT_DEGC,
    NOMINAL,
    OHMMETER_S,
    PERIOD_S,
    SETTLE_S,
    calibrated,
    course,
    driven,
    error,
    placed,
)
from benchmarks._harness import options, side_by_side
from compensator.hysteresis.film import FilmModel
from rig.config.configuration import read_configuration
from rig.control.law_units import chain_observer
from rig.experiment.tracking import law_and_design
from sim.effects.actuator_delay import EFFECT as DELAY
from sim.effects.effect import switched
from tests.truth import FILMS, NOISE_DEC, Plant

DELAY_S = 1.0
STEP_S = 0.01  # of the courses that are compared: a tenth of a period
READ_DEC = NOISE_DEC / len(OHMMETER_S) ** 0.5  # noise of a reading
WALKS = np.geomspace(1e-6, 3e-3, 25)  # variance (decades^2) along `LENGTH_DEC`, tried: errors of 0.001 to 0.05 decades
LENGTH_DEC = 0.05
NOISES = 3  # drawn, and averaged over
Errors = tuple[float, float]  # RMS and largest, in n


def predicted(true_log_ohm: np.ndarray, off: np.ndarray, used: np.ndarray, late_s: float) -> Errors:
    """What the best of the predictors leaves of the model's error `off`, from readings that are late_s old:
    the one whose RMS is least; means over the noises drawn."""
    late, every = round(late_s / STEP_S), round(PERIOD_S / STEP_S)
    moved = np.abs(np.diff(true_log_ohm, prepend=true_log_ohm[0]))
    chance = np.random.default_rng(0)
    readings = [off + chance.normal(0.0, READ_DEC, off.size) for _ in range(NOISES)]
    of_walks = (np.mean([_left(r, off, used, moved, walk, late, every) for r in readings], axis=0) for walk in WALKS)
    rms, largest = min(map(tuple, of_walks))
    return float(rms), float(largest)


def _left(
    reading: np.ndarray, off: np.ndarray, used: np.ndarray, moved: np.ndarray, walk: float, late: int, every: int
) -> Errors:
    known, doubt, estimate = reading[0], READ_DEC**2, np.empty(off.size)
    for k in range(off.size):
        doubt += walk * moved[k] / LENGTH_DEC
        if k % every == 0:
            share = doubt / (doubt + READ_DEC**2)
            known += share * (reading[k] - known)
            doubt *= 1.0 - share
        estimate[k] = known
    left = (off[late:] - estimate[: off.size - late])[used[late:]]
    return float(np.sqrt(np.mean(left**2))) / NOISE_DEC, float(np.max(np.abs(left))) / NOISE_DEC


def model_error(film: FilmModel, plant: Plant) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times in s, true log10 R, the same less the model's) over the plant's course, which begins as `placed` says."""
    time, degC, log_ohm = np.array(plant.course).T
    _, memory = film.step(float(degC[0]), film.initial_memory(HOT_DEGC, "heated"))
    off = log_ohm + film.simulate(degC, memory)[0]
    grid = np.arange(float(time[0]), float(time[-1]), STEP_S)
    return grid, np.interp(grid, time, log_ohm), np.interp(grid, time, off)


def measured(case: tuple[str, int]) -> dict[float, tuple[Errors, Errors]]:
    """(Of the law, of the best predictor) by the delay (s), on one film."""
    kind, seed = case
    with tempfile.TemporaryDirectory(prefix="late-") as folder:
        model = calibrated(Path(folder), FILMS[kind](seed), seed)
        content = read_configuration(Path(folder) / "config.toml").content
    assert model.film is not None
    times, values = course(FILMS[kind](seed), seed)
    found = {}
    for delay_s in (0.0, DELAY_S):
        hidden = {"actuator_delay": {"delay_s": delay_s}}
        effects = [switched(DELAY, hidden["actuator_delay"])] if delay_s else []
        observer = chain_observer(effects, model.plate, model.film, PERIOD_S)
        law, _ = law_and_design("full", content, model.film, model.plate, observer)
        plant = Plant(NOMINAL, FILMS[kind](seed), seed, 0.0, hidden)
        state = placed(plant, law, model.film, values[0])
        driven(plant, law, state, lambda t: np.interp(t - SETTLE_S, times, values), SETTLE_S + times[-1])
        grid, true_log_ohm, off = model_error(model.film, plant)
        used = (grid >= SETTLE_S) & (grid <= SETTLE_S + times[-1])
        least = predicted(true_log_ohm, off, used, delay_s + 0.5 * PERIOD_S + sum(AGES_S))
        found[delay_s] = error(plant, SETTLE_S, times, values), least
    return found


def told(errors: Errors) -> str:
    """Both, as text."""
    return f"{errors[0]:.2f} ({errors[1]:.1f})"


def main() -> int:
    asked = options(__doc__, seeds=2, first=10, film="outside")
    print("RMS (largest) error in n = 0.002 decades: the law, and the least that so late a correction leaves")
    cases = [(asked.film, seed) for seed in range(asked.first, asked.first + asked.seeds)]
    ratios = []
    for (kind, seed), found in zip(cases, side_by_side(measured, cases, asked.workers), strict=True):
        (law, least), (late_law, late_least) = found[0.0], found[DELAY_S]
        ratios.append((late_law[0] / law[0], late_least[0] / law[0]))
        print(f"{kind} {seed}: no delay {told(law)}, least {told(least)}; ", end="")
        print(f"{DELAY_S:g} s, known exactly {told(late_law)}, least {told(late_least)}", flush=True)
    law_ratio, least_ratio = np.median(np.array(ratios), axis=0)
    print(f"with over without the delay: the law {law_ratio:.2f}; with the least in its place {least_ratio:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
