"""Are the error bars right? 200 simulated records with radii off the grid, each fitted and judged.

    ./peltier benchmark error_bars [--records 200]

Each record is of a film of the model's own class (8 to 13 operators, radii on nobody's grid), 5,000 rows of a decaying
oscillation, noise 0.002 dec; a fit's radii are dense at first and joined where they carry weight. Counted are the
parameters that the fit declares identified (a finite standard error), and the film's true log R on a new random
profile, inside their 95 % intervals. Asked: 92 to 98 %.
"""

from __future__ import annotations

import os
import sys

import numpy as np

from benchmarks._harness import options, side_by_side

NOISE_DEC = 0.002
ROWS = 5000


def one(seed: int) -> tuple[dict[str, tuple[bool, float]], float, float]:
    """One record: per identified parameter (inside, half-width), share of rows inside their band, RMSE / noise."""
    from sim.inference.film.fit import identify_film
    from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, random_profile

    film = is_prandtl_ishlinskii(seed)
    random = np.random.default_rng(10_000 + seed)
    v = decaying_profile(ROWS)
    output = film.simulate(v, film.initial_memory(float(v[0])))[0] + NOISE_DEC * random.standard_normal(ROWS)
    time = np.arange(ROWS) * 0.5
    fit = identify_film(time, v, output, kind="extended_generalized_pi", form="tanh")
    truth = true_parameters(film)
    inside = {}
    for name, value, error in zip(fit.outer_names, fit.outer_values, fit.outer_standard_errors, strict=True):
        if np.isfinite(error):
            inside[name] = (abs(value - truth[name]) <= 1.96 * error, 1.96 * float(error))
    new = random_profile(ROWS, seed)
    expected, _ = film.simulate(new, film.initial_memory(float(new[0])))
    predicted = fit.predict(time, new, temperature_noise_K=0.0)
    hits = np.abs(predicted.output - expected) <= predicted.half_width
    rmse = float(np.sqrt(np.mean((predicted.output - expected) ** 2 + NOISE_DEC**2))) / NOISE_DEC
    return inside, float(np.mean(hits)), rmse


def true_parameters(film: object) -> dict[str, float]:
    """The true film's parameters under the names of the fit."""
    rising, falling, d = film.rising, film.falling, film.memoryless  # type: ignore[attr-defined]
    return {
        "log_rising_slope": float(np.log(rising.a)),
        "rising_centre_degC": -rising.b / rising.a,
        "log_falling_slope": float(np.log(falling.a)),
        "falling_centre_degC": -falling.b / falling.a,
        "log_memoryless_slope": float(np.log(d.a)),
        "memoryless_centre_degC": -d.b / d.a,
    }


def main() -> int:
    asked = options(__doc__, records=200)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    results = list(side_by_side(one, range(asked.records), asked.workers))
    names = sorted({name for inside, _, _ in results for name in inside})
    print(f"{'':<34}{'inside 95 %':>14}{'identified in':>16}{'median half-width':>20}{'asked':>12}")
    total, count = 0, 0
    for name in names:
        hits = [inside[name] for inside, _, _ in results if name in inside]
        good = sum(hit for hit, _ in hits)
        total, count = total + good, count + len(hits)
        width = float(np.median([width for _, width in hits]))
        print(f"{name:<34}{100 * good / len(hits):>12.1f} %{len(hits):>13} of {len(results)}{width:>16.3g}")
    if count:
        print(f"{'all parameters':<34}{100 * total / count:>12.1f} %{'':>36}{'92 to 98 %':>12}")
    shares = np.array([share for _, share, _ in results])
    print(f"{'log R on a new profile, all rows':<34}{100 * shares.mean():>12.1f} %{'':>36}{'92 to 98 %':>12}")
    ratios = np.array([ratio for _, _, ratio in results])
    print(f"{'held-out RMSE / noise':<34}{ratios.mean():>12.4f}   (largest {ratios.max():.4f}){'':>19}{1.02:>12}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
