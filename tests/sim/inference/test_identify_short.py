"""Identification of short records: what few rows tell is used, what they cannot tell is said."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from sim.inference.film.fit import FilmStart, identify_film
from sim.inference.readings.output_sense import output_sense
from tests.sim.inference.identification_films import through

SHARP = FilmModel(
    np.linspace(0.2, 0.95, 12),
    np.full(12, 0.12),
    Envelope("tanh", 0.5, -0.5 * 66.0),
    Envelope("tanh", 0.5, -0.5 * 62.0),
    Memoryless("arrhenius", -1100.0, offset=-0.5),
)


def one_loop(first_degC: float, step_K: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures (degC) down to 22 and back, and the output of SHARP with noise of 0.002."""
    down = np.arange(first_degC, 22.0, -step_K)
    v = np.concatenate([down, down[-2::-1]])
    y = SHARP.simulate(v, SHARP.initial_memory(float(v[0]), "cooled"))[0]
    return v, y + 0.002 * np.random.default_rng(seed).standard_normal(v.size)


@pytest.mark.parametrize(("first_degC", "seed"), [(84.2, 0), (86.0, 1), (83.6, 2), (87.0, 3)])
def test_true_readings_of_a_sparse_loop_are_kept(first_degC: float, seed: int) -> None:
    v, y = one_loop(first_degC, 6.0, seed)
    fit = identify_film(60.0 * np.arange(v.size), v, y)
    assert fit.outliers[0].size == 0


def test_true_strays_are_left_out_and_nothing_else() -> None:
    """Eight of ten readings that are off by 20 to 30 times the noise, anywhere in a loop; no other one."""
    found, false, records = 0, 0, 12
    for seed in range(records):
        v, y = one_loop(88.0, 0.5, seed)
        strays = np.random.default_rng(seed).choice(np.arange(5, v.size - 5), 3, replace=False)
        y[strays] += [0.05, -0.04, 0.06]
        out = identify_film(60.0 * np.arange(v.size), v, y).outliers[0]
        found += int(np.sum(np.isin(out, strays)))
        false += int(np.sum(~np.isin(out, strays)))
    assert found >= 0.8 * 3 * records
    assert false == 0


WIDE = FilmModel(
    np.linspace(0.55, 0.98, 12),
    np.full(12, 0.12),
    Envelope("tanh", 0.15, -0.15 * 70.0),
    Envelope("tanh", 0.15, -0.15 * 55.0),
    Memoryless("linear", 1.0, 0.002, 0.0, -4.0),
)


def test_a_falling_output_with_a_wide_loop_is_refused_and_a_rising_one_taken() -> None:
    """A loop of 15 K run through between 45 and 80 degC: the output falls, its correlation is -0.46 only."""
    v = through([80.0, 45.0, 80.0, 45.0, 80.0, 45.0], 1200)
    noise = 0.002 * np.random.default_rng(0).standard_normal(v.size)
    y = WIDE.simulate(v, WIDE.initial_memory(80.0, "cooled"))[0] + noise
    with pytest.raises(ValueError, match="falls as temperature rises"):
        identify_film(0.5 * np.arange(v.size), v, -y)
    assert output_sense([(v, y)]) > 0.9
    assert output_sense([(v, noise)]) == pytest.approx(0.0, abs=0.1)


def test_a_model_without_any_weight_is_refused() -> None:
    """An output that ripples as it falls: no play operator, whose output rises, brings anything."""
    v = np.linspace(20.0, 90.0, 300)
    with pytest.raises(ValueError, match="nothing in it rises"):
        identify_film(np.arange(v.size), v, 0.05 * np.sin(v) - 0.02 * v, form="none", monotone=False)


def test_the_band_is_infinite_where_the_path_takes_a_branch_that_no_record_has() -> None:
    v = through([25.0, 85.0], 400)
    random = np.random.default_rng(0)
    y = SHARP.simulate(v, SHARP.initial_memory(25.0, "heated"))[0] + 0.002 * random.standard_normal(v.size)
    fit = identify_film(0.5 * np.arange(v.size), v, y)
    assert np.all(np.isfinite(fit.predict(0.5 * np.arange(v.size), v).half_width))
    loop = through([25.0, 70.0, 50.0, 85.0], 400)
    half = fit.predict(0.5 * np.arange(loop.size), loop, temperature_noise_K=0.0).half_width
    falls = np.flatnonzero(np.diff(loop) < 0.0) + 1
    back = np.flatnonzero(loop > 70.0)  # beyond the reversal the film has forgotten it
    assert np.all(np.isfinite(half[: falls[0]]))
    assert np.all(np.isfinite(half[back[back > falls[-1]]]))
    assert np.all(np.isinf(half[falls]))
    cooled = fit.predict([0.0, 1.0, 2.0], [85.0, 60.0, 50.0], start=FilmStart("cooled"), temperature_noise_K=0.0)
    assert np.all(np.isinf([cooled.half_width, cooled.half_width_reading]))


def test_a_film_without_hysteresis_is_not_told_to_sweep_further() -> None:
    v = through([25.0, 85.0, 25.0, 85.0], 600)
    noise = 0.002 * np.random.default_rng(0).standard_normal(v.size)
    across = identify_film(0.5 * np.arange(v.size), v, np.tanh(0.3 * (v - 62.0)) + noise)
    (note,) = [note for note in across.identifiability if "hysteresis" in note]
    assert "No hysteresis larger than the noise" in note
    assert "cross" not in note
    below = through([25.0, 50.0, 25.0, 50.0], 600)
    short = identify_film(0.5 * np.arange(v.size), below, 0.01 * below + noise)
    assert any("does not cross the transition" in note for note in short.identifiability)


def test_a_prediction_checks_its_columns() -> None:
    v = through([85.0, 25.0, 85.0, 40.0, 70.0], 300)
    fit = identify_film(0.5 * np.arange(v.size), v, SHARP.simulate(v, SHARP.initial_memory(85.0, "cooled"))[0])
    with pytest.raises(ValueError, match="same length"):
        fit.predict([0.0, 1.0, 2.0], [60.0, 70.0])
    with pytest.raises(ValueError, match="increasing"):
        fit.predict([1.0, 0.0], [60.0, 70.0])
    for temperatures in ([], [np.nan, np.nan]):
        with pytest.raises(ValueError, match="no finite number"):
            fit.predict(np.arange(len(temperatures)), temperatures)
