"""Do the intervals of an identified plate hold the truth? Plates with white noise, rounding, a room that wanders.

    ./peltier benchmark plate_intervals [--plates 40]

Each plate has parameters of its own, and a profile of random levels with sines of 25 minutes at 0.5 s; it is integrated
here row by row, apart from the chain that the fit simulates. Counted are the parameters inside their 95 %
intervals. Asked: 95 % within the binomial interval.
"""

from __future__ import annotations

import argparse
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from scipy.special import betaincinv

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

KINDS = ("white", "rounded", "wandering")
STEP_S = 0.5
ROWS = 3000


def record(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]:
    """Time, temperature, current, and the true parameters."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    s, r, g, room = rng.uniform((1e-3, 0.03, 0.008, 18.0), (3e-3, 0.1, 0.03, 28.0))
    clock = STEP_S * np.arange(ROWS)
    level = np.repeat(rng.uniform(-1.5, 2.0, 15), ROWS // 15)
    current = level + rng.uniform(0.1, 0.5) * np.sin(clock / rng.uniform(10.0, 60.0))
    wander = np.zeros(ROWS)
    if kind == "wandering":  # a draught: the room's temperature follows white noise with a lag of 60 s
        for k in range(1, ROWS):
            wander[k] = wander[k - 1] * np.exp(-STEP_S / 60.0) + rng.normal() * 0.5 * np.sqrt(1 - np.exp(-STEP_S / 30.0))

    degC = np.empty(ROWS)
    degC[0] = room
    for k in range(ROWS - 1):  # current and draught stand still for a row: the balance is linear
        i = current[k]
        decay, heat = g - s * i, s * 273.15 * i + 0.5 * r * i * i + g * (room + wander[k])
        degC[k + 1] = heat / decay + (degC[k] - heat / decay) * np.exp(-decay * STEP_S)
    shown = degC + 0.01 * rng.normal(size=ROWS)
    if kind == "rounded":
        shown = 0.05 * np.round(shown / 0.05)
    names = (
        "seebeck_over_capacity_per_A_s",
        "resistance_over_capacity_K_per_A2_s",
        "conductance_over_capacity_per_s",
        "ambient_degC",
    )
    return clock, shown, current, dict(zip(names, (s, r, g, room), strict=True))


def one(job: tuple[str, int]) -> tuple[list[bool], list[float], float]:
    """Of one record: which parameters are inside, how far each is off in its standard errors, and the time taken."""
    from sim.inference.plate import identify_plate

    clock, shown, current, truth = record(*job)
    began = time.perf_counter()
    fit = identify_plate(clock, shown, current)
    took = time.perf_counter() - began
    off = [
        (value - truth[name]) / error
        for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True)
        if name in truth
    ]
    return [abs(z) < 1.96 for z in off], off, took


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--plates", type=int, default=40)
    plates = parser.parse_args().plates
    print(f"{'kind':<12}{'inside':>14}{'binomial 95 %':>18}{'rms of error/deviation':>26}{'s a plate':>12}")
    with ProcessPoolExecutor() as pool:
        for kind in KINDS:
            done = list(pool.map(one, [(kind, seed) for seed in range(plates)]))
            inside = [value for ones, _, _ in done for value in ones]
            n, k = len(inside), int(np.sum(inside))
            low, high = betaincinv(k, n - k + 1, 0.025), betaincinv(k + 1, max(n - k, 1e-9), 0.975)
            off = np.array([z for _, ones, _ in done for z in ones])
            took = float(np.median([t for _, _, t in done]))
            spread = f"{100 * low:.1f} to {100 * high:.1f}"
            print(f"{kind:<12}{f'{k} of {n}':>14}{spread:>18}{np.sqrt(np.mean(off**2)):>26.2f}{took:>12.2f}", flush=True)


if __name__ == "__main__":
    main()
