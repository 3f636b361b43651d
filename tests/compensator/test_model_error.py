"""What a model lacks, out of noisy readings of a run that is over: on errors of which both parts are known."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.control.estimator import model_error

ROWS, NOISE = 6000, 0.002


def _walk(seed: int, over_a_length: float) -> tuple[np.ndarray, np.ndarray]:
    """(a random walk along a course of ramps and dwells, the course's steps)."""
    random = np.random.default_rng(seed)
    steps = np.where(np.arange(ROWS) // 600 % 2 == 0, 0.001, 0.0)
    return np.cumsum(over_a_length * np.sqrt(steps / 0.05) * random.standard_normal(ROWS)), steps


@pytest.mark.parametrize("seed", range(3))
def test_an_error_is_found_to_what_both_sides_tell(seed: int) -> None:
    true, steps = _walk(seed, 0.004)
    found = model_error(true + NOISE * np.random.default_rng(100 + seed).standard_normal(ROWS), steps)
    moving = steps > 0.0
    walk2, noise2 = 0.004**2 * 0.001 / 0.05, NOISE**2
    bound = np.sqrt(0.5 * walk2 * noise2 / np.sqrt(walk2 * noise2 + 0.25 * walk2**2))  # of an endless walk, smoothed
    assert np.std((found - true)[moving]) < 1.15 * bound
    assert np.std((found - true)[~moving]) < 0.3 * NOISE


@pytest.mark.parametrize("scale", [1.0, 750.0])
def test_noise_alone_teaches_next_to_nothing_in_whatever_unit(scale: float) -> None:
    _, steps = _walk(0, 0.0)
    noise = scale * NOISE * np.random.default_rng(5).standard_normal(ROWS)
    assert np.std(model_error(noise, scale * steps)) < 0.1 * scale * NOISE


def test_repetitions_add_what_is_left() -> None:
    true, steps = _walk(7, 0.004)
    known, left = np.zeros(ROWS), []
    for k in range(4):
        left.append(float(np.std(true - known)))
        known = known + model_error(true - known + NOISE * np.random.default_rng(k).standard_normal(ROWS), steps)
    assert left[1] < 0.3 * left[0]
    assert left[3] < 1.05 * left[1]


def test_gaps_and_too_few_readings() -> None:
    true, steps = _walk(3, 0.004)
    off = true + NOISE * np.random.default_rng(3).standard_normal(ROWS)
    off[:50] = off[1000:1100] = np.nan
    found = model_error(off, steps)
    assert np.all(np.isfinite(found))
    assert np.std(found - true) < 0.8 * NOISE
    assert not np.any(model_error(np.full(50, 0.1), steps[:50]))
    assert not np.any(model_error(np.full(500, np.nan), steps[:500]))
