"""Learning keeps what repeats and leaves the noise: on errors of which both are known."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.control.repetition import above_noise, corrected_reference

ROWS, PERIOD_S, NOISE = 6000, 0.1, 0.002


def _slow(seed: int) -> np.ndarray:
    """An error as a model leaves it: bumps of some 10 s."""
    random, time = np.random.default_rng(seed), np.arange(ROWS) * PERIOD_S
    at, size = random.uniform(0, ROWS * PERIOD_S, 30), 0.002 * random.standard_normal(30)
    return np.sum([s * np.exp(-(((time - t) / 8.0) ** 2)) for t, s in zip(at, size, strict=True)], axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_what_repeats_is_kept_and_noise_is_not(seed: int) -> None:
    slow, noise = _slow(seed), NOISE * np.random.default_rng(100 + seed).standard_normal(ROWS)
    found = above_noise(slow + noise)
    assert np.std(found - slow) < 0.2 * NOISE
    assert np.std(found - slow) < 0.35 * np.std(slow)
    assert np.std(above_noise(noise)) < 0.08 * NOISE


def test_repetitions_come_near_and_stay() -> None:
    """A loop that does what its reference says, less a disturbance that repeats: the error falls and does not grow."""
    slow, random = _slow(7), np.random.default_rng(7)
    correction, errors = np.zeros(ROWS), []
    for _ in range(12):
        true = slow - correction
        errors.append(np.std(true))
        correction = corrected_reference(correction, true + NOISE * random.standard_normal(ROWS))
    assert errors[2] < 0.4 * errors[0]
    assert max(errors[3:]) < 0.4 * errors[0]


def test_gaps_and_too_few_readings() -> None:
    slow = _slow(3)
    error = slow + NOISE * np.random.default_rng(3).standard_normal(ROWS)
    error[1000:1200] = np.nan
    assert np.std(above_noise(error) - slow) < 0.5 * np.std(slow)
    assert not np.any(above_noise(np.full(50, 0.1)))
    assert not np.any(above_noise(np.full(500, np.nan)))
