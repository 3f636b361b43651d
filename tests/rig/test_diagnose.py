"""`peltier diagnose`: the JSON of the interface, the extended model's file, the report, bad input, measured records."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rig.__main__ import main
from rig.config.model_file import read_model
from rig.records.record_file import write_columns
from rig.report.diagnosis_words import model_comment
from tests.peltier import Peltier
from tests.sim.diagnosis.plate_record import record as plate_record
from tests.truth import NOISE_DEC, record

ROWS, TAU_S = 2000, 1.0


@pytest.fixture(scope="module")
def diagnosed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A folder with a record that has one hidden effect, and what the diagnosis says of it."""
    folder = tmp_path_factory.mktemp("diagnosed")
    hidden = {"film_lag": {"tau_s": TAU_S}}
    write_columns(folder / "record.csv", record(1, hidden, rows=ROWS, capacity_J_per_K=10.0))
    words = ["diagnose", folder / "record.csv", "--json", folder / "out.json", "--report", folder / "report"]
    assert main([str(word) for word in words]) == 0
    return folder, json.loads((folder / "out.json").read_text())


def test_the_json_is_that_of_the_interface(diagnosed: tuple[Path, Any]) -> None:
    _, said = diagnosed
    assert said["format"] == "peltier-diagnosis/1"
    assert set(said) == {
        "format", "verdict", "effects", "channels", "unexplained", "film", "plate", "assumed", "candidates",
        "upper_limits", "rows", "records", "holdouts", "warnings", "next_experiment", "model",
    }  # fmt: skip
    rows = said["rows"]
    assert rows["fitted"] + rows["deciding"] + rows["judging"] == ROWS
    assert min(rows["deciding"], rows["judging"]) > 0.08 * rows["fitted"]
    assert said["channels"]["resistance_dec"]["samples_holdout"] <= rows["judging"]
    assert {left["rule"] for left in rows["left_out"]} == {"stamped where the plate is not known"}  # both ends
    assert [Path(one["source"]).name for one in said["records"]] == ["record.csv"]
    limits = {limit["name"]: limit for limit in said["upper_limits"]}
    assert "film_lag" not in limits
    assert 0.0 < limits["series_resistance"]["limit95"] < 1e3
    assert said["verdict"] == "explained"
    assert [effect["name"] for effect in said["effects"]] == ["film_lag"]
    effect = said["effects"][0]
    assert set(effect) == {
        "name",
        "parameters",
        "evidence",
        "false_alarm",
        "false_alarm_kind",
        "indistinguishable_from",
        "gain",
    }
    tau = effect["parameters"]["tau_s"]
    assert tau["value"] == pytest.approx(TAU_S, rel=0.1)
    assert tau["ci95"][0] < tau["value"] < tau["ci95"][1]
    channel = said["channels"]["resistance_dec"]
    assert channel["noise"] == pytest.approx(NOISE_DEC, rel=0.1)
    assert channel["rmse_extended"] < 1.1 * channel["noise"] < channel["rmse_base"]
    assert said["film"]["memoryless"] in ("none", "linear", "arrhenius", "tanh", "polynomial", "sin", "cos")
    assert said["film"]["operators"] >= 1
    assert said["plate"]["kind"] == "peltier"
    assert said["plate"]["doubts"] == []
    assert said["candidates"] == []  # what is named tells the held-out rows best


def test_the_extended_model_predicts_as_well_as_the_diagnosis_says(
    diagnosed: tuple[Path, Any], peltier: Peltier
) -> None:
    folder, said = diagnosed
    model = read_model(Path(said["model"]))
    assert model.film is not None
    assert model.plate is not None
    assert [effect["name"] for effect in model.effects] == ["film_lag"]
    words = ("--initial", "fitted", "--json", folder / "predicted.json")
    peltier.succeeds("predict", said["model"], folder / "record.csv", *words)
    predicted = json.loads((folder / "predicted.json").read_text())
    assert predicted["film_driven_by"] == "current"
    assert predicted["rmse_dec"] < 1.1 * said["channels"]["resistance_dec"]["rmse_extended"]
    assert predicted["rmse_K"] < 1.1 * said["channels"]["temperature_K"]["rmse_extended"]


def test_the_report_is_one_page_with_figures_and_the_json_beside_it(diagnosed: tuple[Path, Any]) -> None:
    folder, said = diagnosed
    page = (folder / "report" / "report.html").read_text(encoding="utf-8")
    assert "Explained: the film lags behind the plate (film_lag, time constant" in page
    assert page.count("<svg") == 8  # four figures, each for two widths
    assert "<script" not in page
    for name in ("http://www.w3.org", "http://purl.org", "http://creativecommons.org", "https://matplotlib.org"):
        page = page.replace(name, "")
    assert re.search("https?://", page) is None
    beside = json.loads((folder / "report" / "diagnosis.json").read_text())
    assert beside == said


def small(folder: Path, rows: int = 200, **columns: Any) -> Path:
    """A record of a few rows."""
    path = folder / "record.csv"
    write_columns(path, {"time_s": np.arange(rows) * 1.0, **columns})
    return path


def noise(rows: int, size: float) -> Any:
    return size * np.random.default_rng(0).standard_normal(rows)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"temperature_degC": 25.0 + noise(200, 0.01)}, "temperature_degC: moves by"),
        ({"temperature_degC": 25.0 + np.arange(200) * 0.1}, "expected also current_A or resistance_ohm"),
        (
            {"temperature_degC": 25.0 + np.arange(200) * 0.1, "resistance_ohm": 1e5 * 10.0 ** noise(200, 0.002)},
            "resistance_ohm: changes by",
        ),
        ({"temperature_degC": 25.0 + np.arange(200) * 0.1, "current_A": np.zeros(200)}, "current_A: 0 in all rows"),
        ({"temperature_degC": np.full(200, np.nan), "current_A": np.ones(200)}, "temperature_degC: no finite number"),
    ],
)
def test_a_record_that_tells_nothing_is_told_so(
    tmp_path: Path, peltier: Peltier, columns: dict[str, Any], said: str
) -> None:
    status, out, err = peltier("diagnose", small(tmp_path, **columns))
    assert status == 2
    assert said in err
    assert "expected" in err or "no finite" in err
    assert "Traceback" not in out + err


def test_a_record_that_is_too_short_is_told_so(tmp_path: Path, peltier: Peltier) -> None:
    path = small(tmp_path, 12, temperature_degC=np.arange(12.0), current_A=np.ones(12))
    assert "12 rows; expected at least" in peltier.fails("diagnose", path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--budget", "abc"], "--budget: invalid float value: 'abc'"),
        (["--assume"], "--assume: expected one argument"),
        (["--assume", "sensor_lag", "--assume", "sensor_lag:tau_s=2"], "--assume: sensor_lag: given twice; expected"),
    ],
)
def test_words_that_say_nothing_are_told_in_one_line(
    tmp_path: Path, peltier: Peltier, words: list[str], said: str
) -> None:
    path = small(tmp_path, temperature_degC=np.arange(200.0), current_A=np.ones(200))
    err = peltier.fails("diagnose", path, *words)
    assert said in err
    assert len(err.splitlines()) == 1


def test_out_takes_one_record(tmp_path: Path, peltier: Peltier) -> None:
    path = small(tmp_path, temperature_degC=np.arange(200.0), current_A=np.ones(200))
    assert "--out" in peltier.fails("diagnose", path, path, "--out", tmp_path / "model.toml")


def test_a_share_of_the_full_drive_is_no_ampere_and_the_model_bears_its_doubts(
    tmp_path: Path, peltier: Peltier
) -> None:
    """In text, page, JSON and model file. Small currents and a noisy thermometer leave Joule's heat open."""
    columns = plate_record(24.0, 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, 30), 4, noise_K=0.05)
    path = tmp_path / "record.csv"
    write_columns(path, {"duty" if name == "current_A" else name: values for name, values in columns.items()})
    folder = tmp_path / "report"
    words = ["--column", "current_A=duty@duty", "--report", folder]
    status, out, _ = peltier("diagnose", path, *words)
    told = "A stands for the full drive here: current_A is a share of it (duty)"
    page, model = ((folder / name).read_text(encoding="utf-8") for name in ("report.html", "model.toml"))
    assert (status, out.count(told), page.count(told), model.count(f"# {told}")) == (0, 1, 1, 1)
    said = json.loads((folder / "diagnosis.json").read_text())
    assert [w["code"] for w in said["warnings"]].count("share_of_full_drive") == 1
    assert "0.02 to 0.3" not in page  # usual dead bands in ampere
    (doubt,) = [d for d in said["plate"]["doubts"] if d.startswith("resistance_over_capacity")]
    assert f"# plate: {doubt}\n" in model


def test_a_model_file_says_which_sizes_are_not_fixed() -> None:
    values = {"sink_capacity_ratio": (48.0, None), "sink_conductance_ratio_per_s": (0.14, (0.1, 0.2))}
    finding = SimpleNamespace(name="heat_sink_warmup", parameters=values)
    found = SimpleNamespace(plate=None, warnings=[], findings=[finding], sources=("a/b.csv",), written="extended")
    assert model_comment(cast(Any, found)).splitlines() == [
        "extended model of the diagnosis of b.csv",
        "heat_sink_warmup: sink_capacity_ratio: not determined by this record",
    ]


def test_a_measured_film_has_a_memoryless_part(measured: Path, tmp_path: Path, peltier: Peltier) -> None:
    columns = ["--column", "time_s=t_s", "--column", "temperature_degC=T_K@K", "--column", "resistance_ohm=R_ohm"]
    words = (*columns, "--json", tmp_path / "out.json", "--out", tmp_path / "model.toml", "--report", tmp_path / "r")
    out = peltier.succeeds("diagnose", measured / "vo2_film_major_loop.tsv", *words)
    assert out.startswith("Rows too far apart")
    said = json.loads((tmp_path / "out.json").read_text())
    assert said["film"]["memoryless"] != "none"
    assert said["verdict"] == "too_short"  # one loop, whose rows are 0.6 K apart on its flanks
    assert said["effects"] == []
    assert "minor loops" in said["next_experiment"][0]
    assert said["upper_limits"] == []  # what was not looked for is not excluded
    assert said["channels"]["temperature_K"] is None
    assert said["channels"]["resistance_dec"]["rmse_extended"] < 0.02
    assert {left["rule"] for left in said["rows"]["left_out"]} == {"stamped where the plate is not known"}
    peltier.succeeds(
        "predict",
        tmp_path / "model.toml",
        measured / "vo2_film_major_loop.tsv",
        *columns,
        "--json",
        tmp_path / "p.json",
    )
    assert json.loads((tmp_path / "p.json").read_text())["rmse_dec"] < 0.06
