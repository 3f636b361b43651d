"""The law's estimates: of the temperature and its noise, and of what the film model lacks, at once and afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from compensator.control.estimator import (
    UNSTEADY_K_PER_S2,
    Estimate,
    Noise,
    Predicted,
    corrected_temperature,
    disturbance_of,
    errors_after,
    errors_later,
    initial_errors,
    initial_heats,
    model_error,
)
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import TEN_OPERATORS as FILM

PLATE = PlateModel(1.67e-3, 0.067, 0.0167, 25.0)
PERIOD_S, NOISE_K, NOISE_DEC = 0.1, 0.01, 0.002
AT_REST = Predicted(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("noise_K", [0.002, 0.01, 0.05])
@pytest.mark.parametrize("lag_s", [0.0, 2.0])
def test_noise_is_measured_on_a_moving_plate_and_averaged_away(noise_K: float, lag_s: float) -> None:
    """A thermometer behind the plate, too: the plate is known, not what it shows."""
    state, heats, chance, off = Estimate(), initial_heats(), np.random.default_rng(1), []
    degC = shown = lagged = 40.0
    follows = 1.0 - math.exp(-PERIOD_S / lag_s) if lag_s > 0.0 else 1.0
    for k in range(2000):
        truth = 40.0 + 0.1 * (k + 1) * PERIOD_S
        lagged = truth - 0.1 * lag_s * (1.0 - math.exp(-(k + 1) * PERIOD_S / lag_s)) if lag_s > 0.0 else truth
        before, shown_before, degC = degC, shown, degC + (0.08 + state.drift_K_per_s) * PERIOD_S
        shown += follows * (before - shown) + (PERIOD_S - lag_s * follows) * (degC - before) / PERIOD_S
        reading = lagged + noise_K * chance.standard_normal()
        shown, degC, state, heats = corrected_temperature(
            state, heats, Predicted(shown, degC, shown_before, before), reading, PERIOD_S, 0.0, lag_s
        )
        off.append(degC - truth)
    assert math.sqrt(state.degC.variance) == pytest.approx(noise_K, rel=0.15)
    assert np.std(off[800:]) < (0.5 if lag_s == 0.0 else 1.0) * noise_K
    assert abs(np.mean(off[800:])) < 0.1 * noise_K  # the heating that no model knew, 0.02 K/s, was learned


@pytest.mark.parametrize("size", UNSTEADY_K_PER_S2)
def test_without_a_lag_the_gains_of_each_size_settle_at_the_alpha_beta_filter_s(size: float) -> None:
    """Kalata's eqs (14) and (17)."""
    state, heats = Estimate(degC=Noise(NOISE_K**2)), initial_heats((size,), (0.0,))
    for _ in range(6000):
        heats = corrected_temperature(state, heats, AT_REST, 0.0, PERIOD_S, 0.0, 0.0)[-1]
    index = size * PERIOD_S**2 / NOISE_K
    root = 0.25 * (4.0 + index - math.sqrt(8.0 * index + index**2))
    alpha = 1.0 - root**2
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    _, degC, after, _ = corrected_temperature(state, heats, AT_REST, 1.0, PERIOD_S, 0.0, 0.0)
    assert degC == pytest.approx(alpha, rel=1e-3)
    assert after.drift_K_per_s * PERIOD_S == pytest.approx(beta, rel=1e-3)


def off_K(
    heats: Array, heat_K_per_s: Callable[[float], float], seed: int, lag_s: float = 0.0, known_K_per_s: float = 0.0
) -> Array:
    """By how much the plate is told wrong. The model knows that it goes up and down for 20 s each, and no lag."""
    state, chance, degC, truth, off = Estimate(), np.random.default_rng(seed), 40.0, 40.0, []
    shown = lagged = 40.0
    for k in range(6000):
        known = known_K_per_s * (-1.0) ** int(k * PERIOD_S / 20.0)
        rate = known + heat_K_per_s(k * PERIOD_S)
        follows = 1.0 - math.exp(-PERIOD_S / lag_s) if lag_s > 0.0 else 1.0
        lagged += follows * (truth - lagged) + (PERIOD_S - lag_s * follows) * rate
        truth += rate * PERIOD_S
        then = degC + (known + state.drift_K_per_s) * PERIOD_S
        reading, there = lagged + NOISE_K * chance.standard_normal(), Predicted(then, then, shown, degC)
        shown, degC, state, heats = corrected_temperature(state, heats, there, reading, PERIOD_S, 0.0, 0.0)
        off.append(degC - truth)
    return np.array(off)


def no_heat(_: float) -> float:
    return 0.0


@pytest.mark.parametrize("lag_s", [0.6, 1.7, 5.0])
def test_a_lag_of_the_thermometer_that_nobody_knows_is_found(lag_s: float) -> None:
    """At 0.1 K/s the plate is 0.1 K/s * lag from what is shown: what is left lies between two supposed lags."""
    mine = off_K(initial_heats(), no_heat, 7, lag_s, 0.1)
    without = off_K(initial_heats(lags_s=(0.0,)), no_heat, 7, lag_s, 0.1)
    assert np.std(mine[1000:]) < 0.2 * 0.1 * lag_s + 0.5 * NOISE_K
    assert np.std(without[1000:]) > 3.0 * np.std(mine[1000:])


def test_a_drive_that_gives_less_than_its_model_is_learned() -> None:
    """A fifth less: told anew at each change of the current as heat that comes and goes, it was late each time."""
    state, heats, chance = Estimate(), initial_heats(), np.random.default_rng(11)
    degC, truth, off = 40.0, 40.0, []
    for k in range(1200):
        driven = 0.5 * math.copysign(1.0, math.sin(0.3 * k * PERIOD_S))
        truth += 0.8 * driven * PERIOD_S
        then = degC + ((1.0 + state.drive_error) * driven + state.drift_K_per_s) * PERIOD_S
        reading, there = truth + NOISE_K * chance.standard_normal(), Predicted(then, then, degC, degC, driven)
        _, degC, state, heats = corrected_temperature(state, heats, there, reading, PERIOD_S, 0.0, 0.0)
        off.append(degC - truth)
    assert state.drive_error == pytest.approx(-0.2, abs=0.005)
    assert np.std(off[300:]) < 0.5 * NOISE_K


def test_nothing_is_lost_by_supposing_lags_where_there_is_none() -> None:
    mine, without = (off_K(heats, no_heat, 7, 0.0, 0.1) for heats in (initial_heats(), initial_heats(lags_s=(0.0,))))
    assert np.std(mine[1000:]) < 1.05 * np.std(without[1000:])


def test_a_plate_whose_heat_is_known_is_told_better_than_by_the_largest_size() -> None:
    errors = [
        [float(np.std(off_K(initial_heats(sizes), no_heat, seed)[1000:])) for seed in range(3)]
        for sizes in (UNSTEADY_K_PER_S2, UNSTEADY_K_PER_S2[-1:])
    ]
    assert np.median(errors[0]) < 0.6 * np.median(errors[1])


def test_a_draught_that_comes_late_is_followed_as_by_the_largest_size() -> None:
    """Heat that turns round each 20 s, after five minutes without any."""

    def heat(time_s: float) -> float:
        return 0.03 * (-1.0) ** int(time_s / 20.0) if time_s > 300.0 else 0.0

    mine, largest = (off_K(initial_heats(sizes), heat, 5) for sizes in (UNSTEADY_K_PER_S2, UNSTEADY_K_PER_S2[-1:]))
    smallest = off_K(initial_heats(UNSTEADY_K_PER_S2[:1]), heat, 5)
    assert np.std(mine[3000:]) < 1.1 * np.std(largest[3000:])
    assert np.std(smallest[3000:]) > 4.0 * np.std(largest[3000:])


def course(law: Law, targets: Array, seed: int) -> tuple[Array, Array]:
    """The film's own output and the reference (degC) at each step, with noise on both readings."""
    chance = np.random.default_rng(seed)
    memory = FILM.initial_memory(80.0, "heated")
    first = Inverse(FILM, 10.0, 95.0).solve(float(targets[0]), memory)
    degC, memory = first.temperature_degC, FILM.step(first.temperature_degC, memory)[1]
    state, rows = law.start(degC, memory), []
    ahead = np.round(law.preview_times_s() / PERIOD_S).astype(int)
    for k in range(targets.size):
        output, memory = FILM.step(degC, memory)
        coming = targets[np.minimum(k + ahead, targets.size - 1)]
        readings = degC + NOISE_K * chance.standard_normal(), output + NOISE_DEC * chance.standard_normal()
        command, state = law.step(state, Inputs(*readings, float(targets[k]), coming))
        degC = PLATE.step(degC, command.current_A, PERIOD_S)
        rows.append((output, command.reference_degC))
    outputs, references = np.array(rows).T
    return outputs, references


def full() -> Law:
    return Law(LawSettings("full", PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0)), PLATE, FILM)


def test_a_ramp_is_not_followed_a_band_behind() -> None:
    targets = np.concatenate((np.full(100, -4.2), np.linspace(-4.2, -3.7, 1000), np.full(300, -3.7)))
    outputs, _ = course(full(), targets, 4)
    assert np.sqrt(np.mean((outputs - targets)[200:] ** 2)) < 0.4 * NOISE_DEC


def test_noise_turns_no_film_round() -> None:
    """To turn round it would have to cross its loop, which is kelvins wide; it stays within a fraction of one."""
    outputs, references = course(full(), np.full(1500, -4.0), 5)
    assert np.ptp(references[300:]) < 0.3
    assert np.max(np.abs(outputs[300:] + 4.0)) < NOISE_DEC


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
