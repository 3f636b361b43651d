"""The noise of a channel: the filter against dense matrices, what is estimated, and what a wrong metric would cost."""

from __future__ import annotations

import numpy as np
import pytest

from sim.inference.noise import (
    ChannelNoise,
    Noise,
    Readings,
    Whitening,
    discrepancy,
    estimate,
    relative_variance,
    variances,
)


def covariance(time: np.ndarray, noise: Noise) -> np.ndarray:
    """Of white noise and the discrepancy, written out, (readings, readings)."""
    x = np.abs(time[:, None] - time) * 2.0 / noise.tau_s
    return noise.white**2 * np.eye(time.size) + noise.slow**2 * (1.0 + x) * np.exp(-x)


def uneven(rows: int, seed: int) -> np.ndarray:
    """Times with jitter and one long gap."""
    steps = np.random.default_rng(seed).uniform(0.3, 0.8, rows)
    steps[rows // 3] = 40.0
    return np.cumsum(steps)


def test_the_filter_is_the_dense_likelihood() -> None:
    """Uneven times, a gap, and readings that weigh less: else every evidence and interval would be another."""
    rng, noise = np.random.default_rng(0), Noise(0.02, 0.1, 9.0)
    time = uneven(300, 1)
    readings = Readings(time, np.arange(300) == 0, np.where(rng.random(300) < 0.1, 7.0, 1.0))
    dense = covariance(time, noise) + noise.white**2 * np.diag(readings.variance - 1.0)
    values = rng.normal(size=300)
    whitening = Whitening(noise, readings)
    expected = -0.5 * (np.linalg.slogdet(dense)[1] + values @ np.linalg.solve(dense, values))
    assert whitening.log_likelihood(values) == pytest.approx(expected, rel=1e-9)
    other = rng.normal(size=(300, 2))
    white = whitening.of(np.column_stack((values, other)))
    assert white.T @ white == pytest.approx(
        np.column_stack((values, other)).T @ np.linalg.solve(dense, np.column_stack((values, other))), rel=1e-8
    )
    slow = dense - noise.white**2 * np.diag(readings.variance)
    mean, deviation = discrepancy(values, noise, readings)
    assert mean == pytest.approx(slow @ np.linalg.solve(dense, values), abs=1e-8)
    assert deviation**2 == pytest.approx(np.diag(slow - slow @ np.linalg.solve(dense, slow)), abs=1e-8)


def test_records_are_independent() -> None:
    noise, time = Noise(0.02, 0.1, 9.0), uneven(100, 2)
    both = Readings.at(np.concatenate((time, time)), np.arange(200) % 100 == 0)
    values = np.random.default_rng(3).normal(size=200)
    alone = Whitening(noise, Readings.at(time))
    together = Whitening(noise, both).log_likelihood(values)
    assert together == pytest.approx(alone.log_likelihood(values[:100]) + alone.log_likelihood(values[100:]))


@pytest.mark.parametrize(("slow", "tau_s"), [(0.02, 30.0), (0.005, 8.0), (0.1, 200.0)])
def test_what_is_estimated(slow: float, tau_s: float) -> None:
    rng, truth = np.random.default_rng(4), Noise(0.01, slow, tau_s)
    time = uneven(1500, 5)
    residual = np.linalg.cholesky(covariance(time, truth)) @ rng.normal(size=1500)
    found = estimate(residual, Readings.at(time))
    assert found.white == pytest.approx(0.01, rel=0.1)
    assert 0.5 < found.slow / slow < 2.0
    assert 0.4 < found.tau_s / tau_s < 2.5


def test_white_noise_has_no_discrepancy() -> None:
    """By chance in one of a hundred: of twenty at most one, or intervals of sound fits would widen."""
    time = uneven(800, 6)
    found = [estimate(0.01 * np.random.default_rng(seed).normal(size=800), Readings.at(time)) for seed in range(20)]
    assert sum(noise.slow > 0.0 for noise in found) <= 1
    assert estimate(np.zeros(800), Readings.at(time), least_white=1e-3) == Noise(1e-3)


def test_a_bound_on_the_discrepancy() -> None:
    rng, time = np.random.default_rng(7), uneven(800, 8)
    residual = np.linalg.cholesky(covariance(time, Noise(0.01, 0.5, 50.0))) @ rng.normal(size=800)
    assert estimate(residual, Readings.at(time), most_slow=0.1).slow <= 0.1


def test_a_reading_far_out_weighs_less_and_its_neighbours_do_not() -> None:
    rng, time, truth = np.random.default_rng(9), uneven(600, 10), Noise(0.01, 0.05, 20.0)
    residual = np.linalg.cholesky(covariance(time, truth)) @ rng.normal(size=600)
    residual[300] += 1.0
    readings = Readings.at(time)
    for _ in range(4):
        readings = Readings(time, readings.begins, variances(residual, truth, readings))
    assert readings.variance[300] > 15.0
    assert np.sum(readings.variance > 1.5) <= 2


def test_noise_that_goes_with_the_reading_is_told_by_it() -> None:
    """Else the quiet half of a record counts for too little, and the loud half for too much."""
    rng = np.random.default_rng(6)
    shown = np.linspace(-4.0, -2.0, 4000)
    deviation = np.where(shown < -3.0, 0.004, 0.001)
    level = relative_variance(deviation * rng.standard_normal(shown.size), shown)
    assert np.mean(level) == pytest.approx(1.0)
    ends = np.mean(level[:1000]) / np.mean(level[-1000:])
    assert ends == pytest.approx(16.0, rel=0.3)
    assert np.all(relative_variance(0.001 * rng.standard_normal(shown.size), shown) == 1.0)


def test_what_a_fit_takes_of_a_discrepancy_counts_in_its_size() -> None:
    """A draught of a minute in a record of some minutes: else the intervals of room and loss hold the truth too seldom.
    What acts slowly is its size squared times its correlation time."""
    true, rng = Noise(0.02, 0.2, 40.0), np.random.default_rng(4)
    time = np.arange(300.0)
    columns = np.cos(np.pi * np.outer(time / time[-1], np.arange(6)))
    factor, readings = np.linalg.cholesky(covariance(time, true)), Readings.at(time)
    shares = []
    for _ in range(15):
        values = factor @ rng.normal(size=time.size)
        residual = values - columns @ np.linalg.lstsq(columns, values)[0]
        fitted = ChannelNoise(estimate(residual, readings), readings)
        whole = fitted.restricted(residual, columns, np.zeros((6, 6)))
        shares.append([n.slow**2 * n.tau_s / (true.slow**2 * true.tau_s) for n in (fitted.noise, whole.noise)])
    of_residual, of_all = np.median(shares, axis=0)
    assert of_residual < 0.5
    assert 0.7 < of_all < 1.4
