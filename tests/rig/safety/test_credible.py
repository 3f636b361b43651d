"""Readings that are none: frozen and jumping ones are found, quiet and coarse instruments are left alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from rig.core.reading import Quality, Reading
from rig.safety.bench_watch import OhmmeterCheck, ThermometerCheck

NOISE = np.random.default_rng(2).standard_normal(2000).tolist()


def judged(
    temperature: Callable[[int], float], current_A: Callable[[int], float], limit_A: float = 3.0
) -> tuple[list[Quality], list[str]]:
    trust = ThermometerCheck(5.0, limit_A)
    found = [trust.judge(Reading(temperature(k), 0.1 * k), current_A(k), math.nan) for k in range(600)]
    return [reading.quality for reading, _ in found], [why for _, why in found]


def test_a_noisy_thermometer_that_freezes() -> None:
    quality, why = judged(lambda k: 40.0 + 0.005 * NOISE[min(k, 300)], lambda k: 1.0)
    assert set(quality[:309]) == {Quality.OK}
    assert set(quality[309:]) == {Quality.STALE}
    assert "frozen at 4" in why[-1]
    assert "frozen at" in why[-1]


def test_a_thermometer_that_rounds_its_noise_freezes_too() -> None:
    """One reading in four is that before it; so it takes more of them."""
    quality, _ = judged(lambda k: round(40.0 + 0.01 * NOISE[min(k, 300)], 2), lambda k: 1.0)
    assert set(quality[:309]) == {Quality.OK}
    assert set(quality[330:]) == {Quality.STALE}


def test_a_thermometer_that_was_still_on_a_ramp_only_a_moment_ago_freezes_in_the_hold() -> None:
    quality, _ = judged(lambda k: 40.0 + 0.1 * min(k, 250) + 0.01 * NOISE[min(k, 400)], lambda k: 1.0)
    assert set(quality[:409]) == {Quality.OK}
    assert set(quality[411:]) == {Quality.STALE}


@pytest.mark.parametrize("noise_K", [0.002, 0.02, 0.08])
def test_a_coarse_thermometer_beside_a_threshold_is_not_frozen_away_from_it(noise_K: float) -> None:
    """It flickers between two numbers, then the plate moves by half a step and stays there."""
    quality, _ = judged(
        lambda k: 0.25 * round((40.125 + 0.005 * min(max(k - 200, 0), 25) + noise_K * NOISE[k]) / 0.25), lambda k: 1.0
    )
    assert set(quality) == {Quality.OK}


def test_it_thaws() -> None:
    quality, _ = judged(lambda k: 40.0 + 0.005 * NOISE[k if k < 300 or k > 330 else 300], lambda k: 1.0)
    assert quality[320] is Quality.STALE
    assert set(quality[331:]) == {Quality.OK}


@pytest.mark.parametrize("step_K", [0.01, 0.25])
def test_a_coarse_thermometer_in_a_long_hold_is_not_frozen(step_K: float) -> None:
    """It says the same for a minute, while the law keeps it there with a current that trembles."""
    quality, _ = judged(
        lambda k: round((40.0 + (0.05 * k if k < 100 else 5.0)) / step_K) * step_K, lambda k: 1.0 + 0.05 * NOISE[k]
    )
    assert set(quality) == {Quality.OK}


def test_a_coarse_thermometer_that_stays_while_current_flows() -> None:
    quality, _ = judged(lambda k: round((40.0 + 0.02 * min(k, 300)) / 0.25) * 0.25, lambda k: 1.0 if k < 300 else 3.0)
    assert set(quality[:300]) == {Quality.OK}
    assert quality[-1] is Quality.STALE


def test_a_simulation_without_noise_in_a_hold_is_not_frozen() -> None:
    quality, _ = judged(lambda k: 40.0 + max(0.0, 1.0 - 0.01 * k), lambda k: 1.0)
    assert set(quality) == {Quality.OK}


def test_a_single_jump_is_no_reading_and_a_lasting_one_neither() -> None:
    quality, why = judged(lambda k: 40.0 + 0.005 * NOISE[k] + 300.0 * (k == 200), lambda k: 1.0)
    assert [k for k in range(600) if quality[k] is not Quality.OK] == [200]
    assert "340." in why[200]
    quality, _ = judged(lambda k: 40.0 + 0.005 * NOISE[k] - 15.0 * (k >= 200), lambda k: 1.0)
    assert set(quality[200:215]) == {Quality.INVALID}


def test_the_film_may_jump_but_an_outlier_is_none() -> None:
    trust = OhmmeterCheck()
    values = [1e5, 1.01e5, 2.0, 0.99e5, 1e5, 1.1e3, 1.11e3, 1.12e3, 1.1e3]
    quality = [trust.judge(Reading(v, 0.1 * k), 40.0)[0].quality for k, v in enumerate(values)]
    assert quality == [
        *[Quality.OK] * 2,
        Quality.INVALID,
        *[Quality.OK] * 2,
        *[Quality.INVALID] * 2,
        *[Quality.OK] * 2,
    ]


def test_a_frozen_ohmmeter_and_one_that_is_beyond_its_range() -> None:
    trust = OhmmeterCheck()
    found = [trust.judge(Reading(1e4 * (1 + 0.001 * NOISE[min(k, 100)]), 0.1 * k), 40.0)[0] for k in range(200)]
    assert found[100].is_number
    assert {reading.quality for reading in found[109:]} == {Quality.STALE}
    beyond = [trust.judge(Reading(math.inf, 20.0 + k, Quality.OVERRANGE), 40.0)[0] for k in range(100)]
    assert {reading.quality for reading in beyond} == {Quality.OVERRANGE}


def test_a_steady_resistor_with_a_coarse_meter_is_not_frozen() -> None:
    trust = OhmmeterCheck()
    assert all(trust.judge(Reading(1000.0, 0.1 * k), 40.0 + 0.001 * k)[0].is_number for k in range(300))
