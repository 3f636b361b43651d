"""Records with two or three hidden effects: these are named, and no other."""

from __future__ import annotations

import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.search.chain import temperature_search
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import case
from tests.diagnosis.said import covered, names


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


@pytest.mark.long
def test_a_thermometer_slower_than_the_plate_is_not_taken_for_the_plate() -> None:
    """Plate of 14 s, thermometer of 27.5 s: in each other's place they explain all but what is not linear."""
    blind = case("three", 8007)
    record = read_columns(blind.columns, held_out=False)
    search = temperature_search(record, catalogue())
    fit = search.fit(frozenset({"sensor_lag", "actuator_deadband"}))
    found = {e.name: float(e.par[0]) for e in fit.effects}
    assert found["sensor_lag"] == pytest.approx(blind.hidden["sensor_lag"]["tau_s"], rel=1e-3)
    assert 2.0 * fit.minus_log < 1.05 * search.channel.rows.size
