"""The discrepancy of a film over its memory: what comes again at each pass over the same domains."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.inference.joint.domains import Relays, domain_columns
from sim.inference.noise import Noise, Readings, Repeated, Whitening, estimate_repeated
from sim.model.film_nodes import FilmNodes

PARTS = (40, 6)


def nodes_along(degC: Array) -> FilmNodes:
    """A record of these temperatures, one a second, of a film that comes from the cold."""
    rows = np.arange(degC.size)
    side = np.append(np.int8(2), np.sign(np.diff(degC))).astype(np.int8)
    return FilmNodes(rows.astype(np.float64), degC, side, rows, (), rows, rows)


def cycles() -> Array:
    """Loops of two sizes through a transition at 60 degC, 0.2 K a row."""
    corners = [45.0, 75.0, 45.0, 66.0, 55.0, 66.0, 55.0, 75.0, 45.0]
    along = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(corners)))))
    return np.interp(np.arange(0.0, along[-1], 0.2), along, corners)


def drawn(rng: np.random.Generator, count: int) -> Relays:
    centre, half_width = rng.normal(60.0, 3.0, count), np.abs(rng.normal(3.0, 1.0, count))
    return Relays(centre + half_width, centre - half_width, np.full(count, 2.0 / count))


def states(relays: Relays, degC: Array) -> Array:
    """-1/2 or 1/2 of each relay in each row, (rows, relays), one after the other."""
    out, on = np.empty((degC.size, relays.weight.size)), relays.up_degC <= degC[0]
    for k, here in enumerate(degC):
        on = (on & (relays.down_degC < here)) | (relays.up_degC <= here)
        out[k] = on - 0.5
    return out


def test_columns_and_what_they_leave_are_the_covariance_of_domains() -> None:
    """Else a second pass over the same domains counts as new evidence, or another pass as the same."""
    relays, degC = drawn(np.random.default_rng(1), 4000), cycles()
    columns, rest, _ = domain_columns(relays, nodes_along(degC), PARTS)
    every = states(relays, degC)
    exact = (every * relays.weight) @ every.T
    found = columns @ columns.T + np.diag(rest)
    assert np.all(np.diag(found) > (1.0 - 1e-9) * np.diag(exact))
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.04 * exact[0, 0]


def test_whitening_of_what_comes_again_is_its_covariances_inverse() -> None:
    """Else evidence and fits use another noise than the one that was estimated."""
    rng = np.random.default_rng(2)
    repeated = Repeated(rng.standard_normal((50, 7)), rng.uniform(0.0, 0.5, 50), 1.0)
    noise, readings = Noise(0.5, 0.3, 8.0, 0.7), Readings.at(np.arange(50.0))
    distance = np.abs(np.subtract.outer(readings.time_s, readings.time_s)) / 4.0
    covariance = np.diag(0.25 + 0.7 * repeated.rest) + 0.7 * repeated.columns @ repeated.columns.T
    covariance += 0.09 * (1.0 + distance) * np.exp(-distance)
    columns = rng.standard_normal((50, 3))
    white = Whitening(noise, readings, repeated)
    np.testing.assert_allclose(
        white.of(columns).T @ white.of(columns), columns.T @ np.linalg.solve(covariance, columns)
    )
    assert white.log_scale == pytest.approx(-0.5 * np.linalg.slogdet(covariance)[1])


def test_size_of_domains_and_the_noise_beside_them_are_estimated() -> None:
    """Else a clean film of domains is reported as unexplained, or its ohmmeter as noisier than it is."""
    rng = np.random.default_rng(3)
    smooth, degC = drawn(rng, 20_000), np.tile(cycles(), 2)
    few = drawn(rng, 2000)
    residual = states(few, degC) @ few.weight - states(smooth, degC) @ smooth.weight
    columns, rest, lasts_s = domain_columns(smooth, nodes_along(degC), PARTS)
    readings, noise = Readings.at(np.arange(float(degC.size))), Noise(0.01)
    for _ in range(3):
        readings_dec = residual + 0.002 * np.random.default_rng(4).standard_normal(degC.size)
        noise, _ = estimate_repeated(readings_dec, readings, Repeated(columns, rest, lasts_s), noise, 1e-4, 1.0)
    assert noise.step == pytest.approx(2.0 / 2000, rel=0.3)
    assert noise.white == pytest.approx(0.002, rel=0.2)
    assert noise.slow == 0.0


def test_where_nothing_comes_again_its_size_is_next_to_nothing() -> None:
    """Else a diagnosis ends in a traceback, or what an unknown fault does once is taken for a film's domains."""
    degC = cycles()
    columns, rest, lasts_s = domain_columns(drawn(np.random.default_rng(3), 5000), nodes_along(degC), PARTS)
    white = 0.002 * np.random.default_rng(4).standard_normal(degC.size)
    noise = Noise(0.01)
    for _ in range(3):
        repeated = Repeated(columns, rest, lasts_s)
        noise, mean = estimate_repeated(white, Readings.at(np.arange(float(degC.size))), repeated, noise, 1e-4, 1.0)
    assert noise.white == pytest.approx(0.002, rel=0.1)
    assert np.std(mean) < 0.2 * noise.white
