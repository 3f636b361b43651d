"""What the rows of a record show by themselves is said with the rows and the times of its own file."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.result import Caution
from sim.diagnosis.row_warnings import row_warnings
from sim.inference.record.joined import read_records
from sim.inference.record.quantity import FALLING_OHM

BEGINS_S = 1000.0


def columns(step_s: float, begins_s: float = 0.0, spike: int | None = None) -> dict[str, np.ndarray]:
    """A plate that warms up slowly, with one reading far off."""
    row = np.arange(200)
    degC = 30.0 + 0.01 * row + 1e-3 * np.random.default_rng(1).standard_normal(row.size)
    if spike is not None:
        degC[spike] += 30.0
    return {"time_s": begins_s + step_s * row, "temperature_degC": degC, "current_A": np.where(row < 100, 0.5, 0.7)}


def said(*records: dict[str, np.ndarray]) -> list[Caution]:
    return row_warnings(read_records(records, FALLING_OHM, held_out=True))


def test_a_bad_row_has_the_time_of_its_file() -> None:
    texts = [caution.text for caution in said(columns(1.0, BEGINS_S, spike=72))]
    assert any("row 73 (1072 s)" in text for text in texts)


def test_a_time_since_1970_keeps_its_seconds() -> None:
    texts = [caution.text for caution in said(columns(1.0, 1.7e9, spike=72))]
    assert any("row 73 (1700000072 s)" in text for text in texts)


def test_a_bad_row_is_told_of_its_own_record() -> None:
    found = said(columns(1.0), columns(1.0, BEGINS_S, spike=72))
    assert {caution.record for caution in found} == {2}
    assert any("row 73 (1072 s)" in caution.text for caution in found)


def test_records_of_another_pace_each_are_even() -> None:
    assert said(columns(1.0), columns(3.0)) == []


def test_a_gap_is_told_of_its_own_record() -> None:
    broken = columns(1.0)
    broken["time_s"] = broken["time_s"] + np.where(np.arange(200) >= 120, 40.0, 0.0)
    (caution,) = said(columns(1.0), broken, columns(1.0))
    assert (caution.code, caution.record) == ("gaps", 2)
    assert caution.text.startswith("1 gap in the rows, of 41 s")


def test_a_saturated_sink_has_the_time_of_its_file() -> None:
    row = np.arange(400.0)
    cooled = {"temperature_degC": 20.0 + 0.02 * row, "current_A": np.full(row.size, -1.0)}
    (caution,) = (c for c in said({"time_s": BEGINS_S + row, **cooled}) if c.code == "heat_sink_saturated")
    assert caution.from_s == pytest.approx(BEGINS_S + 133.0)
    assert caution.to_s == pytest.approx(BEGINS_S + 398.0)


def test_only_what_is_left_out_is_called_so() -> None:
    """On a lattice nothing is taken for an outlier, however far off it is."""
    coarse = columns(1.0)
    coarse["temperature_degC"] = 0.25 * np.round(coarse["temperature_degC"] / 0.25)
    coarse["temperature_degC"][[72, 120]] += 30.0
    record = read_records([coarse], FALLING_OHM, held_out=True)
    assert record.left_out == ()
    (none,) = row_warnings(record)
    assert "rows 73, 121 stand off" in none.text
    assert "not left out: they count" in none.text


def test_what_is_left_out_has_the_time_and_the_number_of_its_record() -> None:
    record = read_records((columns(1.0), columns(1.0, BEGINS_S, spike=72)), FALLING_OHM, held_out=True)
    (out,) = record.left_out
    assert (record.number_of(out.row), record.file_s[out.row]) == (2, 1072.0)
