"""Which candidate is tried: the one whose model tells held-out rows best, and none that tells them no better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import pytest

from rig.analysis.tried import best_tried
from sim.diagnosis.extended_model import ExtendedModel
from sim.diagnosis.report.candidates import Candidate


@dataclass(frozen=True)
class Found:
    """Of a diagnosis what is asked for here."""

    candidates: list[Candidate]


def candidate(name: str, rmse_dec: float, rmse_K: float = 0.01) -> Candidate:
    named = {"temperature_K": 0.01, "resistance_dec": 0.006}
    return Candidate((name,), {name: {}}, named, {"temperature_K": rmse_K, "resistance_dec": rmse_dec}, {}, "")


def tried(
    monkeypatch: pytest.MonkeyPatch, errors: dict[str, float | None], candidates: list[Candidate]
) -> tuple[list[str], float | None]:
    """The candidates' names in their order, and the error of the model that is tried. errors: of each one's model, and
    of what is named."""
    models = {name: ExtendedModel(None, None, [], error) for name, error in errors.items()}
    monkeypatch.setattr("rig.analysis.tried.rows_of_film", lambda diagnosis, records: [])
    monkeypatch.setattr(
        "rig.analysis.tried.extended_model", lambda diagnosis, candidate, others: models[candidate.names[0]]
    )
    diagnosis, model = best_tried(cast("Any", Found(candidates)), models["named"])
    return [c.names[0] for c in diagnosis.candidates], model.rmse if model is not None else None


def test_the_model_that_tells_best_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit of creep tells more than the drift's, and a film of the class with creep far less."""
    both = [candidate("creep", 0.0025), candidate("film_drift", 0.0031)]
    errors = {"named": 0.0100, "creep": 0.0323, "film_drift": 0.0031}
    assert tried(monkeypatch, errors, both) == (["film_drift", "creep"], 0.0031)


def test_none_is_tried_that_tells_no_more_than_what_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert tried(monkeypatch, {"named": 0.0100, "creep": 0.0323}, [candidate("creep", 0.0025)]) == (["creep"], None)


def test_a_thermometer_that_is_told_better_counts_beside_the_film(monkeypatch: pytest.MonkeyPatch) -> None:
    both = [candidate("creep", 0.005), candidate("sensor_lag", 0.006, 0.002)]
    errors: dict[str, float | None] = {"named": 0.006, "creep": 0.005, "sensor_lag": 0.006}
    assert tried(monkeypatch, errors, both)[0] == ["sensor_lag", "creep"]


def test_without_a_film_the_diagnosis_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    both = [candidate("creep", 0.006, 0.005), candidate("sensor_lag", 0.006, 0.002)]
    errors: dict[str, float | None] = {"named": None, "creep": None, "sensor_lag": None}
    assert tried(monkeypatch, errors, both)[0] == ["sensor_lag", "creep"]
