"""Do the intervals of an identified plate hold the truth? Plates with and without slopes, rounding, a draught.

    ./peltier benchmark plate_intervals [--plates 40] [--workers N]

Each plate has parameters of its own, and a profile of random levels with sines of 25 minutes at 0.5 s; it is integrated
here row by row, apart from the chain that the fit simulates. Counted are the parameters inside their 95 %
intervals, and of the two slopes alone. Asked: 95 % within the binomial interval.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.special import betaincinv

from benchmarks._harness import options, side_by_side

KINDS = ("no slopes", "white", "rounded", "wandering")
STEP_S = 0.5
ROWS = 3000


def record(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, float]]:
    """Time, temperature, current, and the true parameters."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    s, r, g, room = rng.uniform((1e-3, 0.03, 0.008, 18.0), (3e-3, 0.1, 0.03, 28.0))
    of_s, of_r = (0.0, 0.0) if kind == "no slopes" else rng.uniform((0.0005, 0.002), (0.0025, 0.006))
    clock = STEP_S * np.arange(ROWS)
    level = np.repeat(rng.uniform(-1.5, 2.0, 15), ROWS // 15)
    current = level + rng.uniform(0.1, 0.5) * np.sin(clock / rng.uniform(10.0, 60.0))
    wander = np.zeros(ROWS)
    if kind == "wandering":  # a draught: the room's temperature follows white noise with a lag of 60 s
        for k in range(1, ROWS):
            fresh = 0.5 * np.sqrt(1 - np.exp(-STEP_S / 30.0)) * rng.normal()
            wander[k] = wander[k - 1] * np.exp(-STEP_S / 60.0) + fresh

    def rate(T: float, i: float, outside: float) -> float:
        joule = 0.5 * r * (1.0 + of_r * (T - 25.0)) * i * i
        return s * (1.0 + of_s * (T - 25.0)) * i * (T + 273.15) + joule - g * (T - outside)

    degC = np.empty(ROWS)
    degC[0] = room
    for k in range(ROWS - 1):  # Runge and Kutta's method over a row, in which current and draught stand still
        i, outside, T = current[k], room + wander[k], degC[k]
        a = rate(T, i, outside)
        b = rate(T + 0.5 * STEP_S * a, i, outside)
        c = rate(T + 0.5 * STEP_S * b, i, outside)
        d = rate(T + STEP_S * c, i, outside)
        degC[k + 1] = T + STEP_S * (a + 2.0 * b + 2.0 * c + d) / 6.0
    shown = degC + 0.01 * rng.normal(size=ROWS)
    if kind == "rounded":
        shown = 0.05 * np.round(shown / 0.05)
    names = (
        "seebeck_over_capacity_per_A_s",
        "resistance_over_capacity_K_per_A2_s",
        "conductance_over_capacity_per_s",
        "ambient_degC",
        "seebeck_slope_per_K",
        "resistance_slope_per_K",
    )
    return clock, shown, current, dict(zip(names, (s, r, g, room, of_s, of_r), strict=True))


def one(job: tuple[str, int]) -> tuple[list[float], list[float], float]:
    """Of one record: how far each parameter, and each slope, is off in its standard errors, and the time taken."""
    from sim.inference.plate.fit import identify_plate

    clock, shown, current, truth = record(*job)
    began = time.perf_counter()
    fit = identify_plate(clock, shown, current)
    took = time.perf_counter() - began
    off = {
        name: (value - truth[name]) / error
        for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True)
        if name in truth
    }
    return [*off.values()], [z for name, z in off.items() if "slope" in name], took


def main() -> None:
    asked = options(__doc__, plates=40)
    print(f"{'kind':<12}{'inside':>14}{'binomial 95 %':>18}{'rms of error/deviation':>26}{'slopes':>14}", end="")
    print(f"{'s a plate':>12}")
    for kind in KINDS:
        done = list(side_by_side(one, [(kind, seed) for seed in range(asked.plates)], asked.workers))
        off = np.array([z for each, _, _ in done for z in each])
        slopes = np.array([z for _, each, _ in done for z in each])
        n, k = off.size, int(np.sum(np.abs(off) < 1.96))
        low, high = betaincinv(k, n - k + 1, 0.025), betaincinv(k + 1, max(n - k, 1e-9), 0.975)
        took = float(np.median([t for _, _, t in done]))
        spread = f"{100 * low:.1f} to {100 * high:.1f}"
        rms = np.sqrt(np.mean(off**2))
        two = f"{np.sum(np.abs(slopes) < 1.96)} of {slopes.size}"
        print(f"{kind:<12}{f'{k} of {n}':>14}{spread:>18}{rms:>26.2f}{two:>14}{took:>12.2f}", flush=True)


if __name__ == "__main__":
    main()
