"""The plate's numbers in a diagnosis: the true ones inside their intervals, impossible ones told."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.inference.plate.fit import constant_drive
from tests.sim.diagnosis.plate_record import JOULE, LOSS, SEEBECK, levels, record


@pytest.mark.parametrize("seed", [1, 2])
def test_the_true_numbers_are_inside(seed: int) -> None:
    plate = diagnose(record(24.0, levels(seed), seed)).plate
    assert plate is not None
    assert plate.kind == "peltier"
    assert plate.doubts == ()
    true = {
        "seebeck_over_capacity_per_A_s": SEEBECK,
        "resistance_over_capacity_K_per_A2_s": JOULE,
        "conductance_over_capacity_per_s": LOSS,
        "ambient_degC": 24.0,
    }
    assert set(plate.parameters) == set(true)
    for name, (value, ci) in plate.parameters.items():
        assert ci is not None
        low, high = ci
        assert low < value < high
        assert abs(value - true[name]) < high - low, name  # four standard deviations
        assert high - low < 0.1 * value  # and no interval that holds anything


def test_a_room_that_is_none_is_told() -> None:
    document = diagnose(record(-12.0, levels(3), 3)).document()
    assert any("-12 degC is no room's temperature" in doubt for doubt in document["plate"]["doubts"])


def test_what_the_record_does_not_fix_is_told() -> None:
    """Small currents, and a noisy thermometer: heat that goes with the square of the current is not seen."""
    small = 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, 30)
    document = diagnose(record(24.0, small, 4, noise_K=0.05)).document()
    doubts = [doubt for doubt in document["plate"]["doubts"] if doubt.startswith("resistance_over_capacity")]
    assert len(doubts) == 1
    assert "large currents in both directions fix it" in doubts[0]


def test_a_room_that_may_be_any_has_no_interval() -> None:
    plate = diagnose(record(24.0, np.array([1.0, 0.6, 0.8]), 7, noise_K=0.3)).plate
    assert plate is not None
    assert plate.parameters["ambient_degC"][1] is None  # -27 to 77 degC
    assert any(doubt.startswith("ambient_degC: not known") for doubt in plate.doubts)
    assert plate.parameters["conductance_over_capacity_per_s"][1] is not None


def test_a_constant_current_is_told_and_no_interval_is_given_beside_what_it_leaves_open() -> None:
    """Four numbers of which it tells two: of the others, each interval would hold for one value of the rest."""
    current = np.full(20, 1.0)
    plate = diagnose(record(24.0, current, 5)).plate
    assert plate is not None
    assert constant_drive(current, "peltier") in plate.doubts
    for name in ("resistance_over_capacity_K_per_A2_s", "ambient_degC"):
        assert plate.parameters[name][1] is None


def test_what_is_logged_and_does_not_change_is_not_used_and_told_so() -> None:
    columns = record(24.0, levels(3, 12), 3)
    rows = columns["time_s"].size
    logged = {"ambient_degC": np.full(rows, 22.5), "sink_degC": np.full(rows, 25.0), "input_2": np.zeros(rows)}
    said = [w.text for w in diagnose({**columns, **logged}).warnings if w.code == "constant_column"]
    assert [text.split(":")[:2] for text in said] == [
        ["input_2", " 0 in all rows"], ["sink_degC", " 25 in all rows"], ["ambient_degC", " 22.5 in all rows"]
    ]  # fmt: skip
    logged["ambient_degC"] = 22.5 + np.arange(rows) / rows
    said = [w.text for w in diagnose({**columns, **logged}).warnings if w.code == "constant_column"]
    assert len(said) == 2


def test_an_input_that_acts_late_is_told_to_act_late() -> None:
    """A second heater that switches, and whose heat never comes."""
    columns = record(24.0, levels(3, 12), 3)
    second = np.arange(columns["time_s"].size) // 35 % 2 * 1.0
    plate = diagnose({**columns, "input_2": second}).plate
    assert plate is not None
    doubts = [doubt for doubt in plate.doubts if doubt.startswith("inputs.input_2")]
    assert len(doubts) == 1
    assert "it changes, and the plate does not answer as fast" in doubts[0]


def test_no_current_no_plate() -> None:
    time = np.arange(400.0)
    degC = 60.0 + 20.0 * np.sin(time / 60.0)
    ohm = 10.0 ** (4.0 - 1.5 / (1.0 + np.exp(-(degC - 60.0) / 2.0)))
    assert diagnose({"time_s": time, "temperature_degC": degC, "resistance_ohm": ohm}).document()["plate"] is None


def test_a_current_that_acts_after_its_row_where_the_record_says_when() -> None:
    """As in the program's own runs: thermometer, law and command take their time. Without the column it is a delay."""
    late = record(24.0, levels(6), 6, acts_after_s=0.3)
    silent = diagnose(late)
    assert [f.name for f in silent.findings] == ["actuator_delay"]
    assert silent.findings[0].parameters["delay_s"][0] == pytest.approx(0.3, abs=0.02)
    told = diagnose({**late, "current_time_s": late["time_s"] + 0.3})
    assert told.verdict == "clean"
    assert told.plate is not None
    assert told.plate.parameters["seebeck_over_capacity_per_A_s"][0] == pytest.approx(SEEBECK, rel=0.003)
