"""What the film model lacks, as the law takes it: as good as with a known size of it, whatever that is, in any unit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.estimator import disturbance_of, errors_after, errors_later, initial_errors, with_disturbance
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


def test_a_film_that_stands_still_is_known_better_and_better() -> None:
    errors, doubts, chance = initial_errors(RANGE).copy(), [], np.random.default_rng(3)
    for _ in range(600):
        errors = errors_after(
            errors_later(errors, RANGE, 0.0, PERIOD_S), 0.01 + NOISE * chance.standard_normal(), NOISE**2, 1.0
        )
        doubts.append(disturbance_of(errors)[1])
    assert doubts[-1] < doubts[100] < doubts[10]
    assert disturbance_of(errors)[0] == pytest.approx(0.01, abs=4.0 * math.sqrt(doubts[-1]))


def test_it_goes_by_the_output_s_range_not_by_its_unit() -> None:
    truth, readings = walked(0.02, 4, 800)
    in_another_unit = followed(1e3 * truth, 1e3 * readings, 1e3 * NOISE, 1e3 * RANGE)
    assert in_another_unit == pytest.approx(1e3 * followed(truth, readings), abs=1e-4)


def test_one_reading_counts_for_no_more_than_is_said() -> None:
    errors = errors_after(initial_errors(RANGE).copy(), 0.1, NOISE**2, 0.35)
    assert disturbance_of(errors)[0] <= 0.35 * 0.1


def test_a_mean_that_was_told_otherwise_keeps_its_doubt() -> None:
    errors = initial_errors(RANGE).copy()
    for off in (0.01, 0.012, 0.009):
        errors = errors_after(errors_later(errors, RANGE, MOVED, PERIOD_S), off, NOISE**2, 1.0)
    mean, doubt = disturbance_of(with_disturbance(errors, 0.05))
    assert mean == pytest.approx(0.05)
    assert doubt == pytest.approx(disturbance_of(errors)[1])
