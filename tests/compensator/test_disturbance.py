"""What the film model lacks, as the law takes it on the way, and out of the readings of a run that is over."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.estimator import disturbance_of, errors_after, errors_later, initial_errors, model_error
from compensator.hysteresis.functions import Array

PERIOD_S, NOISE, RANGE, MOVED = 0.1, 0.002, 2.0, 0.001  # decades, of a film that moves by 0.01 a second


def followed(truth: Array, readings: Array, noise: float = NOISE, output_range: float = RANGE) -> Array:
    """The disturbance after each reading."""
    errors, found = initial_errors(output_range).copy(), []
    for off in readings:
        errors = errors_later(errors, output_range, MOVED / RANGE * output_range, PERIOD_S)
        errors = errors_after(errors, float(off), noise**2, 1.0)
        found.append(disturbance_of(errors)[0])
    return np.array(found) - truth


def known(truth: Array, readings: Array, size: float) -> Array:
    """The same by one Kalman filter that is told the size, over the whole range, of the error."""
    value, doubt, found = 0.0, size**2, []
    for off in readings:
        doubt += size**2 * MOVED / RANGE
        share = doubt / (doubt + NOISE**2)
        value, doubt = value + share * (off - value), (1.0 - share) * doubt
        found.append(value)
    return np.array(found) - truth


def walked(size: float, seed: int, count: int = 3000) -> tuple[Array, Array]:
    """(the model's error, readings) of a film whose model is off by that over its whole range."""
    chance = np.random.default_rng(seed)
    truth = size * (chance.standard_normal() + np.cumsum(chance.standard_normal(count)) * math.sqrt(MOVED / RANGE))
    return truth, truth + NOISE * chance.standard_normal(count)


@pytest.mark.parametrize("size", [0.0, 0.0005, 0.004, 0.03, 0.15])
def test_it_is_as_good_as_a_filter_that_knows_the_size_of_the_error(size: float) -> None:
    off, best = [], []
    for seed in range(6):
        truth, readings = walked(size, seed)
        off.append(np.sqrt(np.mean(followed(truth, readings) ** 2)))
        best.append(np.sqrt(np.mean(known(truth, readings, size) ** 2)))
    assert np.median(off) < 1.1 * np.median(best) + 0.06 * NOISE


def test_a_model_that_goes_off_late_is_followed() -> None:
    """Right over three times the range, off by a tenth of it from then on."""
    right = np.zeros(6000)
    truth, _ = walked(0.2, 3)
    truth = np.concatenate((right, truth - truth[0]))
    readings = truth + NOISE * np.random.default_rng(8).standard_normal(truth.size)
    off = followed(truth, readings)
    assert np.sqrt(np.mean(off[200:6000] ** 2)) < 0.1 * NOISE
    assert np.sqrt(np.mean(off[6300:] ** 2)) < 1.1 * np.sqrt(np.mean(known(truth, readings, 0.2)[6300:] ** 2))


@pytest.mark.parametrize("size", [0.004, 0.03])
def test_its_doubt_is_what_it_is_off(size: float) -> None:
    off, doubts = [], []
    for seed in range(8):
        truth, readings = walked(size, seed)
        errors = initial_errors(RANGE).copy()
        for at, reading in zip(truth, readings, strict=True):
            errors = errors_after(errors_later(errors, RANGE, MOVED, PERIOD_S), float(reading), NOISE**2, 1.0)
            value, doubt = disturbance_of(errors)
            off.append(value - at)
            doubts.append(doubt)
    assert 0.7 < np.mean(np.square(off)) / np.mean(doubts) < 1.4


def test_it_goes_by_the_output_s_range_not_by_its_unit() -> None:
    truth, readings = walked(0.02, 4, 800)
    in_another_unit = followed(1e3 * truth, 1e3 * readings, 1e3 * NOISE, 1e3 * RANGE)
    assert in_another_unit == pytest.approx(1e3 * followed(truth, readings), abs=1e-4)


def test_one_reading_counts_for_no_more_than_is_said() -> None:
    errors = errors_after(initial_errors(RANGE).copy(), 0.1, NOISE**2, 0.35)
    assert disturbance_of(errors)[0] <= 0.35 * 0.1


ROWS = 6000


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
