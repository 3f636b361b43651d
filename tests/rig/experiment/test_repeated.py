"""repeat = N, replayed to the bit and begun from another run; memory = "estimate"; the measured film, tracked."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.pid import PidGains
from compensator.thermal.plate import PlateModel
from rig.config.model_file import Model, write_model
from rig.config.target import Target
from rig.control.decision import ReadAt
from rig.control.policies import Follow
from rig.records.column_names import ColumnMapping
from rig.records.record_file import read_record
from sim.inference.film.fit import identify_film
from tests.compensator.film_models import TEN_OPERATORS as FILM
from tests.peltier import Peltier
from tests.rig.small import write_bench

pytestmark = pytest.mark.usefixtures("undrawn")


def test_a_run_that_learns(tmp_path: Path, peltier: Peltier) -> None:
    target = '["start 20 kohm", "hold 4 s", "ramp to 8 kohm in 12 s", "hold 6 s"]'
    path = write_bench(tmp_path, target=target, changed=[("settle_s", "repeat = 3\nsettle_s")])
    run = tmp_path / "run"
    out = peltier.succeeds("run", path, "--out", run, "--json", "-")
    assert len(json.loads(out)["repeated"]) == 2
    folders = [run / "repeat_1", run / "repeat_2", run]
    assert [(folder / "correction.csv").is_file() for folder in folders] == [False, True, True]
    for folder in folders:
        assert (folder / "report.html").is_file()
        assert json.loads((folder / "run.json").read_text())["stop"]["reason"] == "done"
        out = peltier.succeeds("replay", folder, "--json", "-")
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
    peltier.succeeds("run", path, "--out", tmp_path / "again")
    begun = np.loadtxt(tmp_path / "again" / "correction.csv", delimiter=",", skiprows=1)
    assert np.allclose(begun, np.loadtxt(run / "learned.csv", delimiter=",", skiprows=1))


SERIES = '[[effects]]\nname = "series_resistance"\nseries_ohm = 50.0\n'


@pytest.mark.parametrize(
    ("keys", "effects", "expected"),
    [
        ('learned = "nothing"', "", "learned.csv"),
        ('repeat = 2\nlaw = "pid"', "", "experiment.repeat: law 'pid'"),
        ("repeat = 2", SERIES, "experiment.repeat: the model has series_resistance"),
    ],
)
def test_refusals_of_repeat(keys: str, effects: str, expected: str, tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path, changed=[("settle_s", f"{keys}\nsettle_s")])
    model = tmp_path / "model.toml"
    model.write_text(model.read_text() + effects)
    assert expected in peltier.fails("run", path, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_law_that_knows_what_its_model_lacks_goes_as_if_the_film_were_its_model() -> None:
    """The same currents as for a film that is the model, with what it lacks taken off the target."""
    law = Law(
        LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0)),
        PlateModel(1.67e-3, 0.067, 0.0167, 25.0),
        FILM,
    )
    time = np.arange(0.0, 60.0, 0.1)
    wanted = Target("resistance", time, FILM.output_at(FILM.initial_memory(58.0)) + 0.1 * np.sin(0.1 * time))
    lacks = Target("model_lacks", time, 0.01 * np.sin(0.7 * time))
    knowing, plain = (
        Follow(law, target, FILM.initial_memory(58.0))
        for target in (wanted, Target("resistance", time, wanted.values - lacks.values))
    )
    knowing.model_lacks = lacks
    random, memory, read = np.random.default_rng(1), FILM.initial_memory(58.0), ReadAt(0.06, 0.04, 0.02)
    for k in range(500):
        degC = 58.0 + 2.0 * float(np.sin(0.01 * k))
        output, memory = FILM.step(degC, memory)
        output += 0.002 * float(random.standard_normal())
        lacked = float(lacks.at(0.1 * k + read.after_s - read.output_age_s))
        mine, other = (
            follow.decide(0.1 * k, degC, shown, read) for follow, shown in ((knowing, output + lacked), (plain, output))
        )
        assert mine.current_A == pytest.approx(other.current_A, abs=1e-6)
        assert mine.target_ohm == pytest.approx(10.0 ** -float(wanted.at(0.1 * k + read.after_s)))


@pytest.mark.parametrize("memory", ["estimate", "assume"])
def test_a_film_is_taken_where_it_is(tmp_path: Path, peltier: Peltier, memory: str) -> None:
    target = '["start 20 kohm", "hold 6 s", "ramp to 12 kohm in 10 s", "hold 4 s", "ramp to 18 kohm in 10 s"]'
    path = write_bench(tmp_path, target=target, changed=[("settle_s", f'memory = "{memory}"\nsettle_s')])
    run = tmp_path / "run"
    peltier.succeeds("run", path, "--out", run)
    record = read_record(run / "record.csv", needs=(), options=False)
    assert set(record.text_columns["phase"]) == {"polarity", "settle", "track"}
    assert np.nanmax(record["temperature_degC"]) < 75.0  # the hot end is at 90
    out = peltier.succeeds("replay", run, "--json", "-")
    assert json.loads(out)["different"] == 0
    assert json.loads(out)["compared"] > 250


COLUMNS = ("time_s=t_s", "temperature_degC=T_K@K", "resistance_ohm=R_ohm")
CONFIGURATION = """
[bench.controller]
driver = "meerstetter"
port = "sim://"
[bench.meter]
driver = "keithley2000"
port = "sim://"
[limits]
temperature_degC = [5, 100]
current_A = 4.0
[calibration]
temperature_degC = [20, 95]
[experiment]
kind = "track_resistance"
name = "real_film"
model = "controller.toml"
period_s = 0.1
target = [
    "start 300 kohm", "hold 10 s", "ramp to 300 ohm in 60 s", "hold 10 s", "ramp to 300 kohm in 60 s", "hold 10 s",
    "ramp to 3 kohm in 40 s", "hold 5 s", "ramp to 100 kohm in 40 s", "hold 5 s", "ramp to 1 kohm in 40 s", "hold 10 s",
]
[simulation]
first_degC = 95.0
thermometer_noise_K = 0.01
ohmmeter_noise_dec = 0.002
[simulation.film]
kind = "model"
model = "truth.toml"
"""


@pytest.mark.long
def test_tracks_three_decades(peltier: Peltier, measured: Path, tmp_path: Path) -> None:
    """The main job: the film is fitted to all rows, the controller's model to every other one, its plate is 1 % off."""
    record = read_record(measured / "vo2_film_major_loop.tsv", [ColumnMapping.parse(text) for text in COLUMNS])
    time, temperature, output = record["time_s"], record["temperature_degC"], record.output()
    half = identify_film(time[::2], temperature[::2], output[::2]).model
    write_model(tmp_path / "truth.toml", Model(identify_film(time, temperature, output).model, None))
    write_model(tmp_path / "controller.toml", Model(half, PlateModel(1.616e-3, 0.061, 0.0177, 25.4)))
    (tmp_path / "config.toml").write_text(CONFIGURATION)
    out = peltier.succeeds("run", tmp_path / "config.toml", "--out", tmp_path / "run", "--json", "-")
    assert json.loads(out)["scores"]["full"]["rms_dec"] <= 0.1
