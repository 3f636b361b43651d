"""One sparse loop of a film whose branches are shifted copies: held-out rows are told, and nobody is blamed."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.extended_model import extended_model
from sim.diagnosis.fit.channel_noise import ohmmeter_noise
from sim.diagnosis.result import Diagnosis


def grains(degC: np.ndarray) -> np.ndarray:
    """log10 R of grains in parallel: steep towards the metal, flat towards the insulator."""
    share = 1.0 / (1.0 + np.exp(-(degC - 65.0) / 1.6))
    conductance = 1e-6 + 0.015 * share**3 + 2e-5 * share
    return np.asarray(-np.log10(conductance))


def once_round(low_degC: float) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures from 95 degC down and up again, and on which branch each is: -1 cooling, 1 heating."""
    up = np.arange(low_degC, 95.0, 0.6)
    degC = np.concatenate((up[::-1], up[1:]))
    return degC, np.where(np.arange(degC.size) < up.size, -1.0, 1.0)


def diagnosed(degC: np.ndarray, log_ohm: np.ndarray, seed: int, **options: Any) -> Diagnosis:
    """Of a record with a meter's noise."""
    noise_dec = np.where(log_ohm > 3.5, 3e-5, 8e-4)
    log_ohm = log_ohm + noise_dec * np.random.default_rng(seed).standard_normal(degC.size)
    time_s = 4.6 * np.arange(degC.size)
    columns = {"time_s": time_s, "temperature_degC": degC, "resistance_ohm": 10.0**log_ohm}
    return diagnose(columns, **options)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    degC, side = once_round(40.0)
    return diagnosed(degC, grains(degC - 2.5 * side) - 0.012 * (degC - 65.0), 2)


@pytest.fixture(scope="module")
def said(found: Diagnosis) -> dict[str, object]:
    return found.document()


def test_nobody_is_blamed(said: dict[str, object]) -> None:
    assert said["effects"] == []
    assert said["verdict"] in ("too_short", "clean")


def test_no_reading_is_left_out_for_what_a_model_is_off_by(said: dict[str, object]) -> None:
    rules = {left["rule"] for left in said["rows"]["left_out"]}  # type: ignore[index]
    assert not any("neighbours" in rule for rule in rules)


def test_held_out_rows_are_told(said: dict[str, object]) -> None:
    assert said["channels"]["resistance_dec"]["rmse_extended"] < 0.02  # type: ignore[index]


def test_a_base_without_d_has_none_where_there_was_no_time_to_ask(found: Diagnosis) -> None:
    degC, side = once_round(40.0)
    late = {"budget_s": 10.0, "clock": itertools.count(0.0, 100.0).__next__}
    bare = diagnosed(degC, grains(degC - 2.5 * side) - 0.012 * (degC - 65.0), 2, base="generalized_pi", **late)
    assert "memoryless_not_asked" in [w.code for w in bare.warnings]
    for one, has in ((found, True), (bare, False)):
        film = extended_model(one).film
        assert film is not None
        assert (film.memoryless.function != "none") == has


def test_the_noise_is_that_of_fitted_rows(found: Diagnosis) -> None:
    """Between them a model that has a column for each is off by a flank's curvature, which is no noise."""
    names = frozenset(one.name for one in found.findings)
    channel, fit = found.chain.film_channel(names), found.chain.fits(names)[1]
    assert fit is not None
    assert fit.parameters.has_relays
    held_out = channel.record.output_used & ~channel.fitted
    assert np.any(held_out)
    elsewhere = replace(channel, output=channel.output + 0.1 * held_out * np.sin(np.arange(channel.record.rows)))
    of_both = [ohmmeter_noise(each, fit, 1e-5, None) for each in (channel, elsewhere)]
    np.testing.assert_array_equal(of_both[0].deviations, of_both[1].deviations)


def test_branches_that_meet_at_the_ends_alone_are_told_too() -> None:
    degC, side = once_round(20.0)
    kinds = ((66.0, 1.8, 1.2, 0.55), (70.0, 1.8, 1.2, 0.4), (60.0, 8.0, 8.0, 0.05))  # the last: tails, like the films
    share = sum(part * ndtr((degC - c_degC - h_K * side) / spread_K) for c_degC, h_K, spread_K, part in kinds)
    said = diagnosed(degC, (5.9 - 0.018 * (degC - 20.0)) * (1.0 - share) + 1.9 * share, 0).document()
    assert said["channels"]["resistance_dec"]["rmse_extended"] < 0.008  # type: ignore[index]
