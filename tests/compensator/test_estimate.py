"""The law's estimate of the temperature, its noise measured, and what it does for a film: noise turns none round."""

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
    initial_heats,
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
