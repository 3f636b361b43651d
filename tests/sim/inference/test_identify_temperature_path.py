"""The path behind noisy temperatures: noise found, corners kept, outliers out, clean readings untouched."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from sim.inference.readings.odd_readings import lone_outliers
from sim.inference.readings.temperature_path import temperature_path, turning_points
from tests.sim.inference.identification_films import decaying_profile


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


@pytest.mark.parametrize("rounded_s", [0.0, 15.0])
@pytest.mark.parametrize("held_s", [0.0, 60.0])
def test_a_corner_that_a_plate_rounds_is_followed_as_well_as_a_sharp_one(rounded_s: float, held_s: float) -> None:
    """Reversals at 0.07 K/s, behind a plate of 15 s or of none, rows 2 s apart: about them the path is off by 0.45 to
    0.6 of the readings' noise. Where all corners were taken for sharp ones, rounded ones by 0.63 to 0.8, and the noise
    by up to 16 %."""
    fine_s, noise_K, turns = 0.2, 0.012, (24.0, 82.0, 55.0, 75.0, 60.0, 69.0, 63.0, 78.0, 50.0, 66.0, 58.0, 72.0, 40.0)
    legs = [np.linspace(a, b, round(abs(b - a) / (0.07 * fine_s))) for a, b in pairwise(turns)]
    held = [np.full(round(held_s / fine_s), leg[-1]) for leg in legs]
    v = np.concatenate([part for both in zip(legs, held, strict=True) for part in both])
    if rounded_s:
        keeps = np.exp(-fine_s / rounded_s)
        v = turns[0] + lfilter([1.0 - keeps], [1.0, -keeps], v - turns[0])
    v = v[:: round(2.0 / fine_s)]
    bends = np.convolve(np.abs(np.diff(v, 2, prepend=v[0], append=v[-1])) > 8e-4, np.ones(5), "same") > 0.0
    off, noise = [], []
    for seed in range(6):
        read = v + noise_K * np.random.default_rng(seed).normal(size=v.size)
        found = temperature_path(2.0 * np.arange(v.size), read)
        off.append((found.temperature_degC - v)[bends])
        noise.append(found.noise_K)
    assert np.sqrt(np.mean(np.square(off))) < 0.63 * noise_K
    assert np.mean(noise) == pytest.approx(noise_K, rel=0.09)
