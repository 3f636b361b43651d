"""Films of another kind than the model's: an effect beside one is named, and one that has none blames nothing.

Relays stand in for such a film, hundreds of them, and where a search among them ends hangs on the last digits of its
sums: evidence of 215 differs by 4 between processors. So a case here has to have to spare several times what it differs
by, in its evidence and in how much better or worse than the effect's own a softer or sharper bend is
(`sim/diagnosis/judge/output_nonlinearity.py`): an evidence of 115 was once not named on one processor, where a softer
bend was 4 better.
"""

from __future__ import annotations

import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case
from tests.sim.diagnosis.said import covered, names


@pytest.mark.long
def test_a_range_error_beside_a_film_of_another_kind() -> None:
    blind = case("other_film_effect", 3013)
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"meter_range_error"}


@pytest.mark.long
def test_a_leakage_beside_a_film_of_another_kind() -> None:
    blind = case("other_film_effect", 35, effect="parallel_leakage")
    document = diagnose(blind.columns).document()
    assert names(document) == set(blind.hidden) == {"parallel_leakage"}
    covered(document, blind)


@pytest.mark.long
def test_a_film_that_bends_its_own_output_is_no_leakage() -> None:
    blind = case("other_film_effect", 11303)
    assert names(diagnose(blind.columns).document()) == {"ambient_drift"}


@pytest.mark.parametrize(
    ("seed", "choice"),
    [
        (6005, {"rows": 2000}),
        pytest.param(6006, {"rows": 2000}, marks=pytest.mark.long),
        pytest.param(6005, {}, marks=pytest.mark.long),
        pytest.param(11001, {}, marks=pytest.mark.long),
    ],
)
def test_nothing_hidden_nothing_named(seed: int, choice: dict[str, int]) -> None:
    """The last film's minor loops are not congruent, as if there were 53 ohm in series: evidence 52, and a softer bend
    is better by 7.6 to 8.0."""
    document = diagnose(case("other_film", seed, **choice).columns).document()
    assert names(document) == set()
    assert document["verdict"] == "clean"
