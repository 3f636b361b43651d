"""What is told of the records of a diagnosis: their names, times, rates, rooms, and the error on others."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from rig.records.record_file import write_columns
from rig.report.diagnosis import _against, _times_of_each
from sim.inference.record.joined import read_records
from sim.inference.record.quantity import FALLING_OHM
from tests.sim.diagnosis.plate_record import levels, record

Peltier = Callable[..., tuple[int, str, str]]
ROOMS_DEGC = {"one": 21.0, "two": 27.0, "three": 24.0, "four": 23.0}
ROW = np.arange(100.0)


def two_records() -> SimpleNamespace:
    """A plate that cools by 0.1 K/s from 60 degC, twice; the second begins at 1000 s."""
    columns = {"temperature_degC": 60.0 - 0.1 * ROW, "current_A": np.where(ROW < 50, -1.0, -0.5)}
    records = [{"time_s": begin + ROW, **columns} for begin in (0.0, 1000.0)]
    return SimpleNamespace(record=read_records(records, FALLING_OHM, held_out=False), plate=None, drive=None)


def test_no_rate_is_taken_from_one_record_to_the_next() -> None:
    shown = dict(_against(two_records()))  # type: ignore[arg-type]
    assert shown["rate / K/s"] == pytest.approx(np.full(200, -0.1), abs=0.06)


def test_an_axis_has_the_times_of_each_file() -> None:
    axis = Figure().subplots()
    _times_of_each(axis, two_records().record)
    told = [float(label.get_text()) for label in axis.get_xticklabels()]
    assert min(told) == 0.0
    assert max(told) > 1050.0
    assert axis.get_xticks() == pytest.approx([t if t < 100.0 else t - 1000.0 + 99.0 + 60.0 for t in told])


def test_records_as_one_and_those_held_out_are_each_told(tmp_path: Path, peltier: Peltier) -> None:
    one, two, *others = [tmp_path / f"{name}.csv" for name in ROOMS_DEGC]
    for seed, (name, room) in enumerate(ROOMS_DEGC.items(), 5):
        write_columns(tmp_path / f"{name}.csv", record(room, levels(seed, 10), seed))
    words = ["--joint", "--budget", "5", "--report", tmp_path / "report", "--json", tmp_path / "said.json"]
    words += [word for path in others for word in ("--holdout", path)]
    status, out, err = peltier("diagnose", one, two, *words)
    assert status == 0, err
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    said = json.loads((tmp_path / "said.json").read_text())
    assert "Diagnosis of one.csv and two.csv" in page
    rows = [f"{name}.csv: 200 rows over 199 s, one every 1 s" for name in ("one", "two")]
    assert [found["source"] for found in said["holdouts"]] == [str(path) for path in others]
    errors = [found["channels"]["temperature_K"] for found in said["holdouts"]]
    held = [f"{path.name}: temperature {e['rmse_extended']:.4g} K" for path, e in zip(others, errors, strict=True)]
    assert [found["ambient_degC"] for found in said["holdouts"]] == pytest.approx([24.0, 23.0], abs=0.3)
    held += [f"room {found['ambient_degC']:.4g} \N{DEGREE SIGN}C" for found in said["holdouts"]]
    rooms = ", ".join(f"{Path(r['source']).name} {r['ambient_degC']:.4g} \N{DEGREE SIGN}C" for r in said["records"])
    for text in (*rows, *held, rooms):
        assert text in page
        assert text in out
    whole = said["channels"]["temperature_K"]
    assert sum(e["samples_holdout"] for e in errors) == whole["samples_holdout"]
    square = sum(e["samples_holdout"] * e["rmse_extended"] ** 2 for e in errors) / whole["samples_holdout"]
    assert square**0.5 == pytest.approx(whole["rmse_extended"])
