"""The path behind noisy temperatures: noise found, corners kept, outliers out, clean readings untouched."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.identification.outliers import lone_outliers
from compensator.identification.temperature_smoother import temperature_path, turning_points
from tests.compensator.identification_films import decaying_profile


@pytest.mark.parametrize("noise", [0.003, 0.02, 0.1])
def test_noise_is_estimated_and_taken_out(noise: float) -> None:
    v = decaying_profile(4000)
    found = temperature_path(0.5 * np.arange(4000), v + noise * np.random.default_rng(0).normal(size=4000))
    assert found.noise_K == pytest.approx(noise, rel=0.1)
    off = found.temperature_degC - v
    assert np.sqrt(np.mean(off**2)) < 0.35 * noise
    assert np.max(np.abs(off)) < 4.0 * noise
    assert 16 <= found.turning.size <= 20


def test_a_dwell_does_not_creep() -> None:
    time = np.arange(0.0, 2000.0, 0.5)
    v = np.interp(time, [0.0, 300.0, 1700.0, 2000.0], [30.0, 60.0, 60.0, 80.0])
    found = temperature_path(time, v + 0.02 * np.random.default_rng(1).normal(size=v.size))
    held = found.temperature_degC[(time > 310.0) & (time < 1690.0)]
    assert np.ptp(held) < 0.015
    assert np.all(np.diff(found.temperature_degC) >= 0.0)


def test_clean_readings_come_back_to_the_bit() -> None:
    v = decaying_profile(1500)
    found = temperature_path(np.arange(1500.0), v)
    assert found.noise_K == 0.0
    assert np.array_equal(found.temperature_degC, v)
    noisy = v + 0.05 * np.random.default_rng(2).normal(size=1500)
    assert np.array_equal(temperature_path(np.arange(1500.0), noisy, noise_K=0.0).temperature_degC, noisy)


def test_outliers_and_missing_readings_are_bridged() -> None:
    v = decaying_profile(3000)
    readings = v + 0.01 * np.random.default_rng(3).normal(size=3000)
    readings[[500, 1500]] += [5.0, -3.0]
    readings[2000:2010] = np.nan
    found = temperature_path(0.5 * np.arange(3000), readings)
    assert {500, 1500} <= set(found.outliers.tolist())
    assert found.outliers.size <= 4
    assert np.max(np.abs(found.temperature_degC - v)) < 0.06


def test_turning_points_ignore_small_reversals() -> None:
    values = np.array([0.0, 1.0, 0.9, 2.0, 1.0, 1.05, 0.0, 3.0])
    assert turning_points(values, 0.2).tolist() == [0, 3, 6, 7]
    assert turning_points(values, 0.0).tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert turning_points(np.arange(5.0), 0.1).tolist() == [0, 4]


def test_a_steep_flank_is_no_outlier() -> None:
    x = np.linspace(-10.0, 10.0, 200)
    y = np.tanh(3.0 * x) + 1e-3 * np.random.default_rng(0).normal(size=200)
    every = np.ones(200, dtype=np.bool_)
    assert lone_outliers(y, every).size == 0
    y[40] += 0.05
    assert lone_outliers(y, every).tolist() == [40]
