"""The smaller verbs: init, tune, calibrate, identify's options."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.thermal.plate import PlateModel
from rig.analysis.inversion import order_warning
from rig.config.configuration import read_configuration
from rig.config.model_file import Model, read_model, write_model
from tests.peltier import Peltier
from tests.rig.small import write_bench


def test_init_writes_configurations_that_load(peltier: Peltier, tmp_path: Path) -> None:
    out = peltier.succeeds("init", tmp_path / "new")
    paths = [Path(line) for line in out.splitlines()]
    assert {path.name for path in paths} == {"demo.toml", "heater.toml", "rig.toml", "simulated.toml"}
    for path in paths:
        read_configuration(path)
    paths[0].write_text("mine")
    assert "exists" in peltier.fails("init", tmp_path / "new")
    assert paths[0].read_text() == "mine"


@pytest.mark.skipif(os.name == "nt", reason="needs a shell with head")
def test_the_overview_loses_its_reader_in_silence() -> None:
    """Whoever types `peltier --help | head` saw a traceback where lines are not buffered."""
    typed = f"{shlex.quote(sys.executable)} -u -m rig --help | head -1"
    done = subprocess.run(typed, shell=True, capture_output=True, text=True, check=False)
    assert (done.stdout[:20], done.stderr) == ("usage: peltier VERB ", "")


def test_tune_tells_gains_and_margins(peltier: Peltier, tmp_path: Path) -> None:
    bounded = write_bench(tmp_path, more="\n[control]\nmost_share = 0.35\n")
    out = peltier.succeeds("tune", bounded, "--json", tmp_path / "t.json")
    for word in ("gain margin", "phase margin", "Ms 1."):
        assert word in out
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["full"]["margins"]["ms"] == pytest.approx(1.4, abs=0.03)
    slower = write_bench(tmp_path, more="\n[control]\nms = 1.2\ndead_time_s = 0.5\n")
    peltier("tune", slower, "--json", tmp_path / "s.json")
    assert json.loads((tmp_path / "s.json").read_text())["full"]["gains"]["kp"] < result["full"]["gains"]["kp"] / 2


@pytest.mark.long
def test_tune_tells_the_margins_of_the_whole_law(peltier: Peltier, tmp_path: Path) -> None:
    report = tmp_path / "report"
    bounded = write_bench(tmp_path, more="\n[control]\nmost_share = 0.35\n")
    out = peltier.quietly("tune", bounded, "--json", tmp_path / "t.json", "--report", report)
    result = json.loads((tmp_path / "t.json").read_text())
    whole = result["full"]["whole_law"]
    rows = {row["ratio"]: row for row in whole["slope_ratios"]}
    assert max(rows[ratio]["ms"] for ratio in (0.6, 0.8, 1.0, 1.2, 1.5)) < 1.62
    assert rows[2.2]["ms"] < 2.02
    assert rows[2.2]["ms"] > rows[1.2]["ms"] - 0.01
    assert whole["rings_from_slope_ratio"] > 2.2
    assert result["refused"] == []
    assert "a film" in out
    page = (report / "report.html").read_text()
    assert "The margins hold." in page
    assert page.count("<svg") == 1
    assert (report / "figures" / "margins.svg").is_file()
    assert json.loads((report / "tuning.json").read_text())["full"]["whole_law"] == whole
    options = result["instrument_pid_gains"]["options"]
    assert f"kp_percent_per_K = {options['kp_percent_per_K']:g}" in out


@pytest.mark.long
def test_tune_refuses_gains_and_says_which_to_lower(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, more="\n[control]\nmost_share = 0.9\n")
    err = peltier.fails("tune", path, "--json", tmp_path / "t.json", status=1)
    assert "slope ratio 2.2" in err
    assert "lower control.most_share from 0.90 to 0." in err
    share = float(err.rsplit(" to ", 1)[1])
    path = write_bench(tmp_path, more=f"\n[control]\nmost_share = {share}\n")
    assert peltier("tune", path)[0] == 0
    late = "ms = 2.4\ndead_time_s = 0.25\n"  # a delay that no stamp tells
    path = write_bench(tmp_path, more=f"\n[control]\nmost_share = {share}\n{late}")
    err = peltier.fails("tune", path, status=1)
    less = float(err.rsplit(" to ", 1)[1])
    assert less < 0.6 * share
    assert peltier("tune", write_bench(tmp_path, more=f"\n[control]\nmost_share = {less}\n{late}"))[0] == 0


def test_tune_for_a_controller_that_takes_setpoints(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(
        path.read_text().replace('kind = "track_resistance"', 'kind = "track_resistance"\nlaw = "instrument_pid"')
        + "\n[control]\nmost_share = 0.2\n"
    )
    out = peltier.succeeds("tune", path, "--json", tmp_path / "t.json")
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["instrument_pid"]["whole_law"]["slope_ratios"][-1]["ms"] < 2.05
    assert result["instrument_pid_gains"]["margins"]["ms"] < read_configuration(path).content.control.ms + 0.01
    assert "parameter 3010 = " in out


@pytest.mark.usefixtures("undrawn")
def test_calibrate_finds_a_film_of_the_class(peltier: Peltier, tmp_path: Path) -> None:
    more = "\n[calibration]\ntemperature_degC = [30, 90]\nminor_loops = 8\n"
    path = write_bench(tmp_path, target='"written_later.csv"', more=more)  # it asks for neither target nor model
    text = path.read_text().replace("first_degC = 60.0", "first_degC = 25.0")
    path.write_text(text.replace('model = "model.toml"', 'model = "written_later.toml"', 1))
    peltier.quietly("calibrate", path, "--out", tmp_path / "cal", "--json", tmp_path / "c.json")
    result = json.loads((tmp_path / "c.json").read_text())
    assert result["check_rmse_dec"] < 0.004
    model = read_model(tmp_path / "cal" / "MODEL.toml", needs=("film", "plate"))
    assert model.plate is not None
    assert model.plate.seebeck_over_capacity_per_A_s == pytest.approx(1.6e-3, rel=0.01)
    assert model.plate.ambient_degC == pytest.approx(25.0, abs=0.3)
    assert model.film is not None
    assert model.film_records == (str(tmp_path / "cal" / "record.csv"),)
    assert np.min(model.film.order_margin()) >= -1e-9


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_calibrate_says_of_a_record_what_identify_says(peltier: Peltier, tmp_path: Path) -> None:
    """A heat sink warms up, which the plate model does not have: printed, in the JSON and in the report."""
    more = "\n[calibration]\ntemperature_degC = [35, 85]\nminor_loops = 2\n[simulation.heat_sink_warmup]\n"
    more += "sink_capacity_ratio = 10.0\nsink_conductance_ratio_per_s = 0.4\n"
    path = write_bench(tmp_path, more=more, changed=[("first_degC = 60.0", "first_degC = 25.0")])
    folder = tmp_path / "cal"
    out = peltier.succeeds("calibrate", path, "--out", folder, "--json", tmp_path / "c.json")
    note = "times the thermometer's noise: something is missing"
    lines = out.splitlines()
    told = next(k for k, line in enumerate(lines) if line.startswith("plate: The model") and note in line)
    assert lines[told - 1].startswith("plate: A law with feedback makes up for most of")
    result = json.loads((tmp_path / "c.json").read_text())
    assert any(note in one for one in result["identifiability"])
    assert note.replace("'", "&#x27;") in (folder / "report.html").read_text()
    identified = peltier.succeeds("identify", folder / "record.csv", "--json", tmp_path / "i.json")
    assert note in identified
    for finding in result["check"]:
        assert f"film: {finding['what']}: {finding['advice']}" in out


def test_one_that_keeps_the_order_condition_where_it_switches_is_not_said_to_jump() -> None:
    """What identify wrote of a record from 51 to 85 degC: in the tails of the walls, at 32 degC, the lower one is 3e-8
    above the other, which nothing shows. One whose radii are too small by a hundredth is told by all."""
    walls = (
        Envelope("tanh", 0.24208628843390656, -15.82616196214335),
        Envelope("tanh", 0.3326836026623685, -18.77642820709753),
    )
    kept = FilmModel([0.0, 0.4], [0.5, 0.5], *walls)
    assert -1e-7 < np.min(kept.order_margin()) < 0.0
    assert order_warning(kept, "film.toml") is None
    assert order_warning(kept, "film.toml", (20.0, 90.0)) is None
    jumps = FilmModel([0.0, 0.4], [0.5, 0.5], Envelope("tanh", 0.2, -12.6), Envelope("tanh", 0.2, -12.62))
    assert "1 operator of positive weight violates" in str(order_warning(jumps, "film.toml"))
    assert "not reachable" in str(order_warning(jumps, "film.toml", (20.0, 90.0)))


def test_models_read_back_to_the_same_bits(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    film = FilmModel(
        random.uniform(0.0, 1.0, 7),
        random.exponential(0.1, 7),
        Envelope("tanh", 0.1 + random.random(), -random.random()),
        Envelope("tanh", 0.1 + random.random(), random.random()),
        Memoryless("arrhenius", -random.random() * 1e3, offset=random.random()),
    )
    write_model(tmp_path / "m.toml", Model(film, None), "a comment")
    back = read_model(tmp_path / "m.toml").film
    assert back is not None
    np.testing.assert_array_equal(back.radii, film.radii)
    np.testing.assert_array_equal(back.weights, film.weights)
    assert (back.rising, back.falling, back.memoryless) == (film.rising, film.falling, film.memoryless)


def test_a_plates_slopes_are_in_its_file_where_it_has_them(tmp_path: Path) -> None:
    """The next program must not take a plate with slopes for one without; files of plates without them stay as they
    were, so that programs of before still read them."""
    plate, path = PlateModel(1.6e-3, 0.06, 0.018, 25.0), tmp_path / "m.toml"
    write_model(path, Model(None, plate))
    assert "slope" not in path.read_text()
    assert read_model(path).plate == plate
    plate = replace(plate, seebeck_slope_per_K=0.1 / 57.0, resistance_slope_per_K=-0.1 / 27.0, error_K=0.9)
    write_model(path, Model(None, plate))
    assert read_model(path).plate == plate


def test_records_from_elsewhere(tmp_path: Path, peltier: Peltier) -> None:
    film = FilmModel([0.1, 0.4], [0.6, 0.4], Envelope("tanh", 0.2, -12.6), Envelope("tanh", 0.2, -11.8))
    temperature = np.concatenate([np.linspace(30, 90, 200), np.linspace(90, 30, 200), np.linspace(30, 65, 100)])
    output, _ = film.simulate(temperature, film.initial_memory(30.0, "heated"))
    lines = ["t / min;T;R;note"]
    lines += [
        f"{k / 60.0!r};{float(v) + 273.15!r};{float(10.0**-u) / 1e3!r};a b"
        for k, (v, u) in enumerate(zip(temperature, output, strict=True))
    ]
    record = tmp_path / "their.txt"
    record.write_text("\n".join(lines) + "\n")
    mapping = [
        "--column",
        "time_s=t / min@min",
        "--column",
        "temperature_degC=T@K",
        "--column",
        "resistance_ohm=R@kohm",
    ]
    status, out, err = peltier(
        "identify", record, *mapping, "--kind", "generalized_pi", "--operators", 12, "--compress", 6,
        "--out", tmp_path / "m.toml", "--json", tmp_path / "i.json",
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert "operators instead of" in out
    result = json.loads((tmp_path / "i.json").read_text())
    assert result["film"]["rmse_dec"] < 0.01
    assert result["film"]["compression"]["operators"] <= 6
    table = tomllib.loads((tmp_path / "m.toml").read_text())
    assert table["film"]["kind"] == "generalized_pi"
    assert len(table["film"]["radii"]) <= 6


def test_check_tells_who_answers_and_ends_off(peltier: Peltier, tmp_path: Path) -> None:
    out = peltier.quietly("check", write_bench(tmp_path), "--json", tmp_path / "c.json")
    for word in (
        "controller: Meerstetter",
        "meter: Keithley 2000",
        "limits read back: 4 A",
        "dead man 5 s",
        "switching off takes",
    ):
        assert word in out
    result = json.loads((tmp_path / "c.json").read_text())
    assert result["output_off_confirmed"] is True
    assert result["temperature_degC"] == pytest.approx(60.0, abs=1.0)


def test_nothing_runs_where_another_instrument_answers(peltier: Peltier, tmp_path: Path) -> None:
    path = write_bench(tmp_path, changed=[('"keithley2000"\n', '"keithley2000"\nserial_number = "0000001"\n')])
    err = peltier.fails("run", path, "--out", tmp_path / "out")
    assert "bench.meter.serial_number: '0000001': what answers at" in err
    assert not (tmp_path / "out").exists()
    status, out, _ = peltier("check", path)  # tells all that it finds
    assert status == 1
    assert "bench.meter.serial_number: '0000001': what answers at" in out


def test_ports_lists_or_says_that_there_is_none(peltier: Peltier) -> None:
    out = peltier.succeeds("ports")
    assert out.strip()
