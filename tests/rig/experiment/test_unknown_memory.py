"""experiment.memory = "estimate": no hot excursion, and a replay of the same bits."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rig.records.record_file import read_record
from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]
pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.mark.parametrize("memory", ["estimate", "assume"])
def test_a_film_is_taken_where_it_is(tmp_path: Path, peltier: Peltier, memory: str) -> None:
    target = '["start 20 kohm", "hold 6 s", "ramp to 12 kohm in 10 s", "hold 4 s", "ramp to 18 kohm in 10 s"]'
    path = write_bench(tmp_path, target=target)
    path.write_text(path.read_text().replace("settle_s", f'memory = "{memory}"\nsettle_s'))
    run = tmp_path / "run"
    status, _, err = peltier("run", path, "--out", run)
    assert status == 0, err
    record = read_record(run / "record.csv", needs=(), options=False)
    assert set(record.text_columns["phase"]) == {"polarity", "settle", "track"}
    assert np.nanmax(record["temperature_degC"]) < 75.0  # the hot end is at 90
    status, out, err = peltier("replay", run, "--json", "-")
    assert status == 0, err
    assert json.loads(out)["different"] == 0
    assert json.loads(out)["compared"] > 250
