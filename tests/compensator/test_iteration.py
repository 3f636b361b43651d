"""The paper's own inverse: where it works, and where the paper is wrong about it (each checked numerically)."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memory, Memoryless
from compensator.inverse.inverse import Inverse
from compensator.inverse.iteration import applicable, iterate
from tests.compensator.film_models import damped_path, table_1, table_2


def classical(amplitude: float) -> FilmModel:
    """Section 5.1: p(r0) = 6, D = 5 cos v; radii and the other weights are a choice, table 3 is not in the text."""
    radii, weights = 0.5 * np.arange(6), np.array([6.0, 1.2, 1.0, 0.8, 0.6, 0.4])
    return FilmModel(radii, weights, IDENTITY, IDENTITY, Memoryless("cos", amplitude), "classical_pi")


def one_operator(slope: float) -> FilmModel:
    """p(r0) = 6 alone, D = slope v."""
    d = Memoryless("linear", slope)
    return FilmModel(np.zeros(1), np.array([6.0]), IDENTITY, IDENTITY, d, "classical_pi")


def test_it_agrees_with_the_inverse_where_envelopes_are_equal_and_it_contracts() -> None:
    model = classical(5.0)
    inverse, memory = Inverse(model, -100.0, 100.0), Memory(0.0, np.zeros(6))
    for v in damped_path(np.random.default_rng(0), 200, -10.0, 10.0):
        target = model.step(float(v), memory)[0]
        result = iterate(model, target, memory, 1e-10)
        assert result.converged
        assert result.temperature_degC == pytest.approx(inverse.solve(target, memory).temperature_degC, abs=1e-8)
        memory = model.step(float(v), memory)[1]


def test_the_printed_condition_needs_the_absolute_value_of_the_slope() -> None:
    """Eqs (21), (26), (27) hold as printed for D = -8 v, p(r0) = 6, and the iteration diverges."""
    model = one_operator(-8.0)
    memory = Memory(0.0, np.zeros(1))
    result = iterate(model, 1.0, memory, most_iterations=200)
    assert not result.converged
    assert abs(result.temperature_degC) > 1e6


def test_eq_12_is_not_eq_6_where_envelopes_differ() -> None:
    """Table 1's generalized model: Pi of gamma_R rising, of gamma_L falling, is off by a quarter of the range.

    At a reversal gamma jumps from one envelope to the other and moves Pi's plays; in eq (6) nothing jumps. The
    inverse (14) with the memory of eq (6), as `iterate` has it, is right nevertheless.
    """
    model = table_1(generalized=True)
    rising, falling = model.rising, model.falling
    assert isinstance(rising, Envelope)
    assert isinstance(falling, Envelope)
    path, memory = damped_path(np.random.default_rng(0), 600, 20.0, 80.0), model.initial_memory(20.0, "heated")
    outputs, _ = model.simulate(path, memory)
    up = np.diff(path, prepend=20.0) > 0.0
    gamma = np.where(up, np.tanh(rising.a * path + rising.b), np.tanh(falling.a * path + falling.b))
    pi = FilmModel(model.radii, model.weights, IDENTITY, IDENTITY, model.memoryless, "classical_pi")
    by_eq_12, _ = pi.simulate(gamma, Memory(float(np.tanh(rising.a * 20.0 + rising.b)), memory.plays))
    assert np.abs(by_eq_12 - outputs).max() > 0.25 * np.ptp(outputs)
    inverse = Inverse(model, 20.0, 80.0)
    for v in path[:100]:
        target = model.step(float(v), memory)[0]
        solution, result = inverse.solve(target, memory), iterate(model, target, memory, 1e-9)
        if solution.temperature_degC != memory.input_degC:
            assert abs(model.step(result.temperature_degC, memory)[0] - target) < 1e-6
        memory = model.step(float(v), memory)[1]


def test_it_never_converges_where_all_operators_stand_still() -> None:
    """Proposition 2 is not sufficient: gamma_R < gamma_L gives even r = 0 a dead band, however small D is."""
    count = 15
    model = FilmModel(
        np.arange(count) / count,
        np.full(count, 0.1),
        Envelope("tanh", 0.15, -9.6),
        Envelope("tanh", 0.15, -9.0),
        Memoryless("tanh", 0.01, 0.03, -1.9),
    )
    memory = model.simulate(np.array([90.0, 62.0]), model.initial_memory(20.0, "heated"))[1]
    target = model.step(63.0, memory)[0]
    solution = Inverse(model).solve(target, memory)
    assert solution.reachable
    assert solution.temperature_degC == pytest.approx(63.0, abs=1e-6)
    result = iterate(model, target, memory, 1e-6)
    assert not result.converged or abs(result.temperature_degC - 63.0) > 0.1


def test_the_stop_rule_does_not_bound_the_error_by_sigma() -> None:
    """The bound is sigma q / (1 - q): five times sigma for q = 5/6; D = -5 v shows nearly all of it."""
    model = one_operator(-5.0)
    sigma, memory, worst = 1e-3, Memory(0.0, np.zeros(1)), 0.0
    inverse = Inverse(model, -100.0, 100.0)
    for target in np.linspace(0.5, 8.0, 40):
        result = iterate(model, float(target), memory, sigma)
        if result.converged:
            error = abs(result.temperature_degC - inverse.solve(float(target), memory).temperature_degC)
            worst = max(worst, error)
    assert 4.0 * sigma < worst <= 5.0 * sigma * (1.0 + 1e-9)


def test_it_is_refused_where_p_r0_is_undefined() -> None:
    """Section 4.2's radii start at 1/30."""
    model = table_2(generalized=False)
    assert not applicable(model)
    with pytest.raises(ValueError, match=r"p\(r_0\)"):
        iterate(model, -3.0, model.initial_memory(60.0))
