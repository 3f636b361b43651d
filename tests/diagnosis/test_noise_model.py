"""The noise that a record shows: white unless it shows otherwise, and what a misfit does is none of it."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.data.noise_estimate import noise_of
from sim.diagnosis.data.noise_model import NoiseModel
from tests.diagnosis.truth.real_noise import hanging_together

ROWS = 6000
READINGS = 2.0 * np.sin(np.arange(ROWS) / 300.0)
EVERY = np.ones(ROWS, dtype=np.bool_)
FITTED = np.arange(ROWS) * 60 // ROWS % 4 != 1
SLOW = 2e-3 * np.sin(np.arange(ROWS) / 40.0)  # a model's misfit, as large as the noise


def estimated(residual: np.ndarray, used: np.ndarray = EVERY) -> NoiseModel:
    return noise_of(residual, READINGS, used, FITTED & used, 1e-6)


@pytest.mark.parametrize("misfit", [0.0, 1.0])
@pytest.mark.parametrize("seed", range(5))
def test_white_noise_stays_white_whatever_the_fit_leaves(seed: int, misfit: float) -> None:
    noise = 2e-3 * np.random.default_rng(seed).standard_normal(ROWS)
    model = estimated(noise + misfit * SLOW)
    assert model.plain
    assert model.level == pytest.approx(2e-3, rel=0.1)


def test_outliers_among_white_noise_are_no_tails() -> None:
    rng = np.random.default_rng(7)
    noise = 2e-3 * rng.standard_normal(ROWS)
    noise[rng.choice(ROWS, 60, replace=False)] += 0.3
    assert estimated(noise).plain


@pytest.mark.parametrize("correlation", [0.5, 0.7, 0.85])
@pytest.mark.parametrize("misfit", [0.0, 1.0])
def test_noise_that_hangs_together_by_range_and_with_tails(correlation: float, misfit: float) -> None:
    rng = np.random.default_rng(3)
    deviation = np.where(READINGS > 0.5, 1e-3, 5e-3)
    noise = deviation * hanging_together(rng, ROWS, correlation)
    model = estimated(noise + misfit * SLOW)
    assert model.correlation == pytest.approx(correlation, abs=0.06)
    assert model.edges == pytest.approx([0.5], abs=0.1)
    assert model.degrees < 10.0
    shown = model.marginal(np.array([0.0, 1.0]))
    assert shown == pytest.approx([5e-3, 1e-3], rel=0.15)


def test_over_the_noise_is_white_and_of_variance_1() -> None:
    rng = np.random.default_rng(4)
    noise = np.where(READINGS > 0.5, 1e-3, 5e-3) * hanging_together(rng, ROWS, 0.8)
    rows = np.flatnonzero(FITTED)
    u = estimated(noise).on(rows, READINGS[rows]).over(noise[rows])
    assert float(np.mean(u * u)) == pytest.approx(1.0, abs=0.1)
    assert abs(float(np.mean(u[1:] * u[:-1]))) < 0.07
    assert float(np.max(np.abs(u))) < 4.0  # no reading far out weighs more than one near


def test_columns_are_weighed_as_readings_are() -> None:
    model = NoiseModel(1.0, np.array([0.0]), np.array([2.0, 1.0]), 0.5)
    rows = np.array([3, 4, 5, 9])
    whitening = model.on(rows, np.array([-1.0, -1.0, 1.0, 1.0]))
    values = np.random.default_rng(0).standard_normal((4, 3))
    columns = whitening.over(values)
    assert columns == pytest.approx(np.stack([whitening.over(v) for v in values.T], axis=1))
    x, root = values / np.array([2.0, 2.0, 1.0, 1.0])[:, None], np.sqrt(0.75)
    assert columns[0] == pytest.approx(x[0])
    assert columns[1:3] == pytest.approx((x[1:3] - 0.5 * x[:2]) / root)
    assert columns[3] == pytest.approx(x[3])  # rows are missing before it


def test_a_last_digit_hangs_together_with_nothing() -> None:
    rng = np.random.default_rng(5)
    course = READINGS * 10.0
    readings = 0.01 * np.round((course + 0.005 * hanging_together(rng, ROWS, 0.75)) / 0.01)
    rows = np.flatnonzero(FITTED)
    model = noise_of(readings - course, readings, EVERY, FITTED, 1e-4, stepped=False)
    u = model.on(rows, readings[rows]).over((readings - course)[rows])
    assert model.correlation == pytest.approx(0.75, abs=0.08)
    assert float(np.mean(u * u)) == pytest.approx(1.0, abs=0.12)
    around = [float(np.mean(u[lag:] * u[:-lag])) for lag in range(1, 6)]
    assert abs(sum(around)) < 0.15


def test_nothing_but_a_size_is_told_beneath_a_misfit_many_times_the_noise() -> None:
    rng = np.random.default_rng(6)
    course = np.convolve(rng.standard_normal(ROWS), np.exp(-0.5 * (np.arange(-30, 31) / 8.0) ** 2), "same")
    assert estimated(1e-3 * rng.standard_normal(ROWS) + 5e-3 * course).plain
