"""Identification of films: of the model's class, not of it, measured; memory, outliers, several records, errors."""

from __future__ import annotations

import functools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.thermal.plate import PlateModel
from sim.inference.film.fit import FilmFit, identify_film, identify_film_records
from sim.inference.film.notes import _minor_loops
from sim.inference.film.rows import FilmRecord
from sim.inference.plate.fit import identify_plate
from tests.sim.inference.identification_films import (
    decaying_profile,
    is_prandtl_ishlinskii,
    random_profile,
    relay_film,
    through,
)

NOISE = 0.002
MEASURED = Path(os.environ.get("PELTIER_DATA", Path(__file__).parents[3] / "shared" / "data"))


def outputs(film: FilmModel, v: np.ndarray, initial: str = "cooled") -> np.ndarray:
    return film.simulate(v, film.initial_memory(float(v[0]), initial))[0]


def record(seed: int, samples: int = 3000, temperature_noise_K: float = 0.0) -> tuple[np.ndarray, ...]:
    """time_s, temperature_degC and output as read, temperature as it was."""
    rng = np.random.default_rng(100 + seed)
    v = decaying_profile(samples)
    y = outputs(is_prandtl_ishlinskii(seed), v) + NOISE * rng.normal(size=samples)
    return 0.5 * np.arange(samples), v + temperature_noise_K * rng.normal(size=samples), y, v


@functools.cache
def fitted(seed: int) -> FilmFit:
    """The record of that seed, fitted with a film of the class."""
    return identify_film(*record(seed)[:3], kind="extended_generalized_pi")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def error_elsewhere(fit: FilmFit, film: FilmModel, seed: int = 5) -> float:
    """RMS error of the model's curve on a random profile that it was not fitted to."""
    v = random_profile(2500, seed)
    return rms(outputs(fit.model, v) - outputs(film, v))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_a_film_of_the_class_is_found_to_its_noise(seed: int) -> None:
    time, temperature, y, _ = record(seed)
    fit = identify_film(time, temperature, y)
    assert fit.model.kind == "extended_generalized_pi"
    assert fit.model.memoryless.function == "tanh"
    assert np.hypot(1.0, error_elsewhere(fit, is_prandtl_ishlinskii(seed)) / NOISE) < 1.02
    assert fit.rmse < 1.03 * NOISE
    assert fit.temperature_noise_K == (0.0,)


@pytest.mark.parametrize("function", ["erf", "arctan"])
def test_envelopes_with_other_tails_are_found(function: str) -> None:
    """Of tanh envelopes alone, what is left is taken for effects of the rig."""
    film = is_prandtl_ishlinskii(0)
    assert isinstance(film.rising, Envelope)
    assert isinstance(film.falling, Envelope)
    film = replace(
        film, rising=replace(film.rising, function=function), falling=replace(film.falling, function=function)
    )
    rng, v = np.random.default_rng(7), decaying_profile(3000)
    fit = identify_film(0.5 * np.arange(v.size), v, outputs(film, v) + NOISE * rng.normal(size=v.size))
    assert isinstance(fit.model.rising, Envelope)
    assert fit.model.rising.function == function
    assert fit.rmse < 1.03 * NOISE


def test_noise_on_the_temperature_does_not_ratchet_the_operators() -> None:
    time, temperature, y, _ = record(1, temperature_noise_K=0.02)
    smooth = identify_film(time, temperature, y)
    ratcheted = identify_film(time, temperature, y, temperature_noise_K=0.0)
    assert smooth.temperature_noise_K[0] == pytest.approx(0.02, rel=0.1)
    assert smooth.rmse < 1.05 * NOISE
    assert ratcheted.rmse > 1.15 * NOISE
    assert error_elsewhere(smooth, is_prandtl_ishlinskii(1)) < 0.25 * NOISE


def test_the_residual_is_what_the_returned_model_leaves() -> None:
    time, temperature, y, _ = record(2)
    for kind in ("extended_generalized_pi", "generalized_pi", "mixed_envelopes"):
        fit = fitted(2) if kind == "extended_generalized_pi" else identify_film(time, temperature, y, kind=kind)
        assert fit.model.kind == kind
        simulated, _ = fit.model.simulate(temperature, fit.memories[0])
        assert rms(simulated - y) == pytest.approx(fit.rmse, rel=1e-6)
        assert np.max(np.abs(simulated - y)) == pytest.approx(fit.max_abs, rel=1e-6)
        assert np.min(fit.model.order_margin()) > -1e-9
        assert np.all(fit.model.radii < 1.0)
        assert np.all(fit.model.weights > 0.0)


def test_the_order_condition_is_violated_only_on_request_and_told() -> None:
    v = decaying_profile(2500)
    film = is_prandtl_ishlinskii(3)
    crossed = FilmModel(
        np.linspace(0.0, 0.9, 10),
        film.weights.mean() * np.ones(10),
        film.rising.__class__("tanh", 0.16, -9.4),
        film.falling.__class__("tanh", 0.16, -10.0),
        film.memoryless,
    )
    y = outputs(crossed, v) + NOISE * np.random.default_rng(0).normal(size=v.size)
    kept = identify_film(0.5 * np.arange(v.size), v, y, kind="extended_generalized_pi")
    free = identify_film(0.5 * np.arange(v.size), v, y, kind="extended_generalized_pi", ordered=False)
    assert np.min(kept.model.order_margin()) > -1e-9
    assert not any("order condition" in note for note in kept.identifiability)
    assert np.min(free.model.order_margin()) < -0.01
    assert any("order condition" in note and "jumps" in note for note in free.identifiability)


def test_a_relay_film_needs_mixed_envelopes_and_d() -> None:
    v, elsewhere = decaying_profile(3000), random_profile(2500, 5)
    y = relay_film(v) + NOISE * np.random.default_rng(0).normal(size=v.size)
    truth = relay_film(elsewhere)
    errors = {}
    for kind in ("generalized_pi", "extended_generalized_pi", None):
        fit = identify_film(0.5 * np.arange(v.size), v, y, kind=kind)
        errors[kind] = rms(outputs(fit.model, elsewhere) - truth)
    assert fit.model.kind == "mixed_envelopes"
    assert errors[None] < 0.004
    assert errors["extended_generalized_pi"] < 0.012
    assert errors["generalized_pi"] > 2.0 * errors["extended_generalized_pi"]


def test_a_noisy_thermometer_does_not_blur_a_film_whose_current_is_known() -> None:
    """With 0.1 K of noise on 0.1 dec/K a smoothed thermometer costs half as much again as the ohmmeter's noise."""
    random, time = np.random.default_rng(5), 0.5 * np.arange(4000)
    turns = np.cumsum(np.append(0.0, random.uniform(60.0, 120.0, 30)))
    current = np.interp(time, turns, [2.2, *([2.6, -0.2] * 15)] + 0.4 * random.normal(size=31))
    plate = PlateModel(1.6e-3, 0.06, 0.018, 24.0).simulate(24.0, time, current)
    film = is_prandtl_ishlinskii(2)
    measured = outputs(film, plate, "heated") + NOISE * random.normal(size=time.size)
    seen = plate + 0.1 * random.normal(size=time.size)
    course = identify_plate(time, seen, current).course_degC[0]
    fits = [identify_film_records([FilmRecord(time, seen, measured, course_degC=one)]) for one in (None, course)]
    assert rms(course - plate) < 0.01
    assert fits[0].rmse > 1.2 * NOISE
    assert fits[1].rmse < 1.02 * NOISE
    assert error_elsewhere(fits[1], film) < 0.5 * error_elsewhere(fits[0], film)


@pytest.mark.parametrize("background", [-0.06, -0.01, 0.03])
def test_a_magnetization_over_a_straight_background_is_fitted_to_its_noise(background: float) -> None:
    """On a diamagnetic substrate more falls than rises with the field; the loop shows in which sense it lags."""
    noise, field = 0.8, through([1000.0, -1000.0, 1000.0, -300.0, 500.0, -100.0, 350.0, -1000.0, 1000.0], 2000)

    def moment(over: np.ndarray) -> np.ndarray:
        loop = relay_film(over, spread_K=80.0, half_width_K=200.0, relays=1000, centre=0.0)
        return 60.0 * loop + background * over

    measured = moment(field) + noise * np.random.default_rng(1).normal(size=field.size)
    fit = identify_film(np.arange(field.size), field, measured, output_name="moment", temperature_noise_K=0.0)
    assert fit.rmse < 1.1 * noise


def test_outliers_are_left_out() -> None:
    time, temperature, y, _ = record(1, temperature_noise_K=0.01)
    rng = np.random.default_rng(8)
    bad = rng.choice(np.arange(10, y.size - 10), 60, replace=False)
    y[bad[:30]] += rng.choice([-1.0, 1.0], 30) * rng.uniform(0.05, 2.0, 30)
    temperature[bad[30:]] += rng.choice([-1.0, 1.0], 30) * rng.uniform(1.0, 20.0, 30)
    y[rng.choice(y.size, 300)] = np.nan
    fit = identify_film(time, temperature, y)
    assert error_elsewhere(fit, is_prandtl_ishlinskii(1)) < 0.3 * NOISE
    assert 20 <= fit.outliers[0].size <= 40
    assert fit.rmse < 1.05 * NOISE


@pytest.mark.parametrize(
    ("initial", "previous"), [("heated", 63.0), pytest.param("cooled", 56.0, marks=pytest.mark.long)]
)
def test_the_memory_before_the_first_row_is_fitted(initial: str, previous: float) -> None:
    film = is_prandtl_ishlinskii(2)
    far = 30.0 if initial == "heated" else 90.0
    before = through([far, previous, 59.0], 200)
    after = through([59.0, 90.0], 300)
    v = np.concatenate((before, after, decaying_profile(2500)))
    y = outputs(film, v, initial)[before.size :] + NOISE * np.random.default_rng(4).normal(size=v.size - before.size)
    v = v[before.size :]
    fit = identify_film(0.5 * np.arange(v.size), v, y)
    assert fit.starts[0].initial == initial
    assert fit.starts[0].turned_degC == pytest.approx((previous,), abs=0.5)
    assert fit.rmse < 1.03 * NOISE
    told = identify_film(0.5 * np.arange(v.size), v, y, initial="cooled" if initial == "heated" else "heated")
    assert told.rmse > 1.1 * NOISE
    assert told.starts[0].turned_degC == ()


def test_several_records_share_one_film_but_no_memory() -> None:
    time, temperature, y, _ = record(0)
    parts = [FilmRecord(time[k], temperature[k], y[k]) for k in (slice(0, 1700), slice(1700, None))]
    fit = identify_film_records(parts)
    assert len(fit.starts) == len(fit.memories) == 2
    assert error_elsewhere(fit, is_prandtl_ishlinskii(0)) < 0.3 * NOISE


def test_outputs_read_between_the_rows_are_taken_at_their_own_time() -> None:
    film = is_prandtl_ishlinskii(1)
    dense = decaying_profile(20_001)
    y = outputs(film, dense)
    rng = np.random.default_rng(3)
    rows = np.arange(10, 20_001, 10)
    read = rows - rng.integers(0, 9, rows.size)
    output = y[read] + 0.001 * rng.normal(size=rows.size)
    fit = identify_film(0.05 * rows, dense[rows], output, output_time_s=0.05 * read)
    blind = identify_film(0.05 * rows, dense[rows], output)
    assert fit.rmse < 0.00125  # a corner between two rows is not in the record
    assert blind.rmse > 1.5 * fit.rmse
    assert error_elsewhere(fit, film) < 0.8 * error_elsewhere(blind, film)


def test_bands_hold_the_truth() -> None:
    inside = []
    for seed in (0, 1, 2):
        fit = fitted(seed)
        v = random_profile(1500, seed)
        prediction = fit.predict(0.5 * np.arange(v.size), v)
        off = np.abs(prediction.output - outputs(is_prandtl_ishlinskii(seed), v))
        inside.append(np.mean(off < prediction.half_width))
        assert np.mean(prediction.half_width) < 0.5 * NOISE
        assert np.all(prediction.half_width_reading > 1.9 * NOISE)
        assert fit.outer_values.shape == fit.outer_standard_errors.shape == (len(fit.outer_names),)
    assert np.mean(inside) > 0.85


@pytest.mark.parametrize("form", ["none", "tanh", "linear", "arrhenius", "polynomial", "sin", "cos"])
def test_forms_keep_their_sense(form: str) -> None:
    time, temperature, y, _ = record(1, samples=1500)
    fit = identify_film(time, temperature, y, kind="extended_generalized_pi", form=form, monotone=True)
    assert fit.model.memoryless.function == form
    from compensator.hysteresis.functions import memoryless

    d = [memoryless(fit.model.memoryless.code, fit.model.memoryless_array, v)[0] for v in np.linspace(31.0, 89.0, 200)]
    assert np.min(np.diff(d)) > -1e-9


def test_a_curvature_with_a_sine_is_found() -> None:
    v = decaying_profile(2000)
    film = is_prandtl_ishlinskii(0)
    hysteresis = FilmModel(film.radii, film.weights, film.rising, film.falling)
    y = 924.0 + 40.0 * np.sin(0.17 * v) + 150.0 * outputs(hysteresis, v)
    y += 2.0 * np.random.default_rng(0).normal(size=v.size)
    fit = identify_film(
        0.5 * np.arange(v.size), v, y, kind="extended_generalized_pi", form="sin", output_name="curvature_per_m"
    )
    assert fit.model.output == "curvature_per_m"
    assert fit.model.memoryless.a == pytest.approx(0.17, rel=0.02)
    assert fit.model.memoryless.amplitude == pytest.approx(40.0, rel=0.05)
    assert fit.rmse < 2.1


@pytest.mark.long
def test_what_a_major_loop_leaves_open_is_told() -> None:
    film = is_prandtl_ishlinskii(0)
    v = through([95.0, 25.0, 95.0], 1200)
    y = outputs(film, v) + NOISE * np.random.default_rng(1).normal(size=v.size)
    loop = identify_film(np.arange(1200.0), v, y)
    assert any("minor loops are not determined" in note for note in loop.identifiability)
    rich = identify_film(*record(1)[:3])
    assert rich.identifiability == ()
    cold = through([25.0, 45.0, 25.0, 45.0], 800)
    noise = NOISE * np.random.default_rng(1).normal(size=800)
    flat = identify_film(np.arange(800.0), cold, 0.01 * cold - 5.0 + noise)
    assert any("does not cross the transition" in note for note in flat.identifiability)
    up = through([25.0, 95.0], 600)
    one_way = identify_film(np.arange(600.0), up, outputs(film, up, "heated"))
    assert any("No falling sweep" in note for note in one_way.identifiability)


def test_unusable_records_are_refused_in_one_line() -> None:
    time, temperature, y, _ = record(0, samples=400)
    cases = [
        (time[::-1], temperature, y, "increasing"),
        (time, 25.0 + 0.01 * np.random.default_rng(0).normal(size=400), y, "constant"),
        (time, temperature, np.full(400, np.nan), "no finite reading"),
        (time, np.full(400, np.nan), y, "temperature_degC"),
        (time[:5], temperature[:5], y[:5], "at least 12"),
        (time[:-1], temperature, y, "same length"),
        (time, temperature, np.full(400, 3.0), "constant"),
        (time, temperature, -y, "rises"),
    ]
    for t, v, output, words in cases:
        with pytest.raises(ValueError, match=words) as caught:
            identify_film(t, v, output)
        assert "\n" not in str(caught.value)
    for wrong in ({"kind": "preisach"}, {"form": "cosh"}, {"initial": "hot"}, {"operators": 0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            identify_film(time, temperature, y, **wrong)


@pytest.fixture(scope="module")
def measured() -> tuple[np.ndarray, ...]:
    file = MEASURED / "vo2_film_major_loop.tsv"
    if not file.is_file():
        pytest.skip(f"{file}: not there (PELTIER_DATA)")
    table = np.loadtxt(file, skiprows=1)
    return table[:, 0], table[:, 1] - 273.15, -np.log10(table[:, 2])


def test_the_measured_film(measured: tuple[np.ndarray, ...]) -> None:
    time, temperature, y = measured
    fit = identify_film(time, temperature, y)
    assert fit.rmse < 0.02
    plain = identify_film(time, temperature, y, kind="extended_generalized_pi")
    assert plain.rmse < 0.06
    assert identify_film(time, temperature, y, kind="generalized_pi").rmse < 0.15
    assert any("minor loops are not determined" in note for note in fit.identifiability)


def test_half_of_the_measured_film_predicts_the_other(measured: tuple[np.ndarray, ...]) -> None:
    time, temperature, y = measured
    half = np.where(np.arange(y.size) % 2 == 0, y, np.nan)
    fit = identify_film(time, temperature, half)
    assert rms((outputs(fit.model, temperature) - y)[1::2]) < 0.02


@pytest.mark.parametrize(("known", "said"), [(12, True), (40, False), (41, False)])
def test_weights_that_are_all_fixed_are_not_held_against_a_record(known: int, said: bool) -> None:
    (note,) = _minor_loops(np.array([52.0, 61.6]), (48.0, 71.0), False, known, 40)
    assert ("combinations of 40 weights" in note) == said
    assert "(52.0, 61.6 degC): " in note
    assert "minor loops elsewhere are extrapolated" in note
