"""Films whose domains switch one by one: their steps are their own, and effects are found beside them."""

from __future__ import annotations

import pytest

from sim.diagnosis.diagnose import diagnose
from tests.diagnosis.cases import case
from tests.diagnosis.said import covered, names


def test_a_lag_beside_steps_is_found() -> None:
    blind = case("domains", 1, count=600, rows=2000, effect="film_lag")
    found = diagnose(blind.columns)
    document = found.document()
    assert names(document) == {"film_lag"}
    assert document["verdict"] == "explained"
    covered(document, blind)
    assert found.channels["resistance_dec"].noise == pytest.approx(blind.noise["resistance_dec"], rel=0.2)
    assert [w["code"] for w in document["warnings"]].count("film_in_steps") == 1
    assert document["film"]["domains"]["step_dec"] > 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 6])
def test_a_film_in_steps_is_clean(seed: int) -> None:
    assert diagnose(case("domains", seed).columns).document()["verdict"] == "clean"


@pytest.mark.long
@pytest.mark.parametrize("fault", ["bad_joint", "loose_contact", "pickup"])
def test_a_fault_beside_steps_is_not_explained_by_them(fault: str) -> None:
    blind = case("domains", 3, count=600, fault=fault)
    document = diagnose(blind.columns).document()
    assert document["verdict"] == "unexplained"


@pytest.mark.long
def test_a_drift_beside_steps_is_found() -> None:
    blind = case("domains", 5)
    assert set(blind.hidden) == {"film_drift"}
    document = diagnose(blind.columns).document()
    assert names(document) == {"film_drift"}
    covered(document, blind)
