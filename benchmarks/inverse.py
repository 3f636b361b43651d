"""What the inverse costs and keeps: evaluations, error, speed, beside the paper's fixed point, eq (20).

    python benchmarks/inverse.py [--models 10000] [--json FILE]

One evaluation is D and the envelopes at one trial temperature, the present one included. The paper-like case is
section 5.1's: a classical PI model with p(r0) = 6 and D = 5 cos v. Table 3, with its radii and weights, is not in
the text: radii 0 .. 2.5 and the other weights 1.2 .. 0.4 are a choice, and so is the input, random turning points
in +-10 walked in steps of 0.1. The paper reports 8.38 mean iterations at sigma = 1e-4 and 5.31 at 1e-2.
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks._harness import kept, options
from benchmarks.forward import film, smooth_path
from compensator.hysteresis.film import IDENTITY, FilmModel, Memory, Memoryless
from compensator.inverse.inverse import Inverse
from compensator.inverse.iteration import iterate
from tests.compensator.film_models import any_model, damped_path, monotone_model

ROUNDS = 7


def paper_like() -> dict[str, float]:
    """Evaluations at 1e-9 and iterations at the paper's sigmas, on the same targets from the same memories."""
    radii, weights = 0.5 * np.arange(6), np.array([6.0, 1.2, 1.0, 0.8, 0.6, 0.4])
    model = FilmModel(radii, weights, IDENTITY, IDENTITY, Memoryless("cos", 5.0), "classical_pi")
    turns = np.random.default_rng(1).uniform(-10.0, 10.0, 200)
    path = np.concatenate([np.arange(a, b, 0.1 if b > a else -0.1) for a, b in pairwise(turns)])
    inverse, memory = Inverse(model, -100.0, 100.0, tolerance=1e-9), Memory(0.0, np.zeros(6))
    outputs, _ = model.simulate(path, memory)
    counts, iterations, errors = [], [], []
    for target in outputs:
        solution = inverse.solve(float(target), memory)
        counts.append(solution.evaluations)
        errors.append(abs(solution.residual) if solution.reachable else np.inf)
        iterations.append([iterate(model, float(target), memory, sigma).iterations for sigma in (1e-4, 1e-2)])
        memory = solution.memory
    fine, coarse = np.mean(iterations, axis=0)
    return {
        "paper_like_mean": float(np.mean(counts)),
        "paper_like_most": float(max(counts)),
        "paper_like_error": float(max(errors)),
        "fixed_point_1e-4": float(fine),
        "fixed_point_1e-2": float(coarse),
    }


def random_models(count: int) -> dict[str, float]:
    """Round trips from turning points everywhere: monotone models, and models of the whole family."""
    figures: dict[str, float] = {}
    for name, make in (("monotone", monotone_model), ("family", any_model)):
        rng, counts, failures = np.random.default_rng(7), [], 0
        for _ in range(count):
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
        figures |= {f"{name}_mean": float(np.mean(counts)), f"{name}_most": float(max(counts))}
        figures |= {f"{name}_targets": float(len(counts)), f"{name}_failures": float(failures)}
    return figures


def speed() -> dict[str, float]:
    """Inverse and model on the same smooth path, in turn."""
    model, path = film(), smooth_path(200_000)
    memory = model.initial_memory(float(path[0]))
    targets, _ = model.simulate(path, memory)
    inverse, forward_s, inverse_s = Inverse(model), np.inf, np.inf
    inverse.trajectory(targets[:10], memory)
    for _ in range(ROUNDS):
        start = time.perf_counter()
        model.simulate(path, memory)
        middle = time.perf_counter()
        temperatures, _ = inverse.trajectory(targets, memory)
        forward_s, inverse_s = min(forward_s, middle - start), min(inverse_s, time.perf_counter() - middle)
    error = float(np.abs(model.simulate(temperatures, memory)[0] - targets).max())
    return {"inverse_ns": inverse_s / path.size * 1e9, "inverse_of_forward": forward_s / inverse_s, "error": error}


def main() -> int:
    asked = options(__doc__, models=10_000)
    f = paper_like() | speed() | random_models(asked.models)
    print(f"paper-like, evaluations: mean         {f['paper_like_mean']:10.2f}    asked <= 4")
    print(f"paper-like, evaluations: largest      {f['paper_like_most']:10.0f}    asked <= 15")
    print(f"paper-like, largest error             {f['paper_like_error']:10.1e}    asked <= 1e-9")
    print(f"fixed point (20), sigma 1e-4: mean    {f['fixed_point_1e-4']:10.2f}    the paper's input: 8.38")
    print(f"fixed point (20), sigma 1e-2: mean    {f['fixed_point_1e-2']:10.2f}    the paper's input: 5.31")
    print(f"smooth target, {f['inverse_ns']:4.0f} ns: speed of model {f['inverse_of_forward']:9.3f}    asked >= 0.1")
    for name, limit in (("monotone", "asked <= 20"), ("family", "in the tens")):
        print(f"{name}, {f[name + '_targets']:.0f} targets: failures {f[name + '_failures']:.0f}    asked 0")
        print(f"{name}, evaluations: mean {f[name + '_mean']:.2f}, largest {f[name + '_most']:.0f}    {limit}")
    kept(asked.json, f)
    return 0


if __name__ == "__main__":
    sys.exit(main())
