"""Where the meter heats the film, and the model knows, a run keeps one test current over its target."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from rig.__main__ import main
from tests.rig.small import write_bench

HEATED = '[[effects]]\nname = "self_heating"\ntheta_K_per_W = 1000.0\n'


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("heated", [False, True])
def test_one_test_current_over_the_target(tmp_path: Path, heated: bool) -> None:
    """The target passes 9.5 kohm, where the meter goes from 0.01 to 0.1 mA."""
    path = write_bench(tmp_path)
    if heated:
        model = (tmp_path / "model.toml").read_text()
        (tmp_path / "model.toml").write_text(model + HEATED)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "record.csv").open(newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    currents = {float(row["meter_current_A"]) for row in rows if row["phase"] == "track"}
    assert currents == ({1e-5} if heated else {1e-5, 1e-4})
    events = (tmp_path / "out" / "events.jsonl").read_text()
    assert ("at most 1e-05 A" in events) == heated
