"""A quick set of blind cases; the whole table is `./peltier benchmark diagnosis`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.diagnosis.chain import temperature_search
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.record import read_columns
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import Case, case

ONE = [
    ("sensor_lag", 1),
    ("heat_sink_warmup", 1),
    ("timestamp_skew", 1),
    ("creep", 1),
    ("self_heating", 1),
    ("series_resistance", 1),
    ("meter_lag", 3),  # of 7.6 s: envelopes are not found in what it shows
]


def names(document: dict[str, Any]) -> set[str]:
    return {effect["name"] for effect in document["effects"]}


def covered(document: dict[str, Any], blind: Case, widths: float = 2.0) -> None:
    """True parameters within two half-widths of their interval: four standard deviations."""
    for effect in document["effects"]:
        for name, found in effect["parameters"].items():
            if found["ci95"] is None:
                continue
            low, high = found["ci95"]
            truth = blind.hidden[effect["name"]][name]
            assert low - (widths - 1.0) * (high - low) <= truth <= high + (widths - 1.0) * (high - low), (name, truth)


@pytest.mark.parametrize(("effect", "seed"), ONE)
def test_one_hidden_effect(effect: str, seed: int) -> None:
    blind = case("one", seed, effect=effect)
    document = diagnose(blind.columns).document()
    assert names(document) == {effect}
    assert document["verdict"] == "explained"
    assert document["film"]["of_the_class"]  # no relays have to do what its own envelopes can
    covered(document, blind)
    for channel in document["channels"].values():
        assert channel["rmse_extended"] < 1.15 * channel["noise"]
    assert "outliers" not in {warning["code"] for warning in document["warnings"]}  # of a base that lacks the effect


def test_two_hidden_effects() -> None:
    """With the memory at the first row that fits best without the series resistance, relays do its work."""
    blind = case("two", 9000)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden)


def test_two_resistances_that_bend_the_reading_against_each_other() -> None:
    """Neither shows alone: D takes both."""
    blind = case("three", 1701)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"sensor_lag", "series_resistance", "parallel_leakage"}
    covered(document, blind)


def test_a_thermometer_slower_than_the_plate_is_not_taken_for_the_plate() -> None:
    """Plate of 14 s, thermometer of 27.5 s: in each other's place they explain all but what is not linear."""
    blind = case("three", 8007)
    record = read_columns(blind.columns, held_out=False)
    search = temperature_search(record, ~record.held_out, catalogue())
    fit = search.fit(frozenset({"sensor_lag", "actuator_deadband"}))
    found = {e.name: float(e.par[0]) for e in fit.effects}
    assert found["sensor_lag"] == pytest.approx(blind.hidden["sensor_lag"]["tau_s"], rel=1e-3)
    assert 2.0 * fit.minus_log < 1.05 * search.channel.rows.size


def test_the_film_tells_what_the_thermometer_is_too_dull_for() -> None:
    blind = case("smallest", 1602, effect="radiative_loss", factor=1.5)
    document = diagnose(blind.columns).document()
    assert names(document) == {"radiative_loss"}
    covered(document, blind)


def test_a_range_error_beside_a_film_of_another_kind() -> None:
    blind = case("other_film_effect", 3013)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"meter_range_error"}


def test_a_leakage_beside_a_film_of_another_kind() -> None:
    blind = case("other_film_effect", 6003)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"parallel_leakage"}
    covered(document, blind)


def test_a_film_that_bends_its_own_output_is_no_leakage() -> None:
    blind = case("other_film_effect", 11303)
    assert names(diagnose(blind.columns).document()) == {"ambient_drift"}


@pytest.mark.parametrize(("kind", "seed"), [("clean", 0), ("clean", 1), ("other_film", 6005), ("other_film", 11001)])
def test_nothing_hidden_nothing_named(kind: str, seed: int) -> None:
    """The last film's minor loops are not congruent, as if there were 53 ohm in series: evidence 52."""
    document = diagnose(case(kind, seed).columns).document()
    assert names(document) == set()
    assert document["verdict"] == "clean"


def test_something_that_no_effect_accounts_for() -> None:
    document = diagnose(case("outside", 2).columns).document()
    assert names(document) == set()
    assert document["verdict"] == "unexplained"


def test_what_the_film_went_through_in_gaps_is_no_effect() -> None:
    blind = case("disturbed", 203)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == set()
    assert document["verdict"] == "clean"
    assert "gaps" in {warning["code"] for warning in document["warnings"]}


@pytest.mark.parametrize("seed", [9701, 10007])
def test_what_happens_in_gaps_is_not_made_up(seed: int) -> None:
    """A delayed command of a missing row acts after it; a film went 5 K up and 8 K down in a gap with ends alike."""
    blind = case("disturbed", seed)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden)
    covered(document, blind)


def test_a_base_without_d_lacks_it() -> None:
    blind = case("one", 201, effect="memoryless_term")
    document = diagnose(blind.columns, **blind.options).document()
    assert names(document) == {"memoryless_term"}


def test_a_record_without_current_and_one_without_resistance() -> None:
    blind = case("one", 1, effect="creep")
    film = {k: v for k, v in blind.columns.items() if k != "current_A"}
    document = diagnose(film).document()
    assert document["channels"]["temperature_K"] is None
    assert names(document) == {"creep"}
    blind = case("one", 1, effect="sensor_lag")
    plate = {k: v for k, v in blind.columns.items() if k != "resistance_ohm"}
    document = diagnose(plate).document()
    assert document["channels"]["resistance_dec"] is None
    assert names(document) == {"sensor_lag"}


def test_a_record_that_says_nothing_is_told_so() -> None:
    with pytest.raises(ValueError, match="time_s: missing"):
        diagnose({"temperature_degC": np.ones(100)})
    with pytest.raises(ValueError, match="finite readings; expected at least"):
        diagnose({"time_s": np.arange(5.0), "temperature_degC": np.ones(5), "current_A": np.ones(5)})
