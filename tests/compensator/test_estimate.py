"""The law's estimates: noise is measured, a model is believed as far as it is right, nothing turns round for noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.estimate import UNSTEADY_K_PER_S2, Estimate, corrected_disturbance, corrected_temperature
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import TEN_OPERATORS as FILM

PLATE = PlateModel(1.67e-3, 0.067, 0.0167, 25.0)
PERIOD_S, NOISE_K, NOISE_DEC = 0.1, 0.01, 0.002


@pytest.mark.parametrize("noise_K", [0.002, 0.01, 0.05])
@pytest.mark.parametrize("lag_s", [0.0, 2.0])
def test_noise_is_measured_on_a_moving_plate_and_averaged_away(noise_K: float, lag_s: float) -> None:
    """A thermometer behind the plate, too: the plate is known, not what it shows."""
    state, chance, off = Estimate(), np.random.default_rng(1), []
    degC = shown = lagged = 40.0
    follows = 1.0 - math.exp(-PERIOD_S / lag_s) if lag_s > 0.0 else 1.0
    for k in range(2000):
        truth = 40.0 + 0.1 * (k + 1) * PERIOD_S
        lagged = truth - 0.1 * lag_s * (1.0 - math.exp(-(k + 1) * PERIOD_S / lag_s)) if lag_s > 0.0 else truth
        before, degC = degC, degC + (0.08 + state.drift_K_per_s) * PERIOD_S
        shown += follows * (before - shown) + (PERIOD_S - lag_s * follows) * (degC - before) / PERIOD_S
        reading = lagged + noise_K * chance.standard_normal()
        shown, degC, state = corrected_temperature(state, shown, degC, reading, PERIOD_S, lag_s)
        off.append(degC - truth)
    assert math.sqrt(state.degC.variance) == pytest.approx(noise_K, rel=0.15)
    assert np.std(off[800:]) < (0.5 if lag_s == 0.0 else 1.0) * noise_K
    assert abs(np.mean(off[800:])) < 0.1 * noise_K  # the heating that no model knew, 0.02 K/s, was learned


def test_without_a_lag_the_gains_settle_at_the_alpha_beta_filter_s() -> None:
    """Kalata's eqs (14) and (17), for the noise that was learned."""
    state, chance = Estimate(), np.random.default_rng(7)
    for _ in range(3000):
        _, _, state = corrected_temperature(state, 0.0, 0.0, NOISE_K * chance.standard_normal(), PERIOD_S, 0.0)
    for _ in range(300):  # the noise as it is: readings on a straight line change nothing of it
        state = state._replace(degC=state.degC._replace(last=math.nan, before=math.nan))
        _, _, state = corrected_temperature(state, 0.0, 0.0, 0.0, PERIOD_S, 0.0)
    index = UNSTEADY_K_PER_S2 * PERIOD_S**2 / math.sqrt(state.degC.variance)
    root = 0.25 * (4.0 + index - math.sqrt(8.0 * index + index**2))
    alpha = 1.0 - root**2
    beta = 2.0 * (2.0 - alpha) - 4.0 * math.sqrt(1.0 - alpha)
    plain = state._replace(drift_K_per_s=0.0, degC=state.degC._replace(last=math.nan, before=math.nan))
    _, degC, after = corrected_temperature(plain, 0.0, 0.0, 1.0, PERIOD_S, 0.0)
    assert degC == pytest.approx(alpha, rel=1e-3)
    assert after.drift_K_per_s * PERIOD_S == pytest.approx(beta, rel=1e-3)


@pytest.mark.parametrize(("error_dec", "least", "most"), [(0.0, 0.0, 0.001), (0.004, 0.001, 0.003)])
def test_the_model_s_error_is_learned_along_the_course(error_dec: float, least: float, most: float) -> None:
    """A sine of 0.004 with 1 rad a length changes by 0.0027 RMS over each: a random walk of 0.0019."""
    state, chance, found, course = Estimate(), np.random.default_rng(2), 0.0, 0.0
    off = []
    for _ in range(4000):
        course += 0.001
        truth = error_dec * math.sin(course / 0.05)
        reading = truth + NOISE_DEC * chance.standard_normal()
        found, state = corrected_disturbance(state, found, reading, 4.0 + reading, 0.001, PERIOD_S, 1.0)
        off.append(found - truth)
    assert math.sqrt(state.output.variance) == pytest.approx(NOISE_DEC, rel=0.15)
    assert least <= math.sqrt(state.model_error2) <= most
    assert np.std(off[1000:]) < NOISE_DEC * (0.2 if error_dec == 0.0 else 0.7)


def test_a_model_that_is_right_is_soon_believed() -> None:
    """Half of the changes over a length are less than their own noise: cut at zero, they would speak for an error."""
    errors = []
    for seed in range(5):
        state, chance, found = Estimate(), np.random.default_rng(seed), 0.0
        for _ in range(4000):  # 80 lengths
            reading = NOISE_DEC * chance.standard_normal()
            found, state = corrected_disturbance(state, found, reading, 4.0 + reading, 0.001, PERIOD_S, 1.0)
        errors.append(math.sqrt(state.model_error2))
    assert np.median(errors) < 0.1 * NOISE_DEC


def test_a_film_that_stands_still_is_known_better_and_better() -> None:
    state, chance, found = Estimate(), np.random.default_rng(3), 0.0
    doubts = []
    for _ in range(600):
        reading = 0.01 + NOISE_DEC * chance.standard_normal()
        found, state = corrected_disturbance(state, found, reading, reading, 0.0, PERIOD_S, 1.0)
        doubts.append(state.doubt)
    assert doubts[-1] < doubts[100] < doubts[10]
    assert found == pytest.approx(0.01, abs=4.0 * math.sqrt(doubts[-1]))


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
    return Law(LawSettings("full", PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 0.05, 0.2, 1.0)), PLATE, FILM)


def test_a_ramp_is_not_followed_a_band_behind() -> None:
    targets = np.concatenate((np.full(100, -4.2), np.linspace(-4.2, -3.7, 1000), np.full(300, -3.7)))
    outputs, _ = course(full(), targets, 4)
    assert np.sqrt(np.mean((outputs - targets)[200:] ** 2)) < 0.4 * NOISE_DEC


def test_noise_turns_no_film_round() -> None:
    """To turn round it would have to cross its loop, which is kelvins wide; it stays within a fraction of one."""
    outputs, references = course(full(), np.full(1500, -4.0), 5)
    assert np.ptp(references[300:]) < 0.3
    assert np.max(np.abs(outputs[300:] + 4.0)) < NOISE_DEC
