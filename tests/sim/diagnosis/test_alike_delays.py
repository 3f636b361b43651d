"""Of delays that a record cannot tell apart the same one is said, whatever the last digit of its readings is."""

from __future__ import annotations

import pytest

from benchmarks.same_names import moved
from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case


@pytest.mark.parametrize("is_moved", [False, True])
def test_the_simplest_of_delays_that_show_the_same_is_said(is_moved: bool) -> None:
    """A steady ramp: a skew was said of it as it is, a lag of the ohmmeter of the same moved by 1e-12."""
    blind = case("indistinguishable", 105016)
    columns = moved(blind.columns, blind.seed) if is_moved else blind.columns
    (said,) = diagnose(columns, **blind.options).document()["effects"]
    assert said["name"] == "timestamp_skew"
    assert set(said["indistinguishable_from"]) == {"film_lag", "meter_lag"}
