"""Bad readings and units that change midway are told in a line that names the rows; honest records get none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import rig
from compensator.thermal.plate import PlateModel
from rig.records.record import Record
from sim.inference.film.fit import identify_film
from sim.inference.plate.fit import identify_plate
from sim.inference.readings.odd_readings import Column, odd_readings, of_output
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii, relay_film

ROW = 700


def film_record(rows: int = 1600) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(2)
    v = decaying_profile(rows)
    film = is_prandtl_ishlinskii(1)
    y = film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0] + 0.002 * rng.normal(size=rows)
    return 0.5 * np.arange(rows), v + 0.005 * rng.normal(size=rows), y


def plate_record(rows: int = 1200) -> tuple[np.ndarray, ...]:
    time = 0.5 * np.arange(rows)
    current = np.where(time % 200.0 < 100.0, 1.2, -0.6)
    degC = PlateModel(1.6e-3, 0.06, 0.018, 25.0).simulate(25.0, time, current)
    return time, degC + 0.01 * np.random.default_rng(1).normal(size=rows), current


def of_film(time: np.ndarray, degC: np.ndarray, output: np.ndarray) -> list[str]:
    lines = odd_readings(Column("temperature_degC", time, degC, "degC"))
    return lines + odd_readings(of_output(time, output, "minus_log10_ohm"), degC)


@pytest.mark.parametrize("off_K", [3.0, -3.0])
def test_a_spike_of_the_thermometer(off_K: float) -> None:
    time, v, y = film_record()
    assert of_film(time, v, y) == []
    v[ROW] += off_K
    fit = identify_film(time, v, y, kind="generalized_pi")
    (line,) = [note for note in fit.identifiability if "bad reading" in note]
    assert line.startswith(f"record: temperature_degC: row {ROW + 1} ({time[ROW]:g} s) reads ")
    assert "left out" in line


def test_a_spike_in_a_plates_record() -> None:
    time, degC, current = plate_record()
    assert not any("bad reading" in note for note in identify_plate(time, degC, current).identifiability)
    degC[ROW] += 3.0
    (line,) = [note for note in identify_plate(time, degC, current).identifiability if "bad reading" in note]
    assert f"row {ROW + 1} (" in line


@pytest.mark.parametrize("times", [10.0, 0.1])
def test_a_reading_of_ten_times_its_neighbours(times: float) -> None:
    time, v, y = film_record()
    y[ROW] -= math.log10(times)
    (line,) = of_film(time, v, y)
    assert line.startswith(f"resistance_ohm: row {ROW + 1} (")
    assert " ohm between " in line


def test_several_bad_rows_have_one_line() -> None:
    time, v, y = film_record()
    y[[100, 300, 500, 700, 900, 1100, 1300]] += 1.0
    (line,) = of_film(time, v, y)
    assert "rows 101, 301, 501, 701, 901 and 2 more" in line


@pytest.mark.parametrize(("there", "back"), [("degC", "K"), ("K", "degC"), ("degC", "degF")])
def test_a_thermometers_unit_changes(there: str, back: str) -> None:
    time, v, y = film_record()
    part = slice(ROW, None) if there == "degC" else slice(0, ROW)
    v[part] = v[part] + 273.15 if "K" in (there, back) else 1.8 * v[part] + 32.0
    (line,) = of_film(time, v, y)
    assert line.startswith(f"temperature_degC: row {ROW + 1} (")
    assert f"from {there} to {back}?" in line


@pytest.mark.parametrize(("decades", "units"), [(3.0, "from ohm to kohm?"), (-3.0, "from kohm to ohm?")])
def test_an_ohmmeters_unit_changes(decades: float, units: str) -> None:
    time, v, y = film_record()
    y[ROW:] += decades
    (line,) = of_film(time, v, y)
    assert line.startswith(f"resistance_ohm: row {ROW + 1} (")
    assert units in line
    fit = identify_film(time, v, y, kind="generalized_pi")
    assert any(units in note for note in fit.identifiability)


def test_a_plates_record_in_two_units_is_told_by_identify_and_diagnose() -> None:
    time, degC, current = plate_record(600)
    degC[400:] += 273.15
    record = Record({"time_s": time, "temperature_degC": degC, "current_A": current})
    for lines in (rig.identify(record).lines, rig.diagnose(record, budget_s=4.0).lines):
        assert any("row 401 (200 s)" in line and "from degC to K?" in line for line in lines)


@pytest.mark.parametrize("decades", [2.97, 3.0, 3.03])
def test_a_film_that_switches_at_once_changes_no_unit(decades: float) -> None:
    """Three decades within one row, on the way up and on the way down again."""
    v = np.concatenate([np.linspace(40.0, 90.0, 500), np.linspace(90.0, 40.0, 500)] * 2)
    hot = np.concatenate([np.arange(500) > 280, np.arange(500) < 260] * 2)
    y = -4.0 + 0.01 * (v - 60.0) + decades * hot
    assert of_film(0.5 * np.arange(v.size), v, y) == []


@pytest.mark.parametrize("every", [1, 4, 12])
def test_steep_and_sparse_films_have_no_bad_rows(every: int) -> None:
    v = np.concatenate((np.linspace(40.0, 90.0, 1200), np.linspace(90.0, 40.0, 1200)))[::every]
    y = 2.0 * relay_film(v, spread_K=0.3, half_width_K=2.0, width_spread=0.05)
    assert of_film(0.5 * every * np.arange(v.size), v, y) == []


def test_a_coarse_last_digit_is_no_bad_row() -> None:
    rng = np.random.default_rng(0)
    degC = 0.25 * np.round((40.0 + 0.02 * np.arange(1500) + 0.06 * rng.normal(size=1500)) / 0.25)
    assert odd_readings(Column("temperature_degC", 0.5 * np.arange(1500.0), degC, "degC")) == []


def test_measured_films_and_plates_have_none(measured: Path) -> None:
    from rig.records.column_names import ColumnMapping
    from rig.records.record_file import read_record

    ohm = [ColumnMapping.parse("resistance_ohm=Resistance@ohm")]
    for name, mappings in (("vo2_film_major_loop.tsv", []), ("vo2_film_small_gap_raw.tsv", ohm)):
        record = read_record(measured / name, mappings)
        assert of_film(record["time_s"], record["temperature_degC"], record.output()) == []
    for path in measured.glob("peltier_*.csv"):
        time, degC = np.genfromtxt(path, delimiter=",", skip_header=1)[:, :2].T
        assert odd_readings(Column("temperature_degC", time, degC, "degC")) == []
