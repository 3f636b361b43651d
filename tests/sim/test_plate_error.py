"""A plate's model beside a record that it does not explain: its error is kept, a held command goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from compensator.thermal.plate import PlateModel
from rig.analysis.diagnosed import model_of
from rig.config.model_file import read_model, write_model
from rig.records.record_file import ColumnMapping, read_record
from sim.diagnosis.extended_model import ExtendedModel
from sim.diagnosis.row_warnings import row_warnings
from sim.inference.record.record import read_columns
from sim.inference.record.stretches import first_rows, gaps

PLATE = ("time_s=t_s|time@s", "temperature_degC=T_C|temp@degC", "current_A=duty|output@duty")


@pytest.mark.parametrize(("after_A", "begins"), [(1.0, [0]), (0.4, [0, 1])])
def test_a_held_command_goes_on_through_a_gap(after_A: float, begins: list[int]) -> None:
    """A first step of eight others, as of a log that starts while a controller has begun to heat."""
    time = np.concatenate(([0.0], 5.0 + 0.62 * np.arange(200.0)))
    current = np.where(time < 1.0, 1.0, after_A)
    told = np.ones(time.size, dtype=np.bool_)
    degC = 30.0 + 0.1 * time + 0.05 * np.random.default_rng(3).standard_normal(time.size)
    assert first_rows(time, degC, current, told, gaps(time, told)).tolist() == begins


def test_an_error_is_kept_in_a_model_file(tmp_path: Path) -> None:
    model = model_of(ExtendedModel(None, PlateModel(1e-3, 0.1, 0.02, 25.0, error_K=0.9), ()))
    write_model(tmp_path / "model.toml", model)
    again = read_model(tmp_path / "model.toml")
    assert again.plate == model.plate


def test_a_measured_sink_saturates(measured: Path) -> None:
    mapping = [ColumnMapping.parse(text) for text in PLATE]
    record = read_columns(read_record(measured / "peltier_runaway.csv", mapping).columns)
    (warning,) = (found for found in row_warnings(record) if found.code == "heat_sink_saturated")
    assert warning.from_s is not None
    assert warning.to_s is not None
    assert 340.0 < warning.from_s < warning.to_s < 520.0
