"""Targets: units as people write them, files with units in their names, a line for each sentence that is not read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rig.config.target import parse_profile, read_target
from rig.core.faults import Faults
from tests.peltier import Peltier
from tests.rig.small import MODEL

WHERE = "rig.toml: experiment.target"


@pytest.mark.parametrize(
    "value", ["50 kohm", "50 kOhm", "50kΩ", "50 kΩ", "50000", "50000 ohm", "0.05 MOhm", "5e4", "20 µS"]
)
def test_resistances_as_people_write_them(value: str) -> None:
    target = parse_profile([f"start {value}", "hold 1 s"], "resistance", WHERE)
    np.testing.assert_allclose(target.values, -np.log10(5e4), rtol=1e-15)


@pytest.mark.parametrize("rate", ["0.1 dec/s", "0.1 decades/s", "0.1 decade/s", "6 dec/min", "0.1 decades per second"])
def test_rates_as_people_write_them(rate: str) -> None:
    target = parse_profile(["start 50 kOhm", f"ramp to 5 kohm at {rate}"], "resistance", WHERE)
    assert target.duration_s == pytest.approx(10.0)


def test_temperatures_and_currents_as_people_write_them() -> None:
    target = parse_profile(["start 313.15 K", "ramp to 60 °C at 2 K/min", "Hold 1 min"], "temperature", WHERE)
    np.testing.assert_allclose(target.values, [40.0, 60.0, 60.0])
    np.testing.assert_allclose(target.times_s, [0.0, 600.0, 660.0])
    target = parse_profile(["start 0", "step to 500 mA", "ramp to 1 in 2 s"], "current", WHERE)
    np.testing.assert_allclose(target.values, [0.0, 0.5, 1.0])


def test_every_sentence_that_cannot_be_read_is_told_by_itself() -> None:
    words = ["start 80 kfoo", "hold 20 s", "ramp to 5 kohm at 0,1 dec/s", "rmap to 5 kohm", "step to 3 K"]
    with pytest.raises(Faults) as found:
        parse_profile(words, "resistance", WHERE)
    lines = found.value.lines
    assert [line.partition(": ")[2].partition(": ")[0].removeprefix("experiment.target") for line in lines] == [
        "[0]", "[2]", "[3]", "[4]",
    ]  # fmt: skip
    assert "unit 'kfoo': expected ohm, kohm, Mohm" in lines[0]
    assert "decimal point" in lines[1]
    assert "expected 'ramp to 80 kohm at 0.1 dec/s' or 'ramp to 80 kohm in 30 s'" in lines[2]
    assert "unit 'K'" in lines[3]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["hold 3 s"], "before a first sentence"),
        (["start 5", "start 6", "hold 1 s"], "'start' comes once"),
        (["start 5"], "lasts 0 s"),
        ([], "expected a first sentence"),
        (["start 5 mohm", "hold 1 s"], "milliohms or megohms"),
        (["start 0 ohm", "hold 1 s"], "a resistance is > 0"),
        (["start 5", "hold 20"], "20 without a unit: expected a time > 0 in s, min, h, as in '20 s'"),
        (["start 5", "ramp 5"], "expected 'ramp to 80 kohm at 0.1 dec/s' or 'ramp to 80 kohm in 30 s'"),
        (["strat 5", "hold 1 s"], "expected 'start 80 kohm'"),
        (["start 5", "sine 3"], "expected 'sine 0.4 dec period 40 s for 80 s'"),
        (["start 5", "wiggle"], "expected 'start 80 kohm' or 'hold 20 s' or 'ramp to"),
        (["start 5", "hold 1e308 s"], "at most 1e+08 s"),
        (["start 5", "ramp to 6 at 1e-300 dec/s"], "expected at most 1e+08 s"),
        (["start 1e999", "hold 1 s"], "finite number"),
        (["start 5", "sine 1 dec period 1e-9 s for 1000 s"], "periods"),
        (["start " + "9" * 5000, "hold 1 s"], "5006 characters"),
        (["start 5", "ramp to 6 at 0.1 dec"], "expected dec/s"),
    ],
)
def test_sentences_that_make_no_course(words: list[str], expected: str) -> None:
    with pytest.raises(Faults) as found:
        parse_profile(words, "resistance", WHERE)
    assert len(found.value.lines) == 1
    assert expected in found.value.lines[0]
    assert len(found.value.lines[0]) < 300


def test_files_with_other_units_in_their_names(tmp_path: Path) -> None:
    path = tmp_path / "target.csv"
    path.write_text("time_min,target_kohm\n1,100\n2,10\n")
    target = read_target(path, "resistance")
    np.testing.assert_array_equal(target.times_s, [0.0, 60.0])
    np.testing.assert_allclose(target.values, [-5.0, -4.0])
    assert "target_ohm from 'target_kohm' in kohm" in target.notes[0]
    path.write_text("time_s;setpoint_K\n0,5;300,15\n2,5;330,15\n")
    np.testing.assert_allclose(read_target(path, "temperature").values, [27.0, 57.0])
    path.write_text("time_s,current_mA\n0,500\n1,-250\n")
    np.testing.assert_allclose(read_target(path, "current").values, [0.5, -0.25])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("time_s,R\n0,5\n1,6\n", "column 'target_ohm' missing"),
        ("time_s,target\n0,5\n1,6\n", "column 'target_ohm' missing"),
        ("time,target_ohm\n0,5\n1,6\n", "expected the name time_s, or it with another unit, as time_min"),
        ("time_s,target_ohm\n0,5\n1,\n", "row 2: target_ohm: expected a finite number"),
        ("time_s,target_ohm\n0,5\n1,-6\n", "expected > 0"),
    ],
)
def test_target_files_that_are_refused_tell_no_flag_that_is_not_there(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "target.csv"
    path.write_text(text)
    with pytest.raises(Faults) as found:
        read_target(path, "resistance")
    assert expected in str(found.value)
    assert "--" not in str(found.value)


def test_invert_reads_targets_in_other_units(peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    for name, text in (("a", "time_s,target_ohm\n0,20000\n60,10000\n"), ("b", "time_min,R_set\n0,20\n1,10\n")):
        (tmp_path / f"{name}.csv").write_text(text)
    peltier.succeeds("invert", tmp_path / "model.toml", tmp_path / "a.csv", "--out", tmp_path / "a.out")
    status, _, err = peltier(
        "invert", tmp_path / "model.toml", tmp_path / "b.csv", "--column", "target_ohm=R_set@kohm",
        "--out", tmp_path / "b.out",
    )  # fmt: skip
    assert status == 0
    assert "time_s from 'time_min' in min" in err
    rows = [(tmp_path / f"{name}.out").read_text().splitlines()[1:] for name in "ab"]
    assert [row.split(",")[2:] for row in rows[0]] == [row.split(",")[2:] for row in rows[1]]
