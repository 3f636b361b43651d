"""model(inverse(u)) = u wherever it is declared reachable, and nothing reachable is declared unreachable."""

from __future__ import annotations

import numpy as np
import pytest
from tests.compensator.film_models import any_model, damped_path, monotone_model

from compensator.inverse import Inverse


@pytest.mark.parametrize("block", range(4))
def test_monotone_models_come_back(block: int) -> None:
    rng = np.random.default_rng(block)
    most = 0
    for _ in range(250):
        model = monotone_model(rng)
        inverse = Inverse(model)
        inputs = damped_path(rng, 12)
        outputs, _ = model.simulate(inputs, model.initial_memory(float(inputs[0])))
        memory = inverse.first(float(outputs[0])).memory
        for target in outputs[1:]:
            solution = inverse.solve(float(target), memory)
            assert solution.reachable
            achieved, memory = model.step(solution.temperature_degC, memory)
            assert abs(achieved - target) <= 1e-9
            most = max(most, solution.evaluations)
    assert most <= 20


@pytest.mark.parametrize("block", range(4))
def test_any_model_comes_back(block: int) -> None:
    rng = np.random.default_rng(1000 + block)
    for _ in range(250):
        model = any_model(rng)
        inverse = Inverse(model)
        inputs = damped_path(rng, 6)
        memory = model.initial_memory(float(inputs[0]))
        for v in inputs[1:]:
            target = model.step(float(v), memory)[0]
            solution = inverse.solve(target, memory)
            assert solution.reachable
            achieved, memory = model.step(solution.temperature_degC, memory)
            assert abs(achieved - target) <= 1e-9 * max(1.0, float(np.abs(target)))
