"""Heaters instead of a Peltier: a whole run and a calibration on drives of 0 to 1, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rig.analysis.diagnosed import possible_kinds
from rig.config.model_file import read_model
from rig.drivers.controller import OwnLimits
from rig.drivers.lakeshore import LakeShoreController
from rig.records.record import Record
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

HEATER = """kind = "heater"
drive_over_capacity_K_per_s = 2.0
seebeck_over_capacity_per_A_s = 0.0
resistance_over_capacity_K_per_A2_s = 0.0
conductance_over_capacity_per_s = 0.02
ambient_degC = 22.0
"""


def heater_bench(folder: Path, controller: str, meter: str = "keithley2450") -> Path:
    """The small bench with a heater for its plate, in its model and in the simulation."""
    target = '["start 20 kohm", "hold 10 s", "ramp to 8 kohm at 0.02 dec/s", "hold 5 s"]'
    path = write_bench(folder, target=target, more=f"[simulation.plate]\n{HEATER}")
    text = path.read_text().replace('driver = "meerstetter"', f'driver = "{controller}"')
    text = text.replace('driver = "keithley2000"', f'driver = "{meter}"').replace("current_A = 4.0", "current_A = 1.0")
    path.write_text(text.replace("period_s = 0.1", "period_s = 0.5"))
    (folder / "model.toml").write_text(MODEL.partition('kind = "peltier"')[0] + HEATER)
    return path


@pytest.mark.parametrize(("controller", "largest_dec"), [("lakeshore", 0.02), ("tclab", 0.04)])
def test_a_heater_tracks(peltier: Peltier, tmp_path: Path, controller: str, largest_dec: float) -> None:
    """The TCLab's thermometer has steps of 0.32 K, hence the larger error."""
    path = heater_bench(tmp_path, controller)
    out = peltier.quietly("run", path, "--out", tmp_path / "run", "--json", tmp_path / "result.json")
    assert f"{controller}: has no dead man" in out
    assert f"{controller}: a heater, which cannot cool; current_A is its drive, 0 to 1 of full drive" in out
    score = json.loads((tmp_path / "result.json").read_text())["scores"]["full"]
    assert score["rms_dec"] < largest_dec
    assert score["missing"] == 0
    document = json.loads((tmp_path / "run" / "run.json").read_text())
    assert document["start"]["drive_unit"] == "of full drive"
    rows = (tmp_path / "run" / "record.csv").read_text().splitlines()
    drive = rows[0].split(",").index("current_A")
    drives = [float(row.split(",")[drive]) for row in rows[1:]]
    assert 0.0 == min(drives) < max(drives) <= 1.0


@pytest.mark.parametrize(
    ("own", "said", "reported"),
    [
        (None, "no drive limit of its own, up to 95 degC (no lower temperature limit of its own);", [None, 95.0]),
        (OwnLimits(low_degC=10.0), ", from 10 degC (no upper temperature limit of its own);", [10.0, None]),
        (OwnLimits(low_degC=10.0, high_degC=95.0), ", 10 to 95 degC;", [10.0, 95.0]),
        (OwnLimits(), ", no temperature limits of its own;", None),
    ],
)
def test_check_tells_each_temperature_limit_by_itself(
    monkeypatch: pytest.MonkeyPatch,
    peltier: Peltier,
    tmp_path: Path,
    own: OwnLimits | None,
    said: str,
    reported: list[float | None] | None,
) -> None:
    """A Lake Shore has an upper one only."""
    if own is not None:
        monkeypatch.setattr(LakeShoreController, "own_limits", lambda _: own)
    out = peltier.quietly("check", heater_bench(tmp_path, "lakeshore"), "--json", tmp_path / "c.json")
    assert said in out
    found = json.loads((tmp_path / "c.json").read_text())["own_limits"]["temperature_degC"]
    assert found == (reported if reported is None else pytest.approx(reported))


def test_a_calibration_finds_the_heater(peltier: Peltier, tmp_path: Path) -> None:
    path = heater_bench(tmp_path, "tclab")
    path.write_text(
        path.read_text().replace("first_degC = 60.0", "first_degC = 25.0")
        + "[calibration]\ntemperature_degC = [50, 75]\ntransition_degC = [54, 68]\nrate_K_per_s = 0.5\nperiod_s = 0.5\n"
        + "dwell_s = 1.0\nminor_loops = 2\n"
    )
    peltier.quietly("calibrate", path, "--out", tmp_path / "film")
    plate = read_model(tmp_path / "film" / "MODEL.toml", needs=("plate",)).plate
    assert plate is not None
    assert plate.kind == "heater"
    assert plate.drive_over_capacity_K_per_s == pytest.approx(2.0, rel=0.03)
    assert plate.conductance_over_capacity_per_s == pytest.approx(0.02, rel=0.05)


def test_a_cold_end_that_the_room_does_not_allow(peltier: Peltier, tmp_path: Path) -> None:
    path = heater_bench(tmp_path, "tclab")
    text = path.read_text().replace("first_degC = 60.0", "first_degC = 25.0")
    path.write_text(text + "[calibration]\ntemperature_degC = [20, 75]\nperiod_s = 0.5\n")
    err = peltier.fails("calibrate", path, "--out", tmp_path / "film")
    assert "calibration.temperature_degC: [20, 75]" in err
    assert "expected a higher cold end" in err


@pytest.mark.parametrize(("controller", "kind"), [("tclab", "peltier"), ("meerstetter", "heater")])
def test_a_model_of_the_other_kind_is_refused(peltier: Peltier, tmp_path: Path, controller: str, kind: str) -> None:
    path = heater_bench(tmp_path, controller)
    if kind == "peltier":
        (tmp_path / "model.toml").write_text(MODEL.replace("1.6e-3", "5e-3"))
    assert f"plate.kind '{kind}'" in peltier.fails("run", path, "--out", tmp_path / "run")


def test_a_limit_that_is_no_share(peltier: Peltier, tmp_path: Path) -> None:
    path = heater_bench(tmp_path, "tclab")
    path.write_text(path.read_text().replace("current_A = 1.0", "current_A = 4.0"))
    assert "a share of full drive" in peltier.fails("check", path)


@pytest.mark.parametrize(
    ("drives", "kinds"),
    [
        ([[0.0, 1.0]], ("peltier", "heater")),
        ([[0.0, 1.0], [0.4, 0.8]], ("peltier", "heater")),
        ([[0.0, 1.0], [-1.0, 1.0]], ("peltier",)),
        ([[-1.0, 1.0], [0.0, 1.0]], ("peltier",)),
        ([None, [0.0, 1.0]], ("peltier", "heater")),
        ([None], ("peltier",)),
    ],
)
def test_a_drive_that_ever_cools_is_no_heater_s(drives: list[list[float] | None], kinds: tuple[str, ...]) -> None:
    records = [Record({"time_s": np.arange(2.0)} | ({"current_A": np.array(d)} if d else {})) for d in drives]
    assert possible_kinds(records, None) == kinds
    assert possible_kinds(records, "heater") == ("heater",)
