"""Records in which no effect is hidden, or none that is known: nothing is named. What gaps hide is not made up."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case
from tests.sim.diagnosis.plate_record import record
from tests.sim.diagnosis.said import covered, names


@pytest.mark.parametrize(
    "seed", [pytest.param(0, marks=pytest.mark.other_processor), pytest.param(1, marks=pytest.mark.long)]
)
def test_nothing_hidden_nothing_named(seed: int) -> None:
    document = diagnose(case("clean", seed, rows=2000).columns).document()
    assert names(document) == set()
    assert document["verdict"] == "clean"
    assert document["candidates"] == []


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_something_that_no_effect_accounts_for(seed: int) -> None:
    """A room that is cycled; interference on the ohmmeter, beside which everything is searched for to its end."""
    document = diagnose(case("outside", seed).columns).document()
    assert names(document) == set()
    assert document["verdict"] == "unexplained"


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 7])
def test_what_no_effect_accounts_for_lends_a_name_no_evidence(seed: int) -> None:
    """A module whose resistance grows with temperature leaves ten times the noise, hanging together for minutes."""
    rng = np.random.default_rng(seed)
    currents = np.repeat(rng.uniform(0.0, 1.6, 45), rng.integers(1, 5, 45))
    document = diagnose(record(24.0, currents, seed, joule_per_K=0.006)).document()
    assert names(document) == set()
    assert document["verdict"] == "unexplained"


@pytest.mark.long
@pytest.mark.parametrize("choice", [{"rows": 2000}, {}])
def test_what_the_film_went_through_in_gaps_is_no_effect(choice: dict[str, int]) -> None:
    blind = case("disturbed", 203, **choice)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == set()
    assert document["verdict"] == "clean"
    assert "gaps" in {warning["code"] for warning in document["warnings"]}


@pytest.mark.parametrize(
    ("seed", "choice"),
    [
        pytest.param(9746, {"rows": 2000}, marks=pytest.mark.long),
        pytest.param(9701, {}, marks=pytest.mark.long),
        pytest.param(10007, {}, marks=pytest.mark.long),
    ],
)
def test_what_happens_in_gaps_is_not_made_up(seed: int, choice: dict[str, int]) -> None:
    """A delayed command of a missing row acts after it; a film went 5 K up and 8 K down in a gap with ends alike."""
    blind = case("disturbed", seed, **choice)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden)
    covered(document, blind)


def test_a_record_that_says_nothing_is_told_so() -> None:
    with pytest.raises(ValueError, match="time_s: missing"):
        diagnose({"temperature_degC": np.ones(100)})
    with pytest.raises(ValueError, match="finite readings; expected at least"):
        diagnose({"time_s": np.arange(5.0), "temperature_degC": np.ones(5), "current_A": np.ones(5)})
