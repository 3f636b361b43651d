"""repeat = N: each repetition in a folder, what was learned beside it; replayed to the bit; begun from another run."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.rig.small import write_bench

Peltier = Callable[..., tuple[int, str, str]]


def test_a_run_that_learns(tmp_path: Path, peltier: Peltier) -> None:
    target = '["start 20 kohm", "hold 4 s", "ramp to 8 kohm in 12 s", "hold 6 s"]'
    path = write_bench(tmp_path, target=target)
    path.write_text(path.read_text().replace("settle_s", "repeat = 3\nsettle_s"))
    run = tmp_path / "run"
    status, out, err = peltier("run", path, "--out", run, "--json", "-")
    assert status == 0, err
    assert len(json.loads(out)["repeated"]) == 2
    folders = [run / "repeat_1", run / "repeat_2", run]
    assert [(folder / "correction.csv").is_file() for folder in folders] == [False, True, True]
    for folder in folders:
        assert (folder / "report.html").is_file()
        assert json.loads((folder / "run.json").read_text())["stop"]["reason"] == "done"
        status, out, err = peltier("replay", folder, "--json", "-")
        assert status == 0, err
        assert json.loads(out)["different"] == 0, folder
        assert json.loads(out)["compared"] > 100
    used, learned = (
        np.loadtxt(folders[1] / name, delimiter=",", skiprows=1) for name in ("correction.csv", "learned.csv")
    )
    first = np.loadtxt(folders[0] / "learned.csv", delimiter=",", skiprows=1)
    assert np.array_equal(used, first)
    assert learned.shape == used.shape
    for folder in folders:  # what is recorded is what was wanted, not what the law was asked for
        rows = list(csv.DictReader((folder / "record.csv").read_text().splitlines()))
        last = [float(row["target_ohm"]) for row in rows if row["phase"] == "track"][-1]
        assert abs(last - 8e3) < 1.0

    path.write_text(path.read_text().replace("repeat = 3", f'repeat = 1\nlearned = "{run}"'))
    status, _, err = peltier("run", path, "--out", tmp_path / "again")
    assert status == 0, err
    begun = np.loadtxt(tmp_path / "again" / "correction.csv", delimiter=",", skiprows=1)
    assert np.allclose(begun, np.loadtxt(run / "learned.csv", delimiter=",", skiprows=1))


def test_what_cannot_be_repeated_from_is_refused_before_anything_runs(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace("settle_s", 'learned = "nothing"\nsettle_s'))
    status, _, err = peltier("run", path, "--out", tmp_path / "run")
    assert status == 2
    assert "learned.csv" in err
    assert not (tmp_path / "run").exists()
