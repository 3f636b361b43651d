"""What may be said: how much the rows that no fit has seen may speak against an effect."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.diagnosis.judge.verdict import SPEAKS_AGAINST, WEAK, largest_loss_by_chance
from sim.diagnosis.report.warnings import as_late_as_each_other
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched

DRAWS = 200_000


def gains(mean: float, changed: float) -> np.ndarray:
    """Log-likelihood gained by rows that change by so much: the noise alone scatters it by the root of that."""
    return mean + np.sqrt(changed) * np.random.default_rng(7).standard_normal(DRAWS)


@pytest.mark.parametrize("changed", [4.0, 16.0, 60.0])
def test_one_real_effect_in_a_hundred_is_refused_where_the_rest_predicts_as_well(changed: float) -> None:
    refused = np.mean(gains(0.0, changed) < -largest_loss_by_chance(WEAK - 1.0, changed))
    assert 0.005 < refused < 0.011
    assert np.mean(gains(0.5 * changed, changed) < -largest_loss_by_chance(WEAK - 1.0, changed)) < 0.006


def test_what_makes_many_rows_worse_is_refused() -> None:
    assert np.mean(gains(-30.0, 60.0) < -largest_loss_by_chance(WEAK - 1.0, 60.0)) > 0.9


def test_much_evidence_may_lose_a_share() -> None:
    assert largest_loss_by_chance(2000.0, 50.0) == pytest.approx(SPEAKS_AGAINST * 2000.0)
    assert largest_loss_by_chance(WEAK - 1.0, 50.0) < 20.0


@pytest.mark.parametrize(("film_s", "told"), [(0.56, True), (0.9, False)])
def test_lags_that_are_alike_may_be_one_before_the_plate(film_s: float, told: bool) -> None:
    lags = ("sensor_lag", 0.55), ("film_lag", film_s)
    ends = [SimpleNamespace(effects=[switched(catalogue()[name], [tau_s])]) for name, tau_s in lags]
    chain: Any = SimpleNamespace(fits=lambda names: ends)
    found = as_late_as_each_other(chain, frozenset({"sensor_lag", "film_lag"}))
    assert [warning.code for warning in found] == ["lags_alike"] * told
