"""One hidden effect in a record is named, alone. A quick set; the whole table is `./peltier benchmark diagnosis`."""

from __future__ import annotations

import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case
from tests.sim.diagnosis.said import covered, names

ONE = [
    pytest.param("sensor_lag", 1, marks=pytest.mark.long),
    pytest.param("heat_sink_warmup", 1, marks=pytest.mark.other_processor),
    pytest.param("timestamp_skew", 1, marks=pytest.mark.long),
    pytest.param("creep", 1, marks=pytest.mark.long),
    pytest.param("self_heating", 1, marks=pytest.mark.long),
    pytest.param("series_resistance", 1, marks=pytest.mark.long),
    pytest.param("meter_lag", 3, marks=pytest.mark.long),  # of 7.6 s: envelopes are not found in what it shows
]


@pytest.mark.parametrize(("effect", "seed"), ONE)
def test_one_hidden_effect(effect: str, seed: int) -> None:
    blind = case("one", seed, effect=effect, rows=2000)
    document = diagnose(blind.columns).document()
    assert names(document) == {effect}
    assert document["verdict"] == "explained"
    assert document["film"]["of_the_class"]  # no relays have to do what its own envelopes can
    covered(document, blind)
    for channel in document["channels"].values():
        assert channel["rmse_extended"] < 1.15 * channel["noise"]
    assert "outliers" not in {warning["code"] for warning in document["warnings"]}  # of a base that lacks the effect


@pytest.mark.long
def test_the_film_tells_what_the_thermometer_is_too_dull_for() -> None:
    blind = case("smallest", 1602, effect="radiative_loss", factor=1.5)
    document = diagnose(blind.columns).document()
    assert names(document) == {"radiative_loss"}
    covered(document, blind)


@pytest.mark.long
def test_a_base_without_d_lacks_it() -> None:
    blind = case("one", 201, effect="memoryless_term", rows=2000)
    document = diagnose(blind.columns, **blind.options).document()
    assert names(document) == {"memoryless_term"}


def test_a_record_without_current_and_one_without_resistance() -> None:
    blind = case("one", 1, effect="creep", rows=1200)
    film = {k: v for k, v in blind.columns.items() if k != "current_A"}
    document = diagnose(film).document()
    assert document["channels"]["temperature_K"] is None
    assert names(document) == {"creep"}
    blind = case("one", 1, effect="sensor_lag", rows=1200)
    plate = {k: v for k, v in blind.columns.items() if k != "resistance_ohm"}
    document = diagnose(plate).document()
    assert document["channels"]["resistance_dec"] is None
    assert names(document) == {"sensor_lag"}
