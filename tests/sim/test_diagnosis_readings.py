"""What the diagnosis makes of readings: outliers in a residual, rounded readings, rows that are held out."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.data.likelihood import expected_reading, lattice_noise, likelihood, origin_of
from sim.diagnosis.data.noise_estimate import noise_of
from sim.diagnosis.data.record import REPEATED, held_out_rows, read_columns
from sim.diagnosis.data.residual_outliers import outlying_rows
from sim.diagnosis.data.sparse_loop import sparse_loop
from sim.diagnosis.diagnose import diagnose
from tests.diagnosis.cases import case


def test_outliers_stand_out_of_a_residual_that_drifts() -> None:
    rng = np.random.default_rng(3)
    n = 2000
    residual = 0.5 * np.sin(np.arange(n) / 40.0) + 0.01 * rng.standard_normal(n)
    alone, pair = 700, (1200, 1202)
    for k in (alone, *pair):
        residual[k] += 0.4
    found = outlying_rows(residual, np.zeros(n), np.ones(n, dtype=np.bool_), 0.0)
    assert found.tolist() == [alone, *pair]


def test_a_step_that_stays_is_no_outlier() -> None:
    rng = np.random.default_rng(4)
    residual = 0.01 * rng.standard_normal(1000)
    residual[500:] += 1.0
    assert outlying_rows(residual, np.zeros(1000), np.ones(1000, dtype=np.bool_), 0.0).size == 0


def test_where_rows_are_far_apart_nothing_is_lone() -> None:
    """A flank that a model misses in one of its few rows: the readings tell as little of one another."""
    kelvin = np.arange(200) % 100 * 0.7
    readings = -2.0 * np.tanh((kelvin - 35.0) / 3.0)
    shown = -2.0 * np.tanh((kelvin - 35.2) / 3.0)
    assert outlying_rows(readings, shown, np.ones(200, dtype=np.bool_), 1e-4).size == 0
    readings[20] += 0.05
    assert outlying_rows(readings, shown, np.ones(200, dtype=np.bool_), 1e-4).tolist() == [20]


def test_an_instrument_that_is_noisier_in_one_range_has_no_outliers() -> None:
    noise = 1e-4 * np.random.default_rng(6).standard_normal(1000)
    noise[600:700] *= 30.0
    every = np.ones(1000, dtype=np.bool_)
    assert outlying_rows(noise, np.zeros(1000), every, 1e-5).size <= 2  # at its ends


@pytest.mark.parametrize(("step_K", "loops", "sparse"), [(0.6, 1, True), (0.05, 1, False), (0.6, 3, False)])
def test_one_loop_with_few_rows_on_its_flanks_decides_nothing(step_K: float, loops: int, sparse: bool) -> None:
    up = np.arange(30.0, 80.0, step_K)
    degC = np.tile(np.concatenate((up, up[::-1])), loops)
    rising = np.tile(np.repeat([True, False], up.size), loops)
    ohm = 10.0 ** (4.0 - 2.0 * np.tanh((degC - np.where(rising, 58.0, 52.0)) / 2.0))
    record = read_columns({"time_s": np.arange(degC.size) * 5.0, "temperature_degC": degC, "resistance_ohm": ohm})
    found = sparse_loop(record, 2e-4)
    assert (found is not None) == sparse
    if found is not None:
        assert found.step_K == pytest.approx(step_K)
        assert 0.0 < found.wanted_K < 0.5 * step_K
        assert "minor loops" in found.missing


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.4])
def test_rounded_readings_have_this_mean_and_variance(sigma: float) -> None:
    rng = np.random.default_rng(5)
    mu, step = np.array([20.0, 20.06, 20.12, 20.124]), 0.25
    drawn = np.round((mu + sigma * rng.standard_normal((200_000, 4))) / step) * step
    mean, variance = expected_reading(mu, sigma, step)
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=0.003)
    np.testing.assert_allclose(drawn.var(axis=0), variance, atol=0.003)


@pytest.mark.parametrize("origin", [0.0, 0.1, -0.124])
def test_a_lattice_need_not_go_through_zero(origin: float) -> None:
    """Kelvins rounded to 0.25 K lie 0.1 K beside the degrees that are."""
    rng, step = np.random.default_rng(8), 0.25
    mu = np.linspace(20.0, 24.0, 4000)
    readings = origin + step * np.round((mu + 0.03 * rng.standard_normal(mu.size) - origin) / step)
    found = origin_of(readings, step)
    assert found == pytest.approx(origin, abs=1e-9)
    mean, variance = expected_reading(mu, 0.03, step, found)
    assert np.mean((readings - mean) ** 2) == pytest.approx(np.mean(variance), rel=0.1)


@pytest.mark.parametrize("sigma", [0.1, 0.3, 0.6, 0.7, 0.8, 1.0, 2.0])
def test_the_noise_beneath_a_rounding_of_about_its_size(sigma: float) -> None:
    """In steps. Of a plate that hardly moves: second differences then come in few sizes."""
    rng = np.random.default_rng(9)
    mu = 40.0 + 3.0 * np.sin(np.arange(4000) / 300.0)
    readings = np.round(mu + sigma * rng.standard_normal(mu.size))
    assert lattice_noise(readings, mu, 1.0, 3.0) == pytest.approx(sigma, rel=0.05)
    if sigma >= 0.6:  # from there on rounding is as good as noise of its own
        every = np.ones(mu.size, dtype=np.bool_)
        found = noise_of(readings - mu, readings, every, every, 1e-3, stepped=False).level
        assert found == pytest.approx(np.hypot(sigma, 1.0 / np.sqrt(12.0)), rel=0.05)


def test_the_rows_after_a_gap_are_not_held_out() -> None:
    time = np.arange(3000.0)
    time[1250:] += 60.0
    columns = {"time_s": time, "temperature_degC": 30.0 + np.sin(time / 50.0), "current_A": np.sin(time / 50.0)}
    record = read_columns(columns)
    assert record.first_rows.tolist() == [0, 1250]
    assert not np.any(record.held_out[1250:1300])
    assert np.mean(record.held_out) > 0.15
    assert 0.2 < np.mean(held_out_rows(3000)) < 0.25
    assert not np.any(read_columns(columns, held_out=False).held_out)


@pytest.mark.parametrize("step", [0.0, 0.1])
def test_a_trial_without_an_end_is_unlikely_and_no_warning(step: float) -> None:
    readings, shown = np.array([20.0, 20.0, 20.0]), np.array([20.0, 1e200, -1e300])
    near, *far = likelihood(readings, shown, 1e-3, step).minus_log
    assert near < 1.0
    assert min(far) > 1e15


def test_of_a_meter_slower_than_the_rows_each_reading_counts_once() -> None:
    blind = case("clean", 3, rows=2000)
    resistance = blind.columns["resistance_ohm"]
    held = resistance[np.arange(resistance.size) // 8 * 8]
    found = diagnose({**blind.columns, "resistance_ohm": held})
    assert found.verdict == "clean"
    channel = found.channels["resistance_dec"]
    assert channel is not None
    assert channel.noise == pytest.approx(blind.noise["resistance_dec"], rel=0.2)
    assert [w.code for w in found.warnings].count("repeated_readings") == 1
    assert sum(out.rule == REPEATED for out in found.record.left_out) > 0.8 * resistance.size
