"""The demo's promises: it calibrates, tracks, and beats the plain laws; its film is not of the model's class."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.peltier import Peltier


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


def test_folders_inside(result: tuple[Path, object]) -> None:
    for name in ("", "calibration", "pid", "feedforward"):
        for file in ("run.json", "record.csv", "report.html"):
            assert (result[0] / name / file).is_file(), (name, file)
    page = (result[0] / "report.html").read_text()
    assert "<script" not in page
    assert "http://" not in page.replace("http://www.w3.org", "").replace("http://purl.org", "").replace(
        "http://creativecommons.org", ""
    )


def test_calibration_model_predicts_its_record(result: tuple[Path, object], peltier: Peltier, tmp_path: Path) -> None:
    folder = result[0] / "calibration"
    peltier.succeeds(
        "predict", folder / "MODEL.toml", folder / "record.csv", "--initial", "fitted", "--json", tmp_path / "p.json"
    )
    assert json.loads((tmp_path / "p.json").read_text())["rmse_dec"] < 0.015
