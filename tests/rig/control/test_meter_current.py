"""When the ohmmeter's test current came on is recorded: at the change of range, not when the row before was read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rig.records.record_file import read_record
from sim.world.plant import SimulatedPlant
from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]


def test_it_is_when_the_simulated_meter_changes_its_range(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path
) -> None:
    changed_s, on_for_s = [], []
    set_current, read = SimulatedPlant.set_test_current_A, SimulatedPlant.read_resistance_ohm

    def noted(plant: SimulatedPlant, current: float) -> None:
        if current != plant.test_current_A:
            changed_s.append(plant.time_s)
        set_current(plant, current)

    def counted(plant: SimulatedPlant, current: float) -> float:
        on_for_s.append(plant.time_s - changed_s[-1])
        return read(plant, current)

    monkeypatch.setattr(SimulatedPlant, "set_test_current_A", noted)
    monkeypatch.setattr(SimulatedPlant, "read_resistance_ohm", counted)
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace("[bench.meter]\n", "[bench.meter]\naverage = 1\n"))
    status, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert status == 0, err
    record = read_record(tmp_path / "run" / "record.csv")
    time, on = record["time_s"], record["meter_current_time_s"]
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0) + 1
    assert rows.size
    assert np.all(on[rows] > time[rows - 1] + 0.04)  # the change waits for the next reading to be begun
    for own_s in record["resistance_time_s"][rows] - on[rows]:
        assert min(abs(own_s - s) for s in on_for_s) < 1e-6


def test_a_row_has_the_current_that_its_reading_was_taken_with(peltier: Peltier, tmp_path: Path) -> None:
    """Though the next one, in another range maybe, has been begun by then."""
    status, _, err = peltier("run", write_bench(tmp_path), "--out", tmp_path / "run")
    assert status == 0, err
    record = read_record(tmp_path / "run" / "record.csv")
    row_s, read_s, on_s = (record[name] for name in ("time_s", "resistance_time_s", "meter_current_time_s"))
    rows = np.flatnonzero(np.diff(record["meter_current_A"]) != 0.0) + 1
    assert rows.size
    assert np.all(on_s[rows] < read_s[rows])
    assert np.all(on_s[rows] > row_s[rows - 1] - 0.1)  # since then, and not since the change before
