"""The measured film: identified, predicted, and tracked over three of its decades. Skips without the records."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

import pytest

COLUMNS = ("time_s=t_s", "temperature_degC=T_K@K", "resistance_ohm=R_ohm")


def test_identify_and_predict(peltier: Callable[..., tuple[int, str, str]], measured: Path, tmp_path: Path) -> None:
    record = measured / "vo2_film_major_loop.tsv"
    mapping = [word for column in COLUMNS for word in ("--column", column)]
    status, out, err = peltier("identify", record, *mapping, "--out", tmp_path / "film.toml")
    assert (status, err) == (0, "")
    assert "minor loops are not fixed" in out
    status, _, _ = peltier("predict", tmp_path / "film.toml", record, *mapping, "--json", tmp_path / "p.json")
    assert status == 0
    assert json.loads((tmp_path / "p.json").read_text())["rmse_dec"] <= 0.06


@pytest.mark.long
def test_tracks_three_decades(measured: Path, root: Path, tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("real_film", root / "benchmarks" / "real_film.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    scores = module.run(measured, tmp_path)
    assert scores["full"]["rms_dec"] <= 0.1
