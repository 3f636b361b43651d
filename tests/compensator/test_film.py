"""The film model: against a plain second implementation, in pieces and at once, and refusals at the edge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compensator.hysteresis.film import Envelope, FilmModel, Memory, Memoryless
from compensator.hysteresis.functions import envelope, envelope_inverse, envelope_steepest, envelope_value
from tests.compensator.film_models import any_model, damped_path, plain_outputs, table_2

SEEDS = st.integers(0, 2**32 - 1)


@settings(deadline=None)
@given(SEEDS)
def test_agrees_with_the_plain_model(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = any_model(rng)
    inputs = damped_path(rng, 60)
    memory = model.initial_memory(float(rng.uniform(10.0, 95.0)))
    outputs, _ = model.simulate(inputs, memory)
    scale = 1.0 + float(np.abs(outputs).max())
    np.testing.assert_allclose(outputs, plain_outputs(model, inputs, memory), rtol=0.0, atol=1e-12 * scale)


@settings(deadline=None)
@given(SEEDS, st.integers(0, 60))
def test_streaming_and_batch_give_the_same_bits(seed: int, cut: int) -> None:
    rng = np.random.default_rng(seed)
    model = any_model(rng)
    inputs = damped_path(rng, 60)
    start = model.initial_memory(float(inputs[0]))
    outputs, end = model.simulate(inputs, start)
    one_by_one, memory = [], start
    for v in inputs:
        u, memory = model.step(float(v), memory)
        one_by_one.append(u)
    assert np.array_equal(outputs, one_by_one)
    assert np.array_equal(end.plays, memory.plays)
    first, memory = model.simulate(inputs[:cut], start)
    second, memory = model.simulate(inputs[cut:], memory)
    assert np.array_equal(outputs, np.concatenate([first, second]))


@pytest.mark.parametrize("function", ["tanh", "erf", "arctan", "linear"])
def test_an_envelope_s_slope_and_inverse_are_its_own(function: str) -> None:
    """Of a wrong slope the inverse takes longer; of a wrong inverse, too: no test of its result would show either."""
    code, a, b = Envelope(function, 0.2, -11.6).row()
    for v in np.linspace(40.0, 78.0, 39):
        value, slope = envelope(code, a, b, v)
        assert value == envelope_value(code, a, b, v)
        assert envelope_inverse(code, a, b, value) == pytest.approx(v, abs=1e-7)
        both = envelope_value(code, a, b, v + 1e-4) - envelope_value(code, a, b, v - 1e-4)
        assert slope == pytest.approx(both / 2e-4, rel=1e-5)
    steepest, most = envelope_steepest(code, a, b)
    assert most == pytest.approx(envelope(code, a, b, 58.0)[1])
    assert function == "linear" or steepest == pytest.approx(58.0)


@pytest.mark.parametrize("initial", ["cooled", "heated"])
def test_default_memory_is_a_long_way_from_one_end(initial: str) -> None:
    model = table_2(generalized=True)
    memory = model.initial_memory(58.0, initial)  # type: ignore[arg-type]
    far = 1000.0 if initial == "cooled" else -1000.0
    walked = model.simulate(np.array([-far, far, 58.0]), Memory(0.0, np.zeros(30)))[1]
    np.testing.assert_allclose(memory.plays, walked.plays, rtol=0.0, atol=1e-12)


def test_the_model_and_its_memory_never_change() -> None:
    model = table_2(generalized=False)
    memory = model.initial_memory(30.0)
    before = memory.plays.copy()
    model.simulate(np.linspace(30.0, 80.0, 50), memory)
    assert np.array_equal(memory.plays, before)
    with pytest.raises(ValueError, match="read-only"):
        memory.plays[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        model.radii[0] = 1.0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"radii": [-0.1, 0.2]}, "radii"),
        ({"weights": [0.1, np.nan]}, "weights"),
        ({"weights": [0.1]}, "1 numbers for 2 radii"),
        ({"kind": "preisach"}, "kind"),
        ({"initial": "wet"}, "initial"),
        ({"rising": (Envelope("tanh", 0.1, -6.0),)}, "1 envelopes for 2 radii"),
    ],
)
def test_faults_are_refused_by_name(change: dict[str, object], text: str) -> None:
    e = Envelope("tanh", 0.1, -6.0)
    arguments: dict[str, object] = {"radii": [0.1, 0.2], "weights": [0.1, 0.2], "rising": e, "falling": e}
    with pytest.raises(ValueError, match=text):
        FilmModel(**(arguments | change))  # type: ignore[arg-type]


def test_envelopes_and_memoryless_functions_refuse_what_they_cannot_be() -> None:
    with pytest.raises(ValueError, match="increasing"):
        Envelope("tanh", -0.1, 0.0)
    with pytest.raises(ValueError, match="none of"):
        Envelope("sin", 0.1, 0.0)
    with pytest.raises(ValueError, match="none of"):
        Memoryless("step")
    with pytest.raises(ValueError, match="finite"):
        Memoryless("sin", np.inf)


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
