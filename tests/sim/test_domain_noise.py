"""What wanders beside noise, against the whole covariance; whether what is left of a film comes again in each pass."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.repeated_passes import agreement, passes

Array = NDArray[np.float64]


def walk(rows: int, seed: int) -> tuple[Wandering, Array]:
    """One with stretches, and its noise."""
    rng = np.random.default_rng(seed)
    keep, added = rng.uniform(0.6, 1.0, rows), rng.uniform(0.0, 0.5, rows)
    keep[[0, rows // 2]] = added[[0, rows // 2]] = 0.0
    return Wandering(keep, added), rng.uniform(0.2, 0.4, rows)


def covariance(wandering: Wandering, noise: Array) -> Array:
    """Of the readings of all rows, from the recursion written out."""
    size = noise.size
    through = np.eye(size)
    for k in range(1, size):
        through[k, :k] = wandering.keep[k] * through[k - 1, :k]
    return np.asarray(through @ np.diag(wandering.added) @ through.T + np.diag(noise**2))


def test_the_likelihood_is_that_of_the_whole_covariance() -> None:
    wandering, noise = walk(60, 1)
    rows = np.flatnonzero(np.random.default_rng(2).random(60) < 0.7)
    whole = covariance(wandering, noise)[np.ix_(rows, rows)]
    residual = np.random.default_rng(3).standard_normal(rows.size)
    log_det = np.linalg.slogdet(whole)[1]
    expected = -0.5 * float(residual @ np.linalg.solve(whole, residual)) - 0.5 * log_det
    whitening = wandering.whitening(rows, noise[rows])
    assert whitening.log_likelihood(residual) == pytest.approx(expected, rel=1e-9)
    white = whitening.over(np.eye(rows.size))
    assert white @ whole @ white.T == pytest.approx(np.eye(rows.size), abs=1e-9)


def test_the_deviation_is_that_of_the_covariance() -> None:
    wandering, noise = walk(60, 4)
    variance = np.diag(covariance(wandering, noise)) - noise**2
    assert wandering.deviation == pytest.approx(np.sqrt(variance))


def triangle(rows: int) -> Array:
    """Eight ways up and down between 40 and 60 degC."""
    return np.asarray(50.0 + 10.0 * (2.0 / np.pi) * np.arcsin(np.sin(np.arange(rows) * 8.0 * np.pi / rows)))


def test_passes_are_found() -> None:
    film_degC = triangle(4000)
    up, down = passes(film_degC, True), passes(film_degC, False)
    assert (len(up), len(down)) == (5, 4)  # begun and ended half-way
    assert all(film_degC[part][-1] > film_degC[part][0] for part in up)


@pytest.mark.parametrize("seed", range(5))
def test_what_comes_again_is_told_from_what_does_not(seed: int) -> None:
    """The same bumps at the same temperatures of heating and of cooling; and a walk in time of the same size."""
    rng, film_degC = np.random.default_rng(seed), triangle(4000)
    bumps = np.cumsum(rng.standard_normal((2, 200)), axis=1)
    places, rising = np.linspace(39.0, 61.0, 200), np.gradient(film_degC) > 0.0
    again = np.where(rising, np.interp(film_degC, places, bumps[0]), np.interp(film_degC, places, bumps[1]))
    once = np.cumsum(rng.standard_normal(4000)) * 0.3
    found, chance = agreement(film_degC, again, 0.5), agreement(film_degC, once, 0.5)
    assert found.share > 0.9
    assert found.deviations > 10.0
    assert abs(chance.deviations) < 4.0
    assert abs(chance.share) < 0.3
