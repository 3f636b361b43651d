"""A name is said at a chosen share of false ones: what noise alone brings to the best of all candidates."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.judge.false_alarm import CLEAN_RECORDS, candidates, chance, evidence_for, false_alarm
from sim.effects.catalogue import catalogue
from sim.effects.effect import Command, Effect, Parameter
from tests.diagnosis.cases import case
from tests.diagnosis.said import names


@pytest.mark.parametrize("share", [0.05, 0.01])
def test_noise_alone_reaches_the_evidence_in_the_chosen_share(share: float) -> None:
    rng, records = np.random.default_rng(1), 200_000
    free = candidates(catalogue().values())
    best = np.max([0.5 * rng.chisquare(k, records) for k in free], axis=0)
    reached = float(np.mean(best > evidence_for(share, free)))
    assert reached <= share + 3.0 * np.sqrt(share / records)
    assert reached > 0.9 * share  # a bound, and a close one


def test_a_value_chosen_among_several_makes_as_many_candidates() -> None:
    form = Command(lambda par, time_s, current_A: (time_s, current_A))
    size, step = Parameter("a_A", 0.1, 1.0), Parameter("step_A", 0.1, 1.0, choices=(0.1, 0.2, 0.5))
    assert candidates([Effect("one", "driver", (size,), form, "", "")]).tolist() == [1.0]
    assert candidates([Effect("one", "driver", (size, step), form, "", "")]).tolist() == [1.0, 1.0, 1.0]
    assert evidence_for(0.01, np.ones(3)) > evidence_for(0.01, np.ones(1)) == pytest.approx(0.5 * 6.6349, rel=1e-4)


def test_more_evidence_is_less_often_false_but_never_less_than_is_known_of_clean_records() -> None:
    free = candidates(catalogue().values())
    chances = [false_alarm(evidence, free) for evidence in (0.0, 3.0, 6.0, 9.0, 1e6)]
    assert chances == sorted(chances, reverse=True)
    assert chances[0] == 1.0
    assert chances[-1] == 1.0 / CLEAN_RECORDS
    assert chance(30.0, free) < 1e-11


def test_what_is_named_at_one_per_cent_is_not_at_one_in_a_billion() -> None:
    """A lag of the sensor under noise of 1 K: it shows, as one of what moves the reading later, and not by much."""
    found = case("one", 7, effect="sensor_lag", rows=2000).columns
    noisy = found["temperature_degC"] + np.random.default_rng(1).standard_normal(found["time_s"].size)
    columns = {"time_s": found["time_s"], "current_A": found["current_A"], "temperature_degC": noisy}
    document = diagnose(columns).document()
    assert len(names(document)) == 1
    assert document["effects"][0]["evidence"] < 20.0
    document = diagnose(columns, chosen_false_alarm=1e-9).document()
    assert names(document) == set()
    assert document["verdict"] == "clean"


def test_a_share_that_nothing_is_known_of_is_refused() -> None:
    with pytest.raises(ValueError, match=r"false alarm 0\.5: expected 1e-12 to 0\.05"):
        diagnose({"time_s": np.arange(9.0), "temperature_degC": np.ones(9)}, chosen_false_alarm=0.5)
