"""Several records of one rig as one: one plate, a room for each."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.inference.record.joined import joined
from sim.inference.record.stretches import gaps
from tests.sim.diagnosis.plate_record import JOULE, LOSS, SEEBECK, levels, record
from tests.truth import record as rig_record

ROOMS_DEGC = (21.0, 27.0, 24.0)


def test_each_record_has_its_own_room() -> None:
    records = [record(room, levels(seed, 20), seed) for seed, room in enumerate(ROOMS_DEGC, 5)]
    found = diagnose(*records)
    assert found.verdict == "clean"
    assert found.rooms_degC == pytest.approx(ROOMS_DEGC, abs=0.05)
    assert found.plate is not None
    values = {name: value for name, (value, _) in found.plate.parameters.items()}
    assert values["seebeck_over_capacity_per_A_s"] == pytest.approx(SEEBECK, rel=0.003)
    assert values["resistance_over_capacity_K_per_A2_s"] == pytest.approx(JOULE, rel=0.02)
    assert values["conductance_over_capacity_per_s"] == pytest.approx(LOSS, rel=0.01)


def test_one_room_for_all_of_them_would_not_do() -> None:
    """The same rows as one record: something is left, or blamed."""
    records = [record(room, levels(seed, 20), seed) for seed, room in enumerate(ROOMS_DEGC, 5)]
    assert diagnose(joined(records)[0]).verdict != "clean"


def test_each_record_has_its_own_rate() -> None:
    """A calibration is read more slowly than a run: beside its rows those of a calibration are no gaps."""
    steps = np.concatenate((np.full(800, 0.1), [60.0], np.where(np.arange(30) % 10 == 9, 0.28, 0.25)))
    time, told = np.concatenate(([0.0], np.cumsum(steps))), np.ones(steps.size + 1, dtype=np.bool_)
    assert gaps(time, told, [801]).tolist() == [801]
    assert gaps(time, told).size > 20  # as if it were one record


@pytest.mark.long
def test_film_and_effect_are_found_once() -> None:
    """Two runs of one rig that hides a lag: the film's memory between them is not known."""
    hidden = {"film_lag": {"tau_s": 1.0}}
    found = diagnose(*(rig_record(1, hidden, rows=1500, profile=profile) for profile in (1, 2)))
    assert [f.name for f in found.findings] == ["film_lag"]
    value, interval = found.findings[0].parameters["tau_s"]
    assert interval is not None
    assert value == pytest.approx(1.0, abs=2.0 * (interval[1] - interval[0]))


def test_a_record_without_a_current_beside_those_with_one() -> None:
    first, second = record(24.0, levels(1), 1), record(24.0, levels(2), 2)
    del second["current_A"]
    with pytest.raises(ValueError, match="record 2: current_A: missing"):
        diagnose(first, second)
