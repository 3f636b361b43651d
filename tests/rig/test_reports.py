"""Reports of runs: one definition of the error wherever it is told, runs that ended early, and `peltier report`."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.__main__ import main
from rig.analysis.error import score
from tests.peltier import Peltier
from tests.rig.small import write_bench


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a run whose target steps at its start, with a law to compare with; and what was printed."""
    folder = tmp_path_factory.mktemp("tracked")
    path = write_bench(folder, target='["start 20 kohm", "ramp to 8 kohm in 1 s", "hold 14 s"]')
    path.write_text(path.read_text().replace("settle_s = 3.0", 'settle_s = 3.0\ncompare = ["feedforward"]'))
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["run", str(path), "--out", str(folder / "run")]) == 0
    return folder / "run", said.getvalue()


def test_the_error_is_told_once_and_over_the_whole_target(tracked: tuple[Path, str]) -> None:
    folder, printed = tracked
    with (folder / "record.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] == "track"]
    errors = np.array([np.log10(float(r["resistance_ohm"]) / float(r["target_ohm"])) for r in rows])
    rms, largest = float(np.sqrt(np.mean(errors**2))), float(np.max(np.abs(errors)))
    hardest_s = float(rows[int(np.argmax(np.abs(errors)))]["time_s"]) - float(rows[0]["time_s"])
    assert hardest_s < 1.5  # in the first tenth of the target
    kept = json.loads((folder / "run.json").read_text())["result"]["score"]
    assert kept["rms_dec"] == pytest.approx(rms, rel=1e-9)
    assert kept["max_dec"] == pytest.approx(largest, rel=1e-9)
    assert kept["max_at_s"] == pytest.approx(hardest_s, abs=1e-9)
    report = (folder / "report.html").read_text()
    for text in (f"{rms:.4f} dec", f"{largest:.3f} dec"):
        assert text in printed
        assert text in report
    assert "over the whole target" in report


def test_every_report_draws_the_error(tracked: tuple[Path, str], peltier: Peltier, tmp_path: Path) -> None:
    folder, _ = tracked
    hold = write_bench(tmp_path, target='["start 45 degC", "hold 5 s"]', kind="hold")
    assert peltier("run", hold, "--out", tmp_path / "hold")[0] == 0
    for one in (folder, folder / "feedforward", tmp_path / "hold"):
        assert "The error over time, measured - wanted" in (one / "report.html").read_text()
        assert (one / "figures" / "errors.svg").is_file()


def test_a_report_is_made_from_the_folder_alone(tracked: tuple[Path, str], peltier: Peltier, tmp_path: Path) -> None:
    folder, _ = tracked
    assert peltier("report", folder, "--out", tmp_path / "anew") == (0, f"{tmp_path / 'anew' / 'report.html'}\n", "")
    first, anew = ((one / "report.html").read_text() for one in (folder, tmp_path / "anew"))
    there = os.path.relpath(folder / "feedforward", tmp_path / "anew")
    assert anew == first.replace('href="feedforward/', f'href="{there}/')
    assert anew != first
    inner = folder / "feedforward"
    before = (inner / "report.html").read_bytes()
    (inner / "report.html").unlink()
    assert peltier("report", inner)[0] == 0
    assert (inner / "report.html").read_bytes() == before


def test_a_run_that_tripped_has_its_report(peltier: Peltier, tmp_path: Path) -> None:
    hot = write_bench(tmp_path, limits="[10, 62]", target='["start 0 A", "hold 1 s", "step to 2 A", "hold 60 s"]')
    text = hot.read_text().replace('kind = "track_resistance"\nmodel = "model.toml"', 'kind = "current_profile"')
    hot.write_text(text)
    err = peltier.fails("run", hot, "--out", tmp_path / "hot", status=10)
    place = tmp_path / "hot.part" / "report.html"
    assert f"report: {place}" in err
    assert err.index("output off, confirmed") < err.index("report: ")
    report = place.read_text()
    assert "ended early" in report
    assert "outside the limits" in report
    assert peltier("report", tmp_path / "hot.part")[0] == 0
    assert place.read_text() == report
    assert f"did you mean {tmp_path / 'hot.part'}" in peltier.fails("report", tmp_path / "hot")


def test_a_run_that_was_killed_while_it_calibrated(tracked: tuple[Path, str], peltier: Peltier, tmp_path: Path) -> None:
    """It has no run.json of its own: what is inside is reported, there or below --out, and that is said."""
    killed = tmp_path / "run.part"
    killed.mkdir()
    shutil.copytree(
        tracked[0] / "feedforward", killed / "feedforward.part", ignore=shutil.ignore_patterns("report.html")
    )
    status, out, err = peltier("report", killed)
    assert (status, out) == (0, f"{killed / 'feedforward.part' / 'report.html'}\n")
    assert "no run.json: the run ended before its own rows began" in err
    assert (killed / "feedforward.part" / "report.html").is_file()
    assert (
        peltier("report", killed, "--out", tmp_path / "r")[1] == f"{tmp_path / 'r' / 'feedforward' / 'report.html'}\n"
    )
    (killed / "feedforward.part").rename(killed / "another")
    status, _, err = peltier("report", killed)
    assert (status, err) == (2, f"{killed}: no run.json; expected a run folder\n")


def spoiled(folder: Path, way: str) -> None:
    """What is no run folder, in some way."""
    document: dict[str, Any] = {"format": "peltier-run/1", "start": {"what": "law full", "at": "2026-01-01"}}
    folder.mkdir()
    if way == "empty":
        return
    document["start"] |= {"settings": {}, "instruments": {}}
    texts = {"no_json": "{", "other": '{"format": "peltier-check/1"}', "list": "[]"}
    texts["no_start"] = '{"format": "peltier-run/1"}'
    (folder / "run.json").write_text(texts.get(way, json.dumps(document)))
    if way == "no_phase":
        (folder / "record.csv").write_text("time_s,temperature_degC,current_A\n0,25,0\n1,25,0\n")
    if way == "no_settings":
        document["stop"] = {"reason": "done"}
        (folder / "run.json").write_text(json.dumps(document))
        (folder / "record.csv").write_text("time_s,temperature_degC,current_A,phase\n0,25,0,track\n1,25,0,track\n")


@pytest.mark.parametrize(
    "way", ["missing", "empty", "no_json", "other", "list", "no_start", "no_record", "no_phase", "no_settings"]
)
def test_what_is_no_run_folder_ends_in_a_line(peltier: Peltier, tmp_path: Path, way: str) -> None:
    if way != "missing":
        spoiled(tmp_path / "run", way)
    status, out, err = peltier("report", tmp_path / "run")
    assert (status, out) == (2, "")
    assert len(err.strip().splitlines()) == 1
    assert str(tmp_path / "run") in err
    assert "expected" in err or "no such file" in err


def test_a_run_without_a_single_reading_has_no_score() -> None:
    class Blind:
        columns = ("resistance_ohm", "target_ohm")

        def column(self, name: str) -> Any:
            return np.array(["track"] * 3) if name == "phase" else np.full(3, np.nan)

    assert score(Blind(), "full", 4.0) is None
