"""Rows in which a thermometer lies are named and left out, and none in which it rounds, is slow, or really stands."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rig
from rig.analysis.transition import believed_degC, film_numbers
from rig.records.record import Record
from rig.records.record_file import write_columns
from rig.records.thermometer_faults import find_false_readings
from tests.peltier import Peltier
from tests.rig.records.rounded_records import Array, changed, clean, film_loop, frozen, plate_run

VALUES = (-127.0, 0.0, 85.0, -200.0, 850.0, -242.02, 1372.0, 999.0, 2047.75, 988.79)
THERMOMETERS = [(0.001, 0.03), (0.01, 0.0), (0.01, 0.02), (0.25, 0.0), (0.25, 0.1), (0.5, 0.05)]  # digit, noise (K)


def rows_of(record: dict[str, Any]) -> list[int]:
    """The rows that are left out."""
    return [row for one in find_false_readings(record) for row in range(one.first, one.last + 1)]


def setting(first: int, end: int, value: float) -> Callable[[Array], None]:
    def change(degC: Array) -> None:
        degC[first:end] = value

    return change


@pytest.mark.parametrize("seed", range(80))
def test_no_row_of_a_clean_record_is_left_out(seed: int) -> None:
    """Else whoever has a coarse or slow thermometer, a hold or a controller at rest loses rows that are true."""
    record = clean(seed)
    assert find_false_readings(record) == []
    for name in ("resistance_ohm", "current_A"):  # nor with one witness fewer
        assert find_false_readings({column: values for column, values in record.items() if column != name}) == []


@pytest.mark.parametrize(("digit", "noise"), THERMOMETERS)
@pytest.mark.parametrize("value", VALUES)
def test_a_fault_value_over_some_rows(digit: float, noise: float, value: float) -> None:
    """Of DS18B20, MAX31855, MAX31865, MAX6675 and thermocouple amplifiers: each stands in several rows."""
    record = film_loop(digit, noise)
    assert rows_of(changed(record, setting(120, 126, value))) == list(range(120, 126))
    assert rows_of(changed(record, setting(120, 122, value))) == [120, 121]


@pytest.mark.parametrize(("digit", "noise"), THERMOMETERS)
def test_a_thermometer_that_stands_still(digit: float, noise: float) -> None:
    """In a ramp, in a short stretch, from the beginning, to the end, and after a jump."""
    record = film_loop(digit, noise)
    rows = record["time_s"].size
    for first, end in ((130, 170), (150, 190), (60, 72), (rows - 80, rows)):
        assert rows_of(frozen(record, first, end)) == list(range(first, end)), (first, end)
    assert rows_of(frozen(record, 1, 80)) == list(range(80))
    assert rows_of(changed(record, setting(250, rows, 96.4))) == list(range(250, rows))
    assert rows_of(changed(record, setting(0, 30, 96.4))) == list(range(30))


def test_several_fault_values_and_one_that_comes_again() -> None:
    record = film_loop()
    mixed = changed(changed(record, setting(120, 125, -127.0)), setting(122, 124, 85.0))
    assert rows_of(mixed) == list(range(120, 125))
    again = changed(changed(changed(record, setting(40, 46, 0.0)), setting(20, 21, 0.0)), setting(250, 251, 0.0))
    assert rows_of(again) == [20, *range(40, 46), 250]


@pytest.mark.parametrize(("digit", "noise"), [(0.01, 0.02), (0.25, 0.0), (0.5, 0.05)])
def test_the_thermometer_of_a_plate(digit: float, noise: float) -> None:
    """Without a film the current is the witness; a controller's answer to a fault is none."""
    record = plate_run(digit, noise)
    assert rows_of(record) == []
    still = frozen(record, 290, 330)
    found = rows_of(still)
    assert set(found) >= set(range(290, 330))
    assert len(found) < 43  # a coarse reading may have been the same before
    assert np.ptp(still["temperature_degC"][found]) == 0.0
    wrong = changed(record, setting(205, 211, -127.0))
    assert rows_of(wrong) == list(range(205, 211))
    current = wrong["current_A"].copy()
    current[205:211] = 4.0
    assert rows_of({**wrong, "current_A": current}) == list(range(205, 211))


def test_a_run_is_judged_as_a_record_is() -> None:
    """A calibration reads its rows from memory, not from a file."""

    class Rows:
        columns = frozen(film_loop(), 130, 170)

        def column(self, name: str) -> Array:
            return np.asarray(self.columns.get(name, np.full(397, np.nan)))

    degC, lines = believed_degC(Rows())
    assert np.flatnonzero(np.isnan(degC)).tolist() == list(range(130, 170))
    assert len(lines) == 1
    output = -np.log10(Rows().column("resistance_ohm"))
    assert_right(film_numbers(Rows.columns["time_s"], degC, output, "minus_log10_ohm", "run").document())


def test_the_first_readings_are_a_power_on_value() -> None:
    """A DS18B20 reads 85 degC until it has converted once."""
    assert rows_of(changed(film_loop(), setting(0, 2, 85.0))) == [0, 1]
    assert rows_of(changed(plate_run(0.0625, 0.02), setting(0, 2, 85.0))) == [0, 1]


def test_a_thermometer_that_is_clipped() -> None:
    """One whose range ends inside the loop reads its largest value there; its noise elsewhere shows that it is none."""
    record = changed(film_loop(), lambda degC: np.minimum(degC, 70.0, out=degC))
    found = rows_of(record)
    assert len(found) > 80
    assert np.all(record["temperature_degC"][found] == 70.0)


def test_absolute_zero_is_no_temperature() -> None:
    """A sensor that is off reads 0 K: in kelvins, in one row or in several."""
    film = film_loop()
    kelvin = film["temperature_degC"] + 273.15
    kelvin[[5, *range(120, 127)]] = 0.0
    record = rig.read_record({"time_s": film["time_s"], "T (K)": kelvin, "R (ohm)": film["resistance_ohm"]})
    assert np.flatnonzero(np.isnan(record["temperature_degC"])).tolist() == [5, *range(120, 127)]
    [line] = record.left_out_lines()
    assert line.startswith("temperature_degC: rows 6, 121 to 127 (10 to 252 s) read -273.15 degC: absolute zero")
    assert record.raw_columns()["temperature_degC"][5] == -273.15
    found = rig.identify(record)
    assert line in found.lines
    assert_right(found.document["transition"][0])


def assert_right(transition: dict[str, Any]) -> None:
    """The film's own numbers, as far as the noise allows."""
    for name, true in (("heating_degC", 63.0), ("cooling_degC", 57.0), ("hysteresis_K", 6.0)):
        assert abs(transition[name]["value"] - true) < 0.25, (name, transition[name])


@pytest.mark.parametrize(
    ("first", "end", "value"),
    [
        (130, 170, None),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in ((317, 397, None), (120, 126, -127.0), (250, 397, 96.4))
        ),
    ],
)
def test_the_transition_is_what_the_rest_shows(first: int, end: int, value: float | None) -> None:
    """Else a thermometer that lies makes a film without hysteresis of one that has 6 K."""
    loop = film_loop()
    record = frozen(loop, first, end) if value is None else changed(loop, setting(first, end, value))
    found = rig.identify(rig.read_record(record))
    assert_right(found.document["transition"][0])
    [entry] = found.document["left_out"]
    assert entry["rows"] == [first + 1, end]
    assert "left out" in str(found)


def test_a_transition_that_nobody_saw_has_no_number() -> None:
    """The thermometer stands still while the film switches, on the only heating of the record."""
    once = {name: values[:200] for name, values in film_loop().items()}
    transition = rig.identify(rig.read_record(frozen(once, 58, 74))).document["transition"][0]
    assert transition["heating_degC"]["value"] is None
    assert transition["hysteresis_at_midpoint_K"]["value"] is None
    assert abs(transition["cooling_degC"]["value"] - 57.0) < 0.25


def test_where_the_model_is_far_off_no_number_is_stated() -> None:
    """Whatever the cause: here the record was never seen by the rules, and the thermometer stood still."""
    film = frozen(film_loop(), 130, 170)
    found = rig.identify(Record(film))
    numbers = {name: entry for name, entry in found.document["transition"][0].items() if isinstance(entry, dict)}
    assert all(entry["value"] is None for entry in numbers.values() if "value" in entry)
    assert re.search(r"the film model misses this record by \d+ times the noise", str(found))


def test_the_verbs_name_the_rows(peltier: Peltier, tmp_path: Path) -> None:
    """On the command line: identify, predict and diagnose, each on the same record."""
    path = tmp_path / "film.csv"
    film = frozen(film_loop(), 317, 397)
    write_columns(path, film)
    told = "rows 318 to 397 (634 to 792 s)"
    status, out, _ = peltier("identify", path, "--out", tmp_path / "m.toml")
    assert (status, told in out) == (0, True)
    status, out, _ = peltier("predict", tmp_path / "m.toml", path, "--out", tmp_path / "p.csv")
    assert (status, told in out) == (0, True)
    with (tmp_path / "p.csv").open() as file:
        kept = [float(row["temperature_degC"]) for row in csv.DictReader(file)]
    np.testing.assert_array_equal(kept, film["temperature_degC"])
    found = rig.diagnose(rig.read_record(path))
    assert found.effects == {}
    assert found.verdict == "clean"
    assert any(told in line for line in found.lines)
    left_out = [one["time_s"] for one in found.document["rows"]["left_out"] if one["column"] == "temperature_degC"]
    assert left_out == np.arange(634.0, 793.0, 2.0).tolist()
