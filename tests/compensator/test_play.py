"""The laws that play operators keep exactly (paper eqs (1)-(6)), on random inputs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compensator.hysteresis.film import IDENTITY, Envelope, FilmModel, Memory
from tests.compensator.film_models import any_model, damped_path

SEEDS = st.integers(0, 2**32 - 1)
EXACT = 1e-12


def play(radius: float, inputs: np.ndarray) -> np.ndarray:
    """Output of one classical play operator, from rest at 0."""
    model = FilmModel(np.array([radius]), np.ones(1), IDENTITY, IDENTITY, kind="classical_pi")
    return model.play_outputs(inputs, Memory(0.0, np.zeros(1)))[:, 0]


@settings(deadline=None)
@given(SEEDS, st.floats(0.0, 5.0), st.floats(0.0, 5.0))
def test_plays_in_series_add_their_radii(seed: int, r: float, s: float) -> None:
    inputs = np.random.default_rng(seed).uniform(-20.0, 20.0, 60)
    np.testing.assert_allclose(play(r, play(s, inputs)), play(r + s, inputs), rtol=0.0, atol=EXACT)


@settings(deadline=None)
@given(SEEDS)
def test_refining_a_monotone_move_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = any_model(rng)
    turns = damped_path(rng, 20)
    memory = model.initial_memory(float(turns[0]))
    coarse, _ = model.simulate(turns, memory)
    fine = [turns[:1]]
    for a, b in pairwise(turns):
        fine.append(np.append(np.sort(rng.uniform(min(a, b), max(a, b), 5))[:: 1 if b > a else -1], b))
    outputs, _ = model.simulate(np.concatenate(fine), memory)
    ends = np.cumsum([len(piece) for piece in fine]) - 1
    np.testing.assert_allclose(outputs[ends], coarse, rtol=EXACT, atol=EXACT)


@settings(deadline=None)
@given(SEEDS)
def test_a_larger_turn_wipes_out_the_smaller_ones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ordered_model(rng)
    low, high = np.sort(rng.uniform(20.0, 90.0, 2))
    inner = rng.uniform(low, high, 30)
    start = model.initial_memory(5.0, "heated")
    with_loops, memory_a = model.simulate(np.concatenate([[low, high, low], inner, [high, low]]), start)
    without, memory_b = model.simulate(np.array([low, high, low]), start)
    assert abs(with_loops[-1] - without[-1]) <= EXACT
    np.testing.assert_allclose(memory_a.plays, memory_b.plays, rtol=0.0, atol=EXACT)


@settings(deadline=None)
@given(SEEDS)
def test_congruency_for_equal_envelopes(seed: int) -> None:
    """Loops between the same two temperatures have the same shape whatever went before, where envelopes are equal."""
    rng = np.random.default_rng(seed)
    envelope = Envelope("tanh", 0.2, -13.0)
    count = int(rng.integers(1, 20))
    model = FilmModel(rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 1.0, count), envelope, envelope)
    low, high = np.sort(rng.uniform(40.0, 90.0, 2))
    loop = np.concatenate([np.linspace(low, high, 15), np.linspace(high, low, 15)])
    shapes = []
    for _ in range(2):
        before = np.concatenate([rng.uniform(30.0, 100.0, 10), [low, high, low]])
        _, memory = model.simulate(before, model.initial_memory(20.0, "heated"))
        outputs, _ = model.simulate(loop, memory)
        shapes.append(outputs - outputs[0])
    np.testing.assert_allclose(shapes[0], shapes[1], rtol=0.0, atol=EXACT)


@settings(deadline=None)
@given(SEEDS)
def test_at_rest_nothing_moves_and_order_is_kept(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ordered_model(rng)
    inputs = damped_path(rng, 40)
    outputs, memory = model.simulate(inputs, model.initial_memory(float(inputs[0])))
    again, rest = model.step(memory.input_degC, memory)
    assert again == outputs[-1]
    assert np.array_equal(rest.plays, memory.plays)
    higher, _ = model.simulate(inputs + 1.0, model.initial_memory(float(inputs[0]) + 1.0))
    assert np.all(higher - outputs >= -EXACT)


def ordered_model(rng: np.random.Generator) -> FilmModel:
    """A model that keeps the order condition: equal envelopes."""
    a = float(rng.uniform(0.05, 0.5))
    envelope = Envelope("tanh", a, -65.0 * a)
    count = int(rng.integers(1, 31))
    return FilmModel(rng.uniform(0.0, 1.0, count), rng.uniform(0.0, 0.3, count), envelope, envelope)


@pytest.mark.parametrize("radius", [0.0, 1.5])
def test_classical_play_by_hand(radius: float) -> None:
    outputs = play(radius, np.array([0.0, 4.0, 2.0, -3.0, -3.0, 5.0]))
    if radius == 0.0:
        np.testing.assert_array_equal(outputs, [0.0, 4.0, 2.0, -3.0, -3.0, 5.0])
    else:
        np.testing.assert_array_equal(outputs, [0.0, 2.5, 2.5, -1.5, -1.5, 3.5])


@pytest.mark.parametrize("seed", range(6))
def test_a_nan_among_the_inputs_loses_no_step(seed: int) -> None:
    """Of films with common and with mixed envelopes."""
    model = any_model(np.random.default_rng(seed))
    inputs = np.array([40.0, 60.0, 70.0, 60.0, 50.0])
    gap = np.insert(inputs, [2, 5], np.nan)
    memory = model.initial_memory(40.0, "heated")
    plain, after = model.simulate(inputs, memory)
    outputs, end = model.simulate(gap, memory)
    known = np.isfinite(gap)
    np.testing.assert_array_equal(outputs[known], plain)
    assert np.all(np.isnan(outputs[~known]))
    assert end.input_degC == after.input_degC
    np.testing.assert_array_equal(end.plays, after.plays)
    np.testing.assert_array_equal(model.play_outputs(gap, memory)[known], model.play_outputs(inputs, memory))
