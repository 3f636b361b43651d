"""What the diagnosis makes of readings: outliers in a residual, rounded readings, rows that are held out."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose
from sim.inference.record.record import REPEATED, held_out_rows, read_columns
from tests.truth import NOISE_DEC, record


def test_the_rows_after_a_gap_are_not_held_out() -> None:
    time = np.arange(3000.0)
    time[1250:] += 60.0
    columns = {"time_s": time, "temperature_degC": 30.0 + np.sin(time / 50.0), "current_A": np.sin(time / 50.0)}
    read = read_columns(columns)
    assert read.first_rows.tolist() == [0, 1250]
    assert not np.any(read.held_out[1250:1300])
    assert np.mean(read.held_out) > 0.15
    assert 0.2 < np.mean(held_out_rows(3000)) < 0.25
    assert not np.any(read_columns(columns, held_out=False).held_out)


def test_of_a_meter_slower_than_the_rows_each_reading_counts_once() -> None:
    columns = record(2, rows=2000)
    resistance = columns["resistance_ohm"]
    held = resistance[np.arange(resistance.size) // 8 * 8]
    found = diagnose({**columns, "resistance_ohm": held})
    assert found.verdict == "clean"
    channel = found.channels["resistance_dec"]
    assert channel is not None
    assert channel.noise == pytest.approx(NOISE_DEC, rel=0.2)
    assert [w.code for w in found.warnings].count("repeated_readings") == 1
    assert sum(out.rule == REPEATED for out in found.record.left_out) > 0.8 * resistance.size
