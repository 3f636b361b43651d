"""A record with gaps: what a film went through in them does not hide what acts on it."""

from __future__ import annotations

import pytest

from sim.diagnosis.diagnose import diagnose
from tests.sim.diagnosis.cases import case


def test_a_lag_is_found_behind_what_a_film_went_through_in_a_gap() -> None:
    """25 s are missing: beside the memory that was found without the lag, a lag of the ohmmeter leaves a third of what
    the film's own leaves."""
    truth = case("disturbed", 98702)
    found = diagnose(truth.columns)
    assert found.verdict == "explained"
    assert [f.name for f in found.findings] == ["film_lag"]
    assert found.findings[0].parameters["tau_s"][0] == pytest.approx(truth.hidden["film_lag"]["tau_s"], rel=0.01)


def test_a_row_that_is_missing_soon_after_a_gap_does_not_hide_it() -> None:
    """57 s are missing, and one row 3 s later: where the film went in the gap is looked for all the same."""
    assert diagnose(case("disturbed", 99703).columns).verdict == "clean"
