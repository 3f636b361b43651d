"""Records with two or three hidden effects: these are named, and no other."""

from __future__ import annotations

import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case
from tests.sim.diagnosis.said import covered, names


def test_two_hidden_effects() -> None:
    blind = case("two", 1, effects=("sensor_lag", "film_lag"), rows=800)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden)
    covered(document, blind)


@pytest.mark.long
def test_a_resistance_that_relays_may_stand_in_for() -> None:
    """With the memory at the first row that fits best without the series resistance, relays do its work."""
    blind = case("two", 9000)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden)


@pytest.mark.long
def test_two_resistances_that_bend_the_reading_against_each_other() -> None:
    """Neither shows alone: D takes both."""
    blind = case("three", 1701)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"sensor_lag", "series_resistance", "parallel_leakage"}
    covered(document, blind)
