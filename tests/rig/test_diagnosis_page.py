"""What the page of a diagnosis shows of its records: their own times, their own rates."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from rig.report.diagnosis_figures import _against, _times_of_each
from sim.diagnosis.data.joined import read_records
from sim.diagnosis.data.quantity import FALLING_OHM

ROW = np.arange(100.0)


def two_records() -> SimpleNamespace:
    """A plate that cools by 0.1 K/s from 60 degC, twice; the second begins at 1000 s."""
    columns = {"temperature_degC": 60.0 - 0.1 * ROW, "current_A": np.where(ROW < 50, -1.0, -0.5)}
    records = [{"time_s": begin + ROW, **columns} for begin in (0.0, 1000.0)]
    return SimpleNamespace(record=read_records(records, FALLING_OHM, held_out=False), plate=None)


def test_no_rate_is_taken_from_one_record_to_the_next() -> None:
    shown = dict(_against(two_records(), None))  # type: ignore[arg-type]
    assert shown["rate / K/s"] == pytest.approx(np.full(200, -0.1), abs=0.06)


def test_an_axis_has_the_times_of_each_file() -> None:
    axis = Figure().subplots()
    _times_of_each(axis, two_records().record)
    told = [float(label.get_text()) for label in axis.get_xticklabels()]
    assert min(told) == 0.0
    assert max(told) > 1050.0
    assert axis.get_xticks() == pytest.approx([t if t < 100.0 else t - 1000.0 + 99.0 + 60.0 for t in told])
