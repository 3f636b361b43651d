"""What the inverse costs and misses: failures and evaluations of round trips from turning points everywhere.

    ./peltier benchmark inverse [--models 10000] [--json FILE]

One evaluation is D and the envelopes at one trial temperature, the present one included. Monotone models, asked 20
evaluations at most, and models of the whole family. The paper's fixed point beside it: `benchmark paper`.
"""

from __future__ import annotations

import sys

import numpy as np

from benchmarks._harness import kept, options
from compensator.inverse.inverse import Inverse
from tests.compensator.film_models import any_model, damped_path, monotone_model


def main() -> int:
    asked, figures = options(__doc__, models=10_000), {}
    for name, make, limit in (("monotone", monotone_model, "asked <= 20"), ("family", any_model, "in the tens")):
        rng, counts, failures = np.random.default_rng(7), [], 0
        for _ in range(asked.models):
            model = make(rng)
            inverse, path = Inverse(model), damped_path(rng, 8)
            memory = model.initial_memory(float(path[0]))
            for v in path[1:]:
                target, after = model.step(float(v), memory)
                solution = inverse.solve(target, memory)
                achieved = model.step(solution.temperature_degC, memory)[0]
                failures += not solution.reachable or abs(achieved - target) > inverse.bound
                counts.append(solution.evaluations)
                memory = after
        print(f"{name}, {len(counts)} targets: failures {failures}    asked 0")
        print(f"{name}, evaluations: mean {np.mean(counts):.2f}, largest {max(counts)}    {limit}")
        figures[name] = {"mean": float(np.mean(counts)), "most": max(counts), "failures": failures}
    kept(asked.json, figures)
    return int(any(each["failures"] for each in figures.values()))


if __name__ == "__main__":
    sys.exit(main())
