"""A record held out whose room its first rows hardly tell: what is missed there is no fault of the model."""

from __future__ import annotations

import pytest

from rig.report.diagnosis_words import sentence
from sim.diagnosis.diagnose import diagnose
from tests.diagnosis.plate_record import levels, record

NOISE_K = 0.4


def test_what_first_rows_leave_open_is_said_to_be_that() -> None:
    one, other = record(22.0, levels(1), 1, NOISE_K), record(31.0, levels(2), 2, NOISE_K)
    found = diagnose(one, holdout=[other], as_predicted=True)
    channel = found.channels["temperature_K"]
    assert found.verdict == "clean"
    assert channel is not None
    assert channel.rmse_extended > 1.3 * NOISE_K
    assert channel.all_told == pytest.approx(1.0, abs=0.1)
    left = found.document()["left"]["temperature_K"]
    assert "was fitted to its first rows, which leave it open; fitted to all of its rows, these are off by 1" in left
    assert "It holds for the held-out rows too, but for what first rows leave open" in sentence(found)
    told = diagnose(one, holdout=[other]).channels["temperature_K"]  # with all of its rows
    assert told is not None
    assert told.rmse_extended == pytest.approx(NOISE_K, rel=0.1)
