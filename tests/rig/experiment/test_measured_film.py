"""The measured film: identified, predicted, and tracked over three of its decades. Skips without the records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from compensator.thermal.plate import PlateModel
from rig.config.model_file import Model, write_model
from rig.records.column_names import ColumnMapping
from rig.records.record_file import read_record
from sim.inference.film.fit import identify_film
from tests.peltier import Peltier

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
