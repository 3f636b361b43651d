"""The demo's promises: it calibrates, tracks, and beats the plain laws; its film is not of the model's class."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, root: Path) -> tuple[Path, dict[str, dict[str, float]]]:
    from rig.__main__ import main

    folder = tmp_path_factory.mktemp("demo")
    demo, found = root / "configs" / "demo.toml", folder / "result.json"
    assert main(["run", str(demo), "--out", str(folder / "run"), "--json", str(found)]) == 0
    return folder / "run", json.loads(found.read_text())


def test_it_tracks(result: tuple[Path, dict[str, dict[str, float]]]) -> None:
    assert result[1]["scores"]["full"]["rms_dec"] < 0.05


def test_it_beats_the_plain_laws(result: tuple[Path, dict[str, dict[str, float]]]) -> None:
    scores = {law: score["rms_dec"] for law, score in result[1]["scores"].items()}
    assert scores["pid"] > 3.0 * scores["full"]
    assert scores["feedforward"] > 1.5 * scores["full"]


def test_the_laws_are_designed_alike(result: tuple[Path, dict[str, dict[str, dict[str, float]]]]) -> None:
    designs = result[1]["designs"]
    for law in ("full", "pid"):
        assert designs[law]["margins"]["ms"] == pytest.approx(1.4, abs=0.03)
        assert designs[law]["margins"]["phase_margin_deg"] > 45.0


def test_the_target_asks_for_half_of_what_the_plate_can_do(result: tuple[Path, object]) -> None:
    """On the ramps the temperature moves at about half of the plate's rate; only the loop's crossings are faster."""
    import numpy as np

    from rig.config.model_file import read_model
    from rig.records.record_file import read_record

    model = read_model(result[0] / "calibration" / "MODEL.toml", needs=("plate",))
    assert model.film_records == (str(result[0] / "calibration" / "record.csv"),)  # no longer in a run's .part
    plate = model.plate
    assert plate is not None
    record = read_record(result[0] / "record.csv")
    inside = np.array(record.text_columns["phase"]) == "track"
    time, temperature = record["time_s"][inside], record["temperature_degC"][inside]
    target = -np.log10(record["target_ohm"][inside])
    moving = np.abs(np.gradient(target, time)) > 0.12
    rate = np.gradient(np.convolve(temperature, np.ones(5) / 5, "same"), time)[moving]
    able = np.array([plate.rate_range_K_per_s(t, 4.0) for t in temperature[moving]])
    share = np.where(rate > 0.0, rate / able[:, 1], rate / able[:, 0])
    assert 0.4 < float(np.median(share)) < 0.7


def test_folders_inside(result: tuple[Path, object]) -> None:
    for name in ("", "calibration", "pid", "feedforward"):
        for file in ("run.json", "record.csv", "report.html"):
            assert (result[0] / name / file).is_file(), (name, file)
    page = (result[0] / "report.html").read_text()
    assert "<script" not in page
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )


def test_calibration_model_predicts_its_record(
    result: tuple[Path, object], peltier: Callable[..., tuple[int, str, str]], tmp_path: Path
) -> None:
    folder = result[0] / "calibration"
    status, _, _ = peltier(
        "predict", folder / "MODEL.toml", folder / "record.csv", "--initial", "fitted", "--json", tmp_path / "p.json"
    )
    assert status == 0
    assert json.loads((tmp_path / "p.json").read_text())["rmse_dec"] < 0.015
