"""Compression: nothing is lost where nothing is needed, the loss that is told is the loss, order is kept."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from sim.inference.film.compression import compress, probe

RADII = np.linspace(0.02, 0.95, 30)
RISING, FALLING = Envelope("tanh", 0.2, -12.6), Envelope("tanh", 0.2, -11.8)


def film(weights: np.ndarray) -> FilmModel:
    return FilmModel(RADII, weights, RISING, FALLING, Memoryless("tanh", 0.4, 0.03, -1.6, -4.0))


def test_idle_operators_cost_nothing() -> None:
    weights = np.zeros(30)
    weights[[3, 11, 25]] = [0.5, 0.3, 0.2]
    result = compress(film(weights), 3, 30.0, 90.0)
    assert result.model.operators == 3
    assert result.largest < 1e-9
    np.testing.assert_allclose(result.model.weights, [0.5, 0.3, 0.2], atol=1e-9)


def test_the_loss_that_is_told_is_the_loss() -> None:
    model = film(np.random.default_rng(1).exponential(0.06, 30))
    result = compress(model, 5, 30.0, 90.0)
    inputs = probe(30.0, 90.0)
    whole, _ = model.simulate(inputs, model.initial_memory(30.0))
    fewer, _ = result.model.simulate(inputs, result.model.initial_memory(30.0))
    assert np.sqrt(np.mean((fewer - whole) ** 2)) == pytest.approx(result.rms, rel=1e-6)
    assert np.max(np.abs(fewer - whole)) == pytest.approx(result.largest, rel=1e-6)
    other = probe(30.0, 90.0, seed=7)
    error = (
        result.model.simulate(other, result.model.initial_memory(30.0))[0]
        - model.simulate(other, model.initial_memory(30.0))[0]
    )
    assert np.sqrt(np.mean(error**2)) < 1.3 * result.rms


def test_more_operators_lose_less_and_keep_the_order_condition() -> None:
    model = film(np.random.default_rng(2).exponential(0.06, 30))
    course = compress(model, 1, 30.0, 90.0).course
    assert [count for count, _ in course] == list(range(30, 0, -1))
    losses = [loss for _, loss in course]
    assert all(a <= b + 1e-12 for a, b in pairwise(losses))
    smaller = compress(model, 4, 30.0, 90.0).model
    assert np.all(smaller.order_margin() >= np.min(model.order_margin()))
    with pytest.raises(ValueError, match="at least 1"):
        compress(model, 0, 30.0, 90.0)
