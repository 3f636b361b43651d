"""`peltier improve`: a run diagnosed, its model extended, run again on the simulated rig, and what that gains."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.__main__ import main
from rig.analysis.error import TargetError
from rig.config.configuration import read_configuration
from rig.config.model_file import read_model
from rig.config.toml_file import configuration_with_model, read_toml
from rig.experiment.improvement import gain_of, news, no_better
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record, read_record
from rig.report.batch import RecordReport, files_in
from tests.peltier import Peltier
from tests.rig.small import MODEL, write_bench

pytestmark = pytest.mark.usefixtures("undrawn")

PROFILE = (
    '["start 40 degC", "hold 3 s", "ramp to 55 degC at 1 K/s", "hold 3 s", "ramp to 45 degC at 0.7 K/s", "hold 5 s"]'
)
TARGET = '["start 20 kohm", "hold 10 s", "ramp to 5 kohm at 0.02 dec/s", "hold 10 s", "ramp to 12 kohm at 0.02 dec/s"]'
METER = '[bench.meter]\ndriver = "keithley2000"\nport = "sim://"\n'
DELAY = '\n[[simulation.effects]]\nname = "actuator_delay"\ndelay_s = 0.8\n'
LAG = '\n[[simulation.effects]]\nname = "film_lag"\ntau_s = 1.0\n'


def test_ticks_that_a_run_missed_shift_no_other_row() -> None:
    time = 0.1 * np.arange(600.0)
    error = np.where(time < 20.0, 1.0, 0.1) * np.sin(time)
    missed = np.delete(np.arange(600), slice(100, 130))
    found = gain_of(TargetError("K", time, error), TargetError("K", time[missed] + 0.003, error[missed]))
    assert found is not None
    assert found.reduction == 0.0
    assert found.ci95 == (0.0, 0.0)


def write_profile(folder: Path, effects: str = "") -> Path:
    """A rig without an ohmmeter that follows a temperature: its record is diagnosed in seconds."""
    config = write_bench(folder, target=PROFILE, more=effects)
    text = config.read_text().replace(METER, "").replace("track_resistance", "temperature_profile")
    config.write_text(text)
    return config


class Terminal(io.StringIO):
    """What somebody types."""

    def isatty(self) -> bool:
        return True


def circle(config: Path, folder: Path) -> dict[str, Any]:
    """A run into first/, its improvement into better/, and what was said."""
    assert main(["run", str(config), "--out", str(folder / "first")]) == 0
    words = ["--config", str(config), "--out", str(folder / "better"), "--yes", "--json", str(folder / "said.json")]
    assert main(["improve", str(folder / "first"), *words]) == 0
    said: dict[str, Any] = json.loads((folder / "said.json").read_text())
    return said


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """config.toml of a rig whose current acts late, and the circle with a model that knows of nothing."""
    folder = tmp_path_factory.mktemp("improve")
    circle(write_profile(folder, DELAY), folder)
    return folder


@pytest.mark.long
def test_the_circle_gains(folder: Path) -> None:
    said = json.loads((folder / "said.json").read_text())
    assert said["format"] == "peltier-improvement/1"
    assert [e["name"] for e in said["effects"]] == said["new"] == ["actuator_delay"]
    assert said["effects"][0]["parameters"]["delay_s"]["value"] == pytest.approx(0.8, abs=0.05)
    first, second = (
        json.loads((run / "run.json").read_text()) for run in (folder / "first", folder / "better" / "run")
    )
    for key, run in (("first", first), ("second", second)):
        assert said[key] == pytest.approx(run["result"]["error"])
    assert said["second"]["rms_K"] < 0.7 * said["first"]["rms_K"]
    assert said["reduction"] == pytest.approx(1.0 - said["second"]["rms_K"] / said["first"]["rms_K"], abs=0.02)
    assert said["reduction_ci95"][0] < said["reduction"] < said["reduction_ci95"][1]
    assert second["start"]["settings"]["limits"] == first["start"]["settings"]["limits"]


@pytest.mark.long
def test_a_film_that_lags_is_followed_better(tmp_path: Path) -> None:
    said = circle(write_bench(tmp_path, target=TARGET, more=LAG), tmp_path)
    assert [e["name"] for e in said["effects"]] == ["film_lag"]
    assert said["reduction_ci95"][0] > 0.0
    assert "decades in the place of" in (tmp_path / "better" / "report.html").read_text()


@pytest.mark.long
def test_what_ran_is_kept(folder: Path) -> None:
    better = folder / "better"
    assert [dict(e)["name"] for e in read_model(better / "diagnosis" / "model.toml").effects] == ["actuator_delay"]
    file = read_configuration(better / "config.toml")
    assert file.beside(str(file.content.experiment.model)) == better / "diagnosis" / "model.toml"
    page = (better / "report.html").read_text()
    assert "With actuator_delay in the model the RMS error is" in page
    assert "% less" in page
    for link in ("../first/report.html", "diagnosis/report.html", "run/report.html"):
        assert f'href="{link}"' in page
        assert (better / link).is_file()
    assert json.loads((better / "improvement.json").read_text()) == json.loads((folder / "said.json").read_text())


def test_nothing_is_heated_where_nothing_is_named(peltier: Peltier, tmp_path: Path) -> None:
    config = write_profile(tmp_path)
    assert peltier("run", config, "--out", tmp_path / "first")[0] == 0
    out = peltier.succeeds("improve", tmp_path / "first", "--config", config, "--out", tmp_path / "b", "--yes")
    assert "Not run again: no effect is named in this record." in out
    assert not (tmp_path / "b" / "run").exists()
    assert json.loads((tmp_path / "b" / "improvement.json").read_text())["second"] is None


CANDIDATE = {
    "names": ["sensor_lag"],
    "parameters": {"sensor_lag": {"tau_s": {"value": 0.5, "ci95": None}}},
    "rmse_holdout": {"temperature_K": 0.02},
    "why_not_named": "something else is left with it",
}


@pytest.fixture
def diagnosis(folder: Path, monkeypatch: pytest.MonkeyPatch) -> RecordReport:
    """That of the first run, known already: it takes seconds. A test changes what it says."""
    files = files_in(folder / "better" / "diagnosis")
    said = RecordReport(json.loads(files["diagnosis.json"]), ("Explained: actuator_delay.",), files)
    monkeypatch.setattr("rig.report.diagnosis.report_diagnosis", lambda *words, **more: said)
    return said


def test_a_candidate_is_tried(peltier: Peltier, folder: Path, tmp_path: Path, diagnosis: RecordReport) -> None:
    """A name says what is there, a model has only to predict: the second run judges."""
    text = diagnosis.files["model.toml"].replace(b"actuator_delay", b"sensor_lag")
    diagnosis.files["candidate.toml"] = text.replace(b"delay_s", b"tau_s")
    document = diagnosis.document
    document |= {"effects": [], "candidates": [CANDIDATE]}
    words = ("improve", folder / "first", "--config", folder / "config.toml", "--yes", "--out")
    out = peltier.succeeds(*words, tmp_path / "tried")
    said = json.loads((tmp_path / "tried" / "improvement.json").read_text())
    assert (said["new"], said["tried"]) == ([], ["sensor_lag"])
    assert said["model"].endswith("candidate.toml")
    ran = read_model(tmp_path / "tried" / "run" / "model.toml")
    assert [effect["name"] for effect in ran.effects] == ["sensor_lag"]
    assert "With sensor_lag (found, and not named) in the model the RMS error is" in out
    assert "found, not named, and tried" in (tmp_path / "tried" / "report.html").read_text()
    document["effects"] = [{"name": "actuator_delay", "parameters": {"delay_s": {"value": 0.8, "ci95": [0.7, 0.9]}}}]
    peltier(*words, tmp_path / "named")
    said = json.loads((tmp_path / "named" / "improvement.json").read_text())
    assert (said["new"], said["tried"]) == (["actuator_delay"], [])


def test_no_better_is_not_run(peltier: Peltier, folder: Path, tmp_path: Path, diagnosis: RecordReport) -> None:
    """A delay of 8 s in the place of 0.8: no held-out row would have let it pass, and nothing is heated with it."""
    found = read_toml(folder / "better" / "diagnosis" / "model.toml")["effects"][0]["delay_s"]
    model = diagnosis.files["model.toml"]
    diagnosis.files["model.toml"] = model.replace(f"delay_s = {found}".encode(), b"delay_s = 8.0")
    assert b"delay_s = 8.0" in diagnosis.files["model.toml"]
    words = ("improve", folder / "first", "--config", folder / "config.toml", "--yes", "--out", tmp_path / "b")
    out = peltier.succeeds(*words)
    assert "Not run again: with the extended model temperature of the run's own record is predicted to " in out
    assert not (tmp_path / "b" / "run").exists()


def test_what_the_model_has_is_run_again_where_it_tells_the_run_better_for_being_fitted_to_it(
    peltier: Peltier, folder: Path, tmp_path: Path, diagnosis: RecordReport
) -> None:
    """The run's model knows the delay at its size. With the very same plate nothing is to be expected of a second run,
    with one that is a tenth nearer to what was measured much is."""
    document, better = diagnosis.document, folder / "better"
    run = tmp_path / "run"
    shutil.copytree(better / "run", run)
    words = ("improve", run, "--config", better / "config.toml", "--yes", "--out")
    out = peltier.succeeds(*words, tmp_path / "same")
    assert "the run's model already has what is named (actuator_delay), at sizes that the record bears out, and" in out
    assert "and with film and plate fitted to the run temperature of its record is predicted to " in out
    assert not (tmp_path / "same" / "run").exists()
    other_size = {"name": "actuator_delay", "parameters": {"delay_s": {"value": 0.9, "ci95": [0.89, 0.91]}}}
    document["effects"] = [other_size]
    _, out, _ = peltier(*words, tmp_path / "other")
    assert "Not run again: with film and plate fitted to the run temperature of its record is predicted to " in out
    document["effects"] = json.loads(diagnosis.files["diagnosis.json"])["effects"]
    text = (run / "model.toml").read_text()
    assert "effects = [" in text
    (run / "model.toml").write_text(text.replace("effects = [", 'effects = [{ name = "sensor_lag", tau_s = 0.1 },', 1))
    _, out, _ = peltier(*words, tmp_path / "fewer")
    assert "already has what is named (actuator_delay), at sizes that the record bears out." in out
    (run / "model.toml").write_text(text)
    model = read_toml(run / "model.toml")
    key, text = "seebeck_over_capacity_per_A_s", (run / "model.toml").read_text()
    value = model["plate"][key]
    assert f"{key} = {value}" in text
    (run / "model.toml").write_text(text.replace(f"{key} = {value}", f"{key} = {1.1 * value}"))
    out = peltier.succeeds(*words, tmp_path / "fitted")
    assert "With actuator_delay (which it had), and film and plate fitted to the first run, in the model the RMS" in out
    said = json.loads((tmp_path / "fitted" / "improvement.json").read_text())
    assert (said["new"], said["tried"]) == ([], [])
    assert (tmp_path / "fitted" / "run" / "run.json").is_file()


@pytest.mark.usefixtures("diagnosis")
def test_it_asks_before_heating(
    peltier: Peltier, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("n\n"))
    words = ("improve", folder / "first", "--config", folder / "config.toml", "--out")
    out = peltier.succeeds(*words, tmp_path / "no")
    assert "It heats: meerstetter at sim://" in out
    assert "limits 10 to 95 degC and 4 A" in out
    assert "Not run again: you said no." in out
    assert not (tmp_path / "no" / "run").exists()
    monkeypatch.setattr("sys.stdin", Terminal("y\n"))
    peltier.succeeds(*words, tmp_path / "yes")
    assert (tmp_path / "yes" / "run" / "record.csv").is_file()


def test_it_refuses_without_a_terminal(peltier: Peltier, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    status, out, err = peltier("improve", folder / "first", "--config", folder / "config.toml", "--out", folder / "no")
    assert (status, out) == (2, "")
    assert err.startswith("--yes: missing, and there is no terminal to ask on")
    assert not (folder / "no").exists()


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (("current_A = 4.0", "current_A = 4.5"), "limits.current_A: 4.5: expected at most the run's, 4"),
        (("[10, 95]", "[10, 99]"), "limits.temperature_degC: [10.0, 99.0]: expected within the run's, [10.0, 95.0]"),
        (
            ("period_s = 0.1", 'period_s = 0.1\nlaw = "instrument_pid"'),
            "experiment.law: 'instrument_pid' makes no use of a model's effects",
        ),
        (('"temperature_profile"', '"current_profile"'), "experiment.kind: 'current_profile' follows no target"),
    ],
)
def test_refusals(peltier: Peltier, folder: Path, tmp_path: Path, change: tuple[str, str], line: str) -> None:
    config = folder / f"refused_{abs(hash(line))}.toml"
    config.write_text((folder / "config.toml").read_text().replace(*change))
    err = peltier.fails("improve", folder / "first", "--config", config, "--out", tmp_path / "no", "--yes")
    assert err.splitlines() == [err.strip()]
    assert line in err
    assert not (tmp_path / "no").exists()


def test_no_run_and_no_configuration(peltier: Peltier, folder: Path, tmp_path: Path) -> None:
    status, _, err = peltier("improve", tmp_path / "none", "--config", folder / "config.toml", "--yes")
    assert (status, err) == (2, f"{tmp_path / 'none'}: no such folder; expected a run folder\n")
    status, _, err = peltier("improve", folder / "first", "--config", tmp_path / "none.toml", "--yes")
    assert (status, err) == (2, f"{tmp_path / 'none.toml'}: no such file\n")


@pytest.mark.usefixtures("diagnosis")
def test_status_of_a_daemon(peltier: Peltier, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def handed_over(verb: str, config: Path, out: Path, json_target: str | None, bench: str | None) -> int:
        asked.append((verb, read_toml(config)["experiment"]["model"], out, bench))
        return 10

    monkeypatch.setattr("rig.command.experiments.handed_over", handed_over)
    words = ("--config", folder / "config.toml", "--out", tmp_path / "out", "--yes", "--bench", "lab")
    assert peltier("improve", folder / "first", *words)[0] == 10
    model = tmp_path / "out" / "diagnosis" / "model.toml"
    assert asked == [("run", str(model), tmp_path / "out" / "run", "lab")]
    assert not (tmp_path / "out" / "improvement.json").exists()


def test_an_effect_at_the_size_that_the_model_has_is_no_news() -> None:
    found = [{"name": "film_lag", "parameters": {"tau_s": {"value": 2.0, "ci95": [1.9, 2.1]}}}]
    assert news(found, [{"name": "film_lag", "tau_s": 2.15}]) == []
    assert news(found, [{"name": "film_lag", "tau_s": 2.3}]) == ["film_lag"]
    assert news(found, [{"name": "sensor_lag", "tau_s": 2.0}]) == ["film_lag"]


def test_a_configuration_that_moves_names_its_files_whole(tmp_path: Path) -> None:
    config = write_bench(tmp_path, target='"target.csv"', more='[serve]\ntoken = "a secret of the daemon"\n')
    (tmp_path / "target.csv").write_text("time_s,target_ohm\n0,20000\n10,5000\n")
    text = configuration_with_model(config, tmp_path / "there" / "model.toml")
    assert "secret" not in text
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "model.toml").write_text((tmp_path / "model.toml").read_text())
    (tmp_path / "there" / "config.toml").write_text(text)
    file = read_configuration(tmp_path / "there" / "config.toml")
    assert file.content.experiment.target == str(tmp_path / "target.csv")
    assert getattr(file.content.simulation.film, "model", None) == str(tmp_path / "model.toml")
    assert file.content.limits == read_configuration(config).content.limits


CURRENTS = '["start 1 A", "hold 20 s", "ramp to 2.5 A in 60 s", "ramp to -0.5 A in 60 s", "ramp to 1.5 A in 40 s"]'
SINK = ("heat_sink_warmup", "sink_capacity_ratio = 8.0\nsink_conductance_ratio_per_s = 0.1")
FILM_LAG = ("film_lag", "tau_s = 3.0")
TOO_LATE = ("film_lag", "tau_s = 12.0")


@pytest.fixture
def recorded(tmp_path: Path, peltier: Peltier) -> Callable[[str, str], Record]:
    path = write_bench(tmp_path, target=CURRENTS)
    text = path.read_text().replace('kind = "track_resistance"', 'kind = "current_profile"')
    path.write_text(text.replace("period_s = 0.1", "period_s = 0.5"))

    def simulated(name: str, parameters: str) -> Record:
        effect = f"{name}:{parameters}".replace(" ", "").replace("\n", ",")
        assert peltier("simulate", path, "--effect", effect, "--out", tmp_path / "record.csv")[0] == 0
        return read_record(tmp_path / "record.csv")

    return simulated


def why_not(folder: Path, record: Record, *effects: tuple[str, str]) -> str | None:
    own, extended = folder / "own.toml", folder / "extended.toml"
    own.write_text(MODEL, encoding="utf-8")
    tables = (f'\n[[effects]]\nname = "{name}"\n{parameters}\n' for name, parameters in effects)
    extended.write_text(MODEL + "".join(tables), encoding="utf-8")
    return no_better(extended, own, record, FALLING_RESISTANCE, [name for name, _ in effects])


def test_what_is_before_the_film_shows_in_temperature(tmp_path: Path, recorded: Callable[[str, str], Record]) -> None:
    """The film follows the thermometer as well without the sink: 0.0029 decades with it by the current, 0.0024
    without it by the thermometer, for 0.02 K in the place of 2 K."""
    assert why_not(tmp_path, recorded(*SINK), SINK) is None


def test_a_film_is_told_by_the_film(tmp_path: Path, recorded: Callable[[str, str], Record]) -> None:
    lagging = recorded(*FILM_LAG)
    assert why_not(tmp_path, lagging, FILM_LAG) is None
    found = why_not(tmp_path, lagging, SINK, TOO_LATE)
    assert found is not None
    assert found.startswith("with the extended model log R of the run's own record is predicted to ")
    assert why_not(tmp_path, recorded(*SINK), SINK, TOO_LATE) is not None
