"""A run from the command line on the simulated rig: its folder, its numbers, and every way out of it."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import time
from itertools import pairwise
from pathlib import Path

import pytest
from scipy.io import netcdf_file

from rig.config.model_file import read_model
from tests.peltier import Peltier, begun
from tests.rig.small import write_bench


def test_run_folder_is_whole(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    status, out, _ = peltier("run", path, "--out", tmp_path / "run", "--json", tmp_path / "result.json")
    folder = tmp_path / "run"
    assert status == 0
    assert "output off, confirmed" in out
    assert {item.name for item in folder.iterdir()} >= {
        "run.json",
        "config.toml",
        "record.csv",
        "record.nc",
        "events.jsonl",
        "report.html",
        "figures",
    }
    assert not (tmp_path / "run.part").exists()
    assert (folder / "config.toml").read_text() == path.read_text()
    document = json.loads((folder / "run.json").read_text())
    assert document["stop"]["reason"] == "done"
    assert document["stop"]["output_off_confirmed"] is True
    assert document["start"]["instruments"]["controller"]["maker"] == "Meerstetter"
    with (folder / "record.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert document["stop"]["rows"] == len(rows)
    times = [float(row["time_s"]) for row in rows]
    assert all(b > a for a, b in pairwise(times))
    with netcdf_file(folder / "record.nc", mmap=False) as file:
        assert file.variables["temperature_degC"].shape == (len(rows),)
        assert file.variables["temperature_degC"][5] == float(rows[5]["temperature_degC"])
    score = json.loads((tmp_path / "result.json").read_text())["scores"]["full"]
    assert score["rms_dec"] < 0.01  # the controller's model is the truth here: noise and corners are left
    events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
    assert [e["text"] for e in events if e["event"] == "phase"][-1] == "track"


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(("law", "rms_dec"), [("pid", 0.15), ("feedforward", 0.02), ("instrument_pid", 0.5)])
def test_every_law_runs(peltier: Peltier, tmp_path: Path, law: str, rms_dec: float) -> None:
    path = write_bench(tmp_path)
    path.write_text(
        path.read_text().replace('model = "model.toml"\ntarget', f'model = "model.toml"\nlaw = "{law}"\ntarget', 1)
    )
    peltier.quietly("run", path, "--out", tmp_path / "run", "--json", tmp_path / "result.json")
    assert json.loads((tmp_path / "result.json").read_text())["scores"][law]["rms_dec"] < rms_dec


@pytest.mark.parametrize(
    ("kind", "target", "column"),
    [
        ("temperature_profile", '["start 40 degC", "ramp to 60 degC at 0.5 K/s", "hold 10 s"]', "setpoint_degC"),
        ("hold", '["start 45 degC", "hold 30 s"]', "setpoint_degC"),
        ("current_profile", '["start 0 A", "hold 2 s", "step to 1 A", "hold 10 s"]', "current_A"),
    ],
)
def test_profiles(peltier: Peltier, tmp_path: Path, kind: str, target: str, column: str) -> None:
    path = write_bench(tmp_path, target=target, kind=kind)
    peltier.quietly("run", path, "--out", tmp_path / "run")
    with (tmp_path / "run" / "record.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1][column]) != 0.0
    if column == "setpoint_degC":
        assert abs(float(rows[-1]["temperature_degC"]) - float(rows[-1]["setpoint_degC"])) < 0.1


def test_interlock_trips_with_the_output_off(peltier: Peltier, tmp_path: Path) -> None:
    hot = write_bench(tmp_path, limits="[10, 55]", target='["start 45 degC", "hold 10 s"]', kind="hold")
    assert "outside the limits" in peltier.fails("run", hot, "--out", tmp_path / "hot", status=10)
    document = json.loads((tmp_path / "hot.part" / "run.json").read_text())
    assert document["stop"]["reason"] == "temperature_limit"
    assert document["stop"]["output_off_confirmed"] is True


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGINT,
        *(pytest.param(s, marks=pytest.mark.long) for s in (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)),
    ],
)
def test_signals_end_with_the_output_off(tmp_path: Path, root: Path, number: signal.Signals) -> None:
    path = write_bench(tmp_path, time="real")
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    process = begun("run", path, "--out", tmp_path / "run", cwd=root, stderr=subprocess.PIPE, env=environment)
    record = tmp_path / "run.part" / "record.csv"
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and (not record.exists() or len(record.read_text().splitlines()) < 3):
        time.sleep(0.02)
    process.send_signal(number)
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 128 + number, err
    assert "output off, confirmed" in err
    document = json.loads((tmp_path / "run.part" / "run.json").read_text())
    assert document["stop"]["reason"] == "signal"
    assert document["stop"]["output_off_confirmed"] is True
    rows = record.read_text().splitlines()
    assert document["stop"]["rows"] == len(rows) - 1


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("controller", "meter", "law"),
    [
        ("meerstetter", "keithley2400", "full"),
        ("meerstetter", "hp34401a", "full"),
        ("srs_ldc500", "keithley2000", "full"),
        ("te_technology", "keithley2000", "instrument_pid"),
    ],
)
def test_every_instrument_tracks(peltier: Peltier, tmp_path: Path, controller: str, meter: str, law: str) -> None:
    path = write_bench(tmp_path, target='["start 20 kohm", "hold 10 s", "ramp to 8 kohm at 0.02 dec/s", "hold 5 s"]')
    text = path.read_text().replace('driver = "meerstetter"', f'driver = "{controller}"')
    text = text.replace('driver = "keithley2000"', f'driver = "{meter}"')
    text = text.replace("period_s = 0.1", f'period_s = 0.5\nlaw = "{law}"')
    path.write_text(text)
    peltier.quietly("run", path, "--out", tmp_path / "run", "--json", tmp_path / "result.json")
    score = json.loads((tmp_path / "result.json").read_text())["scores"][law]
    assert score["rms_dec"] < (0.02 if law == "full" else 0.6)
    assert score["missing"] == 0


def test_a_controller_without_currents_says_so(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, changed=[('driver = "meerstetter"', 'driver = "te_technology"')])
    assert "takes no current" in peltier.fails("run", path, "--out", tmp_path / "run")


def test_an_unfinished_run_is_never_overwritten(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    left = tmp_path / "run.part"
    left.mkdir()
    (left / "record.csv").write_text("time_s\n0\n")
    assert "did not finish" in peltier.fails("run", path, "--out", tmp_path / "run")
    assert (left / "record.csv").read_text() == "time_s\n0\n"


def test_a_plate_that_is_too_weak_is_refused_before_it_heats(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text().replace("current_A = 4.0", "current_A = 0.5", 1))
    err = peltier.fails("run", path, "--out", tmp_path / "run")
    assert "does not reach" in err
    assert "0.5 A" in err
    assert not (tmp_path / "run.part").exists()


def test_the_folder_stands_alone(finished_run: Path) -> None:
    """Whoever gets it a year later needs no other file of that bench."""
    folder = finished_run
    with (folder / "target.csv").open() as file:
        target = list(csv.DictReader(file))
    assert float(target[0]["target_ohm"]) == pytest.approx(20e3)
    assert float(target[-1]["target_ohm"]) == pytest.approx(5e3)
    assert read_model(folder / "model.toml", needs=("film", "plate")).plate is not None
    document = json.loads((folder / "run.json").read_text())
    assert document["result"]["score"]["rms_dec"] < 0.01
    with netcdf_file(folder / "record.nc", mmap=False) as nc:
        phase = nc.variables["phase"]
        words = phase.flag_meanings.decode().split()
        assert words == ["polarity", "condition", "approach", "settle", "track"]
        assert phase[-1] == 4


def test_a_temperature_profile_is_scored_against_what_was_asked(peltier: Peltier, tmp_path: Path) -> None:
    """A step of 20 K, which no plate follows at once, counts in full."""
    target = '["start 40 degC", "hold 5 s", "step to 60 degC", "hold 15 s"]'
    path = write_bench(tmp_path, target=target, kind="temperature_profile")
    out = peltier.succeeds("run", path, "--out", tmp_path / "run")
    with (tmp_path / "run" / "record.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["phase"] == "profile"]
    errors = [float(row["temperature_degC"]) - float(row["setpoint_degC"]) for row in rows]
    rms = (sum(e * e for e in errors) / len(errors)) ** 0.5
    assert rms > 3.0
    assert f"RMS error {rms:.4f} K" in out
    assert {float(row["setpoint_degC"]) for row in rows} <= {40.0, 60.0}
