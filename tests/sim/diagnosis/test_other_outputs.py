"""Films whose resistance rises, and films of which something else is read: named, sized, and told in their own unit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.config.model_file import read_model
from rig.records.record_file import write_columns
from sim.diagnosis.diagnose import diagnose
from sim.effects.catalogue import catalogue
from sim.inference.record.quantity import Quantity, of_conductance, quantity_of
from tests.truth import NOISE_DEC, record

Peltier = Callable[..., tuple[int, str, str]]
TURNED = 8.0  # log10 of the product of a film's resistance and that of its mirror image, which rises


def mirrored(columns: dict[str, Any], series_ohm: float = 0.0, leakage_ohm: float = np.inf) -> dict[str, Any]:
    """The record of a film whose resistance rises where the given one's falls, with leads or a shunt at the ohmmeter.
    They would damp its noise too, so that it is all there, it gets some more."""
    ohm = 1.0 / (1.0 / (10.0**TURNED / columns["resistance_ohm"] + series_ohm) + 1.0 / leakage_ohm)
    noise = NOISE_DEC * np.random.default_rng(1).standard_normal(ohm.size)
    return {**columns, "resistance_ohm": ohm * 10.0**noise}


@pytest.mark.long
def test_a_shunt_beside_a_film_that_rises() -> None:
    found = record(2)
    size = float(np.nanpercentile(mirrored(found)["resistance_ohm"], 95))
    columns = mirrored(found, leakage_ohm=size)
    said = diagnose(columns, output="log10_ohm")
    assert [f.name for f in said.findings] == ["parallel_leakage"]
    assert said.findings[0].parameters["leakage_ohm"][0] == pytest.approx(size, rel=0.1)


def test_an_effect_on_a_conductance_is_what_it_is_on_the_resistance() -> None:
    leads = catalogue()["series_resistance"]
    par = np.array([50.0])
    read = of_conductance(leads).form.read  # type: ignore[union-attr]
    assert read(par, np.array([1e-2, 1e-3])) == pytest.approx([1 / 150.0, 1 / 1050.0])
    assert of_conductance(catalogue()["film_lag"]) is catalogue()["film_lag"]


def test_another_quantity_is_stretched_and_comes_back_in_its_unit() -> None:
    columns = {"curvature_per_m": np.array([1000.0, 1003.0, np.nan, 1001.5])}
    found = quantity_of("curvature_per_m", columns)
    output = found.of(columns)
    assert output is not None
    assert np.ptp(output[np.isfinite(output)]) == pytest.approx(3.0, rel=0.05)
    assert found.values(output) == pytest.approx(columns["curvature_per_m"], nan_ok=True)
    turned = quantity_of("minus_curvature_per_m", columns)
    assert turned.values(turned.of(columns)) == pytest.approx(columns["curvature_per_m"], nan_ok=True)  # type: ignore[arg-type]
    assert (found.channel, found.unit) == ("curvature_per_m", "per_m")
    assert (Quantity().channel, Quantity("log10_ohm").unit) == ("resistance_dec", "dec")
    assert "series_resistance" not in found.effects(catalogue())
    assert "self_heating" not in found.effects(catalogue())
    assert {"film_lag", "meter_lag", "timestamp_skew", "sensor_lag"} <= set(found.effects(catalogue()))


@pytest.mark.usefixtures("undrawn")
def test_the_verb_on_a_quantity_that_falls(tmp_path: Path, peltier: Peltier) -> None:
    """A film's transmission, in percent, that falls on heating: the effect, its channel, the extended model."""
    columns = record(1, {"film_lag": {"tau_s": 2.0}}, rows=2000, capacity_J_per_K=10.0)
    log_ohm = np.log10(columns.pop("resistance_ohm"))
    columns.pop("meter_current_A")
    slope = 40.0 / np.ptp(log_ohm)
    columns["transmission_percent"] = 20.0 + slope * (log_ohm - log_ohm.min())
    write_columns(tmp_path / "mirror.csv", columns)
    words = ("--output", "transmission_percent", "--json", tmp_path / "out.json", "--report", tmp_path / "report")
    status, out, err = peltier("diagnose", tmp_path / "mirror.csv", *words)
    assert status == 0, err
    assert "the model's output is minus_transmission_percent" in err
    said = json.loads((tmp_path / "out.json").read_text())
    assert [effect["name"] for effect in said["effects"]] == ["film_lag"]
    tau = said["effects"][0]["parameters"]["tau_s"]
    assert tau["value"] == pytest.approx(2.0, rel=0.1)
    assert "resistance_dec" not in said["channels"]
    channel = said["channels"]["transmission_percent"]
    assert channel["noise"] == pytest.approx(slope * NOISE_DEC, rel=0.1)
    assert channel["rmse_extended"] < 1.1 * channel["noise"] < channel["rmse_base"]
    assert "transmission_percent" in out
    assert " dec" not in out
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "transmission_percent" in page
    assert "/ ohm" not in page
    film = read_model(Path(said["model"])).film
    assert film is not None
    assert film.output == "minus_transmission_percent"
    words = ("--initial", "fitted", "--json", tmp_path / "predicted.json")
    status, _, err = peltier("predict", said["model"], tmp_path / "mirror.csv", *words)
    assert status == 0
    assert "Warning" not in err
    predicted = json.loads((tmp_path / "predicted.json").read_text())
    assert predicted["rmse_percent"] < 1.1 * channel["rmse_extended"]


@pytest.mark.usefixtures("undrawn")
def test_the_verb_on_a_resistance_that_rises(tmp_path: Path, peltier: Peltier) -> None:
    """Found without being told; leads in the extended model come back in a prediction."""
    found = record(2, rows=2000)
    ohm = float(np.nanpercentile(mirrored(found)["resistance_ohm"], 5))
    write_columns(tmp_path / "rising.csv", mirrored(found, series_ohm=ohm))
    words = ("--json", tmp_path / "out.json", "--report", tmp_path / "report")
    status, _, err = peltier("diagnose", tmp_path / "rising.csv", *words)
    assert status == 0, err
    assert "the model's output is log10_ohm" in err
    said = json.loads((tmp_path / "out.json").read_text())
    assert [effect["name"] for effect in said["effects"]] == ["series_resistance"]
    words = (said["model"], tmp_path / "rising.csv", "--json", tmp_path / "predicted.json")
    status, _, err = peltier("predict", *words)
    assert status == 0, err
    predicted = json.loads((tmp_path / "predicted.json").read_text())
    assert predicted["rmse_dec"] < 1.2 * said["channels"]["resistance_dec"]["rmse_extended"]


def test_a_column_that_is_not_there_is_told(tmp_path: Path, peltier: Peltier) -> None:
    columns = {"time_s": np.arange(200.0), "temperature_degC": 25.0 + np.arange(200.0), "current_A": np.ones(200)}
    write_columns(tmp_path / "record.csv", columns)
    for verb in ("diagnose", "identify"):
        status, _, err = peltier(verb, tmp_path / "record.csv", "--output", "curvature_per_m")
        assert status == 2
        assert "--output curvature_per_m: curvature_per_m: no such column; there are time_s" in err
