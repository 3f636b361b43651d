"""The diagnosis by one likelihood, on records of a rig that shares no code with it (`tests/truth.py`).

Each kind of verdict once; how often it is right is what `./peltier benchmark referee` counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.inference.noise import noise_before_rounding, of_rounded
from sim.inference.record.record import held_out_rows
from tests.sim.diagnosis.said import covered, names
from tests.truth import NOISE_DEC, Effects, record

ROWS = 2000
LAGS: Effects = {"sensor_lag": {"tau_s": 1.5}, "film_lag": {"tau_s": 1.0}}
SINK: Effects = {"heat_sink_warmup": {"sink_capacity_ratio": 8.0, "sink_conductance_ratio_per_s": 0.2}}
LEADS: Effects = {"series_resistance": {"series_ohm": 800.0}}
FILM, PLATE = ("time_s", "temperature_degC", "resistance_ohm"), ("time_s", "temperature_degC", "current_A")


def told(columns: dict[str, np.ndarray], *which: str) -> dict[str, Any]:
    return diagnose({name: columns[name] for name in which or columns}).document()


@pytest.mark.other_processor
def test_a_clean_record_is_clean() -> None:
    """Else whoever has a good rig looks for a fault that is not there."""
    document = told(record(2, rows=ROWS))
    assert (document["verdict"], document["effects"], document["candidates"]) == ("clean", [], [])
    channel = document["channels"]["resistance_dec"]
    assert channel["noise"] == pytest.approx(NOISE_DEC, rel=0.1)
    assert channel["rmse_extended"] < 1.15 * channel["noise"]


@pytest.mark.parametrize("hidden", [pytest.param(SINK, marks=pytest.mark.other_processor), LEADS, LAGS])
def test_what_is_hidden_is_named_with_its_size_and_nothing_else(hidden: Effects) -> None:
    """Else a bench mends the wrong link, or the right one by the wrong amount."""
    document = told(record(1, hidden, rows=ROWS))
    assert (document["verdict"], names(document)) == ("explained", set(hidden))
    covered(document, hidden)
    assert document["film"]["of_the_class"]  # no relays have to do what its own envelopes can
    for channel in document["channels"].values():
        assert channel["rmse_extended"] < 1.15 * channel["noise"]
    for effect in document["effects"]:
        assert any(gain["rmse_after"] < gain["rmse_before"] for gain in effect["gain"].values())
    assert "outliers" not in {warning["code"] for warning in document["warnings"]}  # of a base that lacks the effect


def test_a_record_without_a_film_tells_its_plate() -> None:
    """Else a plate record, which has no resistance, cannot be diagnosed."""
    document = told(record(1, SINK, rows=ROWS), *PLATE)
    assert (names(document), document["channels"]["resistance_dec"]) == (set(SINK), None)


def test_a_record_without_a_current_tells_its_film() -> None:
    """Else a film record, whose thermometer drives the film, cannot be diagnosed."""
    document = told(record(1, {"film_lag": {"tau_s": 1.0}}, rows=ROWS), *FILM)
    assert (names(document), document["channels"]["temperature_K"]) == ({"film_lag"}, None)


def test_a_film_of_another_kind_is_no_fault() -> None:
    """Else its ohmmeter is blamed for what the film does."""
    document = told(record(1, film="outside", rows=ROWS))
    assert (document["verdict"], document["effects"]) == ("clean", [])
    assert not document["film"]["of_the_class"]


def test_what_no_effect_accounts_for_is_given_no_name() -> None:
    """Else interference on the ohmmeter's line is taken for the film's."""
    columns = record(2, rows=ROWS)
    columns["resistance_ohm"] *= 10.0 ** (0.01 * np.sin(2.0 * np.pi * columns["time_s"] / 37.0))
    document = told(columns)
    assert (document["verdict"], document["effects"]) == ("unexplained", [])


@pytest.mark.parametrize(("hidden", "verdict"), [({}, "clean"), ({"film_lag": {"tau_s": 1.0}}, "explained")])
def test_what_a_film_went_through_in_a_gap_is_no_effect_and_hides_none(hidden: Effects, verdict: str) -> None:
    """Else a logger that dropped half a minute costs the whole record."""
    columns = record(1, hidden, rows=ROWS)
    there = (np.arange(ROWS) < 900) | (np.arange(ROWS) > 950)
    there[956] = False  # a row that is missing soon after a gap does not hide it
    document = told({name: values[there] for name, values in columns.items()}, *FILM)
    assert (document["verdict"], names(document)) == (verdict, set(hidden))
    assert "gaps" in {warning["code"] for warning in document["warnings"]}


def test_no_gain_is_told_of_a_film_that_was_read_in_no_held_out_row() -> None:
    """Else a division by no row ends the diagnosis."""
    columns = record(2, rows=800)
    columns["resistance_ohm"][held_out_rows(800)] = np.nan
    assert told(columns)["channels"]["resistance_dec"] is None


def test_a_drive_that_moves_nothing_is_said_so() -> None:
    """Else a loss or a lag is named of a plate that the logged drive does not even heat."""
    rng = np.random.default_rng(2)
    time = np.arange(1200) * 0.5
    columns = {
        "time_s": time,
        "temperature_degC": 60.0 + 20.0 * np.sin(time / 40.0) + 0.02 * rng.standard_normal(time.size),
        "current_A": np.repeat(rng.uniform(-2.0, 2.0, 60), 20),
    }
    document = told(columns)
    assert "drive_without_effect" in {warning["code"] for warning in document["warnings"]}
    assert not {"radiative_loss", "heat_sink_warmup", "actuator_delay"} & names(document)


def test_a_record_that_says_nothing_is_told_so() -> None:
    """Else a typing error in a column's name ends in a traceback."""
    with pytest.raises(ValueError, match="time_s: missing"):
        diagnose({"temperature_degC": np.ones(100)})
    with pytest.raises(ValueError, match="finite readings; expected at least"):
        diagnose({"time_s": np.arange(5.0), "temperature_degC": np.ones(5), "current_A": np.ones(5)})


def test_rounded_readings_keep_the_noise_before_rounding() -> None:
    """Else a step of 0.25 K passes for noise of 0.07 K, and what is smaller is not seen."""
    rng = np.random.default_rng(1)
    shown = np.linspace(20.0, 60.0, 4000)
    readings = 0.25 * np.round((shown + 0.03 * rng.standard_normal(shown.size)) / 0.25)
    assert noise_before_rounding(readings - shown, 0.25) == pytest.approx(0.03, rel=0.2)


def test_the_likelihood_of_a_rounded_reading_and_its_slope() -> None:
    """Else a descent goes where the likelihood does not rise."""
    residual, step, white, by = np.array([-0.4, -0.1, 0.0, 0.05, 0.3, 2.0]), 0.25, 0.07, 1e-6
    more, less = (of_rounded(residual + side * by, step, white)[0] for side in (1.0, -1.0))
    _, mean, known = of_rounded(residual, step, white)
    np.testing.assert_allclose((more - less) / (2.0 * by), -mean / white, rtol=1e-4, atol=1e-4)
    assert np.all((known > 0.0) & (known <= 1.0))
