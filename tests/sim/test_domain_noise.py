"""What wanders beside noise, against the whole covariance; whether what is left of a film comes again in each pass."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.repeated_passes import agreement, passes
from sim.diagnosis.validate.adequacy import a_period

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


def test_rows_stand_where_nothing_wandered_beyond_the_noise() -> None:
    wandering, noise = walk(60, 5)
    whole = covariance(wandering, noise)
    foreseen = [  # what is known of d in each row from the readings before it
        whole[k, k] - noise[k] ** 2 - whole[k, :k] @ np.linalg.solve(whole[:k, :k], whole[:k, k]) for k in range(60)
    ]
    stands = wandering.whitening(np.arange(60), noise).stands
    assert np.array_equal(stands, np.array(foreseen) < noise**2)
    assert 0.1 < np.mean(stands) < 0.9


def rows_with_a_period(period_s: float | None, seed: int) -> tuple[Array, Array]:
    """Residuals over the noise, with a sine of its half, and times, 0.5 s apart; stretches of rows are missing."""
    rng = np.random.default_rng(seed)
    time_s = 0.5 * np.arange(4000)
    time_s = time_s[np.sin(time_s / 70.0) > -0.3]
    sine = 0.0 if period_s is None else 0.5 * np.sin(2.0 * np.pi * time_s / period_s)
    return rng.standard_normal(time_s.size) + sine, time_s


@pytest.mark.parametrize("period_s", [3.7, 41.0, 190.0])
def test_a_period_is_found(period_s: float) -> None:
    asked = a_period(*rows_with_a_period(period_s, 6))
    assert asked is not None
    assert asked.log10_p < -20.0
    assert asked.share == pytest.approx(0.5**2 / 2.0, rel=0.3)


def test_of_noise_a_period_is_as_likely_as_said() -> None:
    found = [a_period(*rows_with_a_period(None, seed)) for seed in range(200)]
    chance = np.array([one.log10_p for one in found if one is not None])
    assert chance.size == 200
    assert 5 <= np.sum(chance < -1.0) <= 35  # 20 are foreseen
    assert np.all(chance > -5.0)


def test_too_few_rows_or_rows_on_no_grid_have_no_period() -> None:
    z, time_s = rows_with_a_period(41.0, 7)
    assert a_period(z[:99], time_s[:99]) is None
    late = time_s.copy()
    late[-1] += 1e6
    assert a_period(z, late) is None


def triangle(rows: int, ways: int = 8) -> Array:
    """Ways up and down between 40 and 60 degC."""
    return np.asarray(50.0 + 10.0 * (2.0 / np.pi) * np.arcsin(np.sin(np.arange(rows) * ways * np.pi / rows)))


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
    told, even = np.ones(4000, dtype=np.bool_), Wandering(np.ones(4000), np.ones(4000))
    found, chance = (agreement(film_degC, left, even, told, 0.5)[0] for left in (again, once))
    assert found.share > 0.9
    assert found.deviations > 10.0
    assert abs(chance.deviations) < 4.0
    assert abs(chance.share) < 0.3


@pytest.mark.parametrize("seed", range(5))
def test_few_jumps_between_rows_far_apart_are_told(seed: int) -> None:
    """A film of twenty domains, one of a decade, in rows some 0.2 K apart of which every fourth block is held out,
    beside a smooth film that follows the large one in so little that few passes have a row there. A walk in time that
    the same domains would explain as well does not come again."""
    rows, rng = 1590, np.random.default_rng(seed)
    film_degC = triangle(rows, 16)
    rising, left, smooth = np.gradient(film_degC) > 0.0, np.zeros(rows), np.zeros(rows)
    for way in (True, False):
        places, sizes = rng.uniform(42.0, 58.0, 20), np.append(0.02 * rng.lognormal(0.0, 0.5, 19), 1.0)
        widths_K = np.append(np.full(19, 0.5), 0.05)
        film = np.sum(sizes * (film_degC[:, None] > places), axis=1)
        like_it = np.sum(sizes * 0.5 * (1.0 + np.tanh((film_degC[:, None] - places) / widths_K)), axis=1)
        left[rising == way], smooth[rising == way] = (film - like_it)[rising == way], like_it[rising == way]
    moved_K, changed = (np.abs(np.diff(v, prepend=v[:1])) for v in (film_degC, smooth))
    walk, noise = Wandering(np.exp(-moved_K / 0.3), 0.02 * changed), np.full(rows, 0.002)
    told = np.arange(rows) // 25 % 4 != 3
    fitted = np.flatnonzero(told)
    once = np.zeros(rows)
    for k in range(1, rows):
        once[k] = walk.keep[k] * once[k - 1] + np.sqrt(walk.added[k]) * rng.standard_normal()
    readings = ((each + noise * rng.standard_normal(rows))[fitted] for each in (left, once))
    found, chance = (agreement(film_degC, walk.smoothed(r, fitted, noise[fitted]), walk, told, 0.05) for r in readings)
    assert found[1].share > 0.3
    assert found[1].deviations > 10.0
    for by_chance in chance:
        assert abs(by_chance.deviations) < 4.0
        assert abs(by_chance.share) < 0.3
