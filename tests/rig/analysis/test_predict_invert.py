"""The files that `invert` and `predict` write, against the model's equations written out again here."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from rig.records.record_file import write_columns
from rig.web import app
from tests.peltier import Peltier
from tests.rig.small import MODEL

RADII, WEIGHTS = [0.05, 0.2, 0.5, 0.8], [0.4, 0.3, 0.2, 0.1]


def rising(v: float) -> float:
    return math.tanh(0.2 * v - 12.6)


def falling(v: float) -> float:
    return math.tanh(0.2 * v - 11.8)


def output(v: float, plays: list[float]) -> float:
    return 0.4 * math.tanh(0.03 * v - 1.6) - 4.0 + sum(p * w for p, w in zip(WEIGHTS, plays, strict=True))


def moved(v: float, before: float, plays: list[float]) -> list[float]:
    if v > before:
        return [max(rising(v) - r, w) for r, w in zip(RADII, plays, strict=True)]
    if v < before:
        return [min(falling(v) + r, w) for r, w in zip(RADII, plays, strict=True)]
    return plays


def cooled(v: float) -> list[float]:
    return [min(1.0 - r, falling(v) + r) for r in RADII]


def course(temperatures: list[float]) -> list[float]:
    """The film's output at each, when it was cooled to the first."""
    plays, before, found = cooled(temperatures[0]), temperatures[0], []
    for v in temperatures:
        plays, before = moved(v, before, plays), v
        found.append(output(v, plays))
    return found


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_predict_follows_the_equations(peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    temperatures = [50.0, 62.0, 66.5, 66.5, 61.0, 57.0, 64.0, 80.0, 30.0]
    expected = [10.0**-y for y in course(temperatures)]
    lines = [f"{k},{v!r},{r * 1.01!r},note{k}" for k, (v, r) in enumerate(zip(temperatures, expected, strict=True))]
    lines[3] = "3,66.5,,note3"
    record = tmp_path / "record.csv"
    record.write_text("time_s,temperature_degC,resistance_ohm,remark\n" + "\n".join(lines) + "\n")
    peltier.succeeds(
        "predict", tmp_path / "model.toml", record, "--out", tmp_path / "out.csv", "--json", tmp_path / "out.json"
    )
    written = rows(tmp_path / "out.csv")
    assert [row["remark"] for row in written] == [f"note{k}" for k in range(9)]
    assert written[3]["resistance_ohm"] == ""
    np.testing.assert_allclose([float(row["predicted_ohm"]) for row in written], expected, rtol=1e-12)
    result = json.loads((tmp_path / "out.json").read_text())
    assert result["rmse_dec"] == pytest.approx(math.log10(1.01), rel=1e-9)
    assert result["max_abs_dec"] == pytest.approx(math.log10(1.01), rel=1e-9)
    assert result["rows_dec"] == 8


def test_several_records_are_predicted_each_by_itself(peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    for name, factor in (("one", 1.0), ("two", 2.0)):
        lines = [f"{k},{20 + k},{factor * (1000 - k)}" for k in range(60)]
        (tmp_path / f"{name}.csv").write_text("time_s,temperature_degC,resistance_ohm\n" + "\n".join(lines) + "\n")
    records = [tmp_path / "one.csv", tmp_path / "two.csv"]
    alone = []
    for record in records:
        assert peltier("predict", tmp_path / "model.toml", record, "--json", tmp_path / "one.json")[0] == 0
        alone.append(json.loads((tmp_path / "one.json").read_text()))
    words = ("--json", tmp_path / "both.json", "--report", tmp_path / "report")
    out = peltier.succeeds("predict", tmp_path / "model.toml", *records, *words)
    assert json.loads((tmp_path / "both.json").read_text()) == alone
    assert alone[0]["rmse_dec"] != alone[1]["rmse_dec"]
    assert all(f"{record}:" in out for record in records)
    assert all((tmp_path / "report" / name / "report.html").is_file() for name in ("one", "two"))
    err = peltier.fails("predict", tmp_path / "model.toml", *records, "--out", tmp_path / "out.csv")
    assert "--out" in err
    assert "expected a single RECORD" in err


def test_invert_gives_temperatures_that_give_the_targets(peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    targets = [30000.0, 8000.0, 1e9, 5000.0, 20000.0, 1e-3, 9000.0]
    (tmp_path / "target.csv").write_text(
        "time_s,target_ohm,label\n" + "".join(f"{k},{r!r},x{k}\n" for k, r in enumerate(targets))
    )
    peltier.succeeds(
        "invert", tmp_path / "model.toml", tmp_path / "target.csv", "--out", tmp_path / "out.csv", "--limits", "0,120"
    )
    written = rows(tmp_path / "out.csv")
    assert [row["label"] for row in written] == [f"x{k}" for k in range(7)]
    degC = [float(row["temperature_degC"]) for row in written]
    given = [10.0**-y for y in course(degC)]
    assert [float(row["resistance_ohm"]) for row in written] == pytest.approx(given, rel=1e-9)
    for k, (row, target) in enumerate(zip(written, targets, strict=True)):
        reachable = row["reachable"] == "1"
        assert reachable == (k not in (2, 5))
        if reachable:
            assert given[k] == pytest.approx(target, rel=1e-8)
            assert row["nearest_ohm"] == row["resistance_ohm"]
            assert row["nearest_degC"] == row["temperature_degC"]
        else:
            assert degC[k] == degC[k - 1]
    assert [float(written[k]["nearest_degC"]) for k in (2, 5)] == pytest.approx([0.0, 120.0], abs=1e-9)
    coldest = course([*degC[:2], 0.0])[-1]
    assert float(written[2]["nearest_ohm"]) == pytest.approx(10.0**-coldest, rel=1e-8)


def test_no_first_target_yet(peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "target.csv").write_text("time_s,target_ohm\n0,1e12\n1,20000\n")
    assert peltier("invert", tmp_path / "model.toml", tmp_path / "target.csv", "--out", tmp_path / "out.csv")[0] == 0
    written = rows(tmp_path / "out.csv")
    assert written[0]["temperature_degC"] == ""
    assert written[0]["resistance_ohm"] == ""
    assert written[0]["reachable"] == "0"
    assert float(written[0]["nearest_ohm"]) < 1e12
    assert float(written[0]["nearest_degC"]) == -50.0
    assert written[1]["reachable"] == "1"


MIXING = "[film.mixing]\nexponent = -0.7\nlow_dec = -5.5\nhigh_dec = -2.5\n"


def mixed(y: float) -> float:
    """-log10 of the power mean of both ends, in the shares that a film that adds logarithms would have at y."""
    share = (y + 5.5) / 3.0
    return -math.log10(((1.0 - share) * 10.0 ** (-0.7 * 5.5) + share * 10.0 ** (-0.7 * 2.5)) ** (1.0 / -0.7))


def test_a_film_that_mixes_otherwise_is_predicted_and_inverted(peltier: Peltier, tmp_path: Path) -> None:
    model = tmp_path / "model.toml"
    model.write_text(MODEL.replace("[plate]", MIXING + "[plate]"))
    temperatures = [50.0, 62.0, 66.5, 61.0, 57.0, 64.0, 80.0, 30.0]
    expected = [10.0 ** -mixed(y) for y in course(temperatures)]
    lines = [f"{k},{v!r},{r!r}" for k, (v, r) in enumerate(zip(temperatures, expected, strict=True))]
    (tmp_path / "record.csv").write_text("time_s,temperature_degC,resistance_ohm\n" + "\n".join(lines) + "\n")
    words = ("--drive", "temperature", "--json", tmp_path / "predicted.json", "--out", tmp_path / "predicted.csv")
    peltier.succeeds("predict", model, tmp_path / "record.csv", *words)
    assert json.loads((tmp_path / "predicted.json").read_text())["rmse_dec"] < 1e-9
    wanted = "".join(f"{k},{r!r}\n" for k, r in enumerate([*expected[1:5], 1e-2]))
    (tmp_path / "target.csv").write_text("time_s,target_ohm\n" + wanted)
    peltier.succeeds("invert", model, tmp_path / "target.csv", "--out", tmp_path / "inverted.csv")
    *found, beyond = rows(tmp_path / "inverted.csv")
    assert [float(row["resistance_ohm"]) for row in found] == pytest.approx(expected[1:5], rel=3e-9)
    assert beyond["reachable"] == "0"
    given = [10.0 ** -mixed(y) for y in course([float(row["temperature_degC"]) for row in found])]
    assert given == pytest.approx(expected[1:5], rel=3e-9)


def test_the_benchs_page_draws_the_loop_of_a_film_that_mixes_otherwise(tmp_path: Path) -> None:
    curves = []
    for name, text in (("plain", MODEL), ("mixed", MODEL.replace("[plate]", MIXING + "[plate]"))):
        (tmp_path / name).write_text(text)
        followed = app._followed(str(tmp_path / name), None, [30.0, 75.0])
        assert followed is not None
        curves.append(followed.curves)
    plain, drawn = curves
    for branch in ("rising_ohm", "falling_ohm"):
        expected = [10.0 ** -mixed(-math.log10(ohm)) for ohm in plain[branch]]
        assert drawn[branch] == pytest.approx(expected, rel=1e-9)


def test_a_mixing_that_cannot_be_is_told(peltier: Peltier, tmp_path: Path) -> None:
    wrong = "[film.mixing]\nexponent = 0.5\nlow_dec = -3.0\nhigh_dec = -5.5\n"
    (tmp_path / "model.toml").write_text(MODEL.replace("[plate]", wrong + "[plate]"))
    (tmp_path / "target.csv").write_text("time_s,target_ohm\n0,20000\n")
    status, _, err = peltier("invert", tmp_path / "model.toml", tmp_path / "target.csv")
    assert status != 0
    (line,) = err.splitlines()
    assert "low_dec: -3.0: expected less than high_dec, -5.5" in line


def test_a_prediction_that_nothing_is_compared_with(peltier: Peltier, tmp_path: Path) -> None:
    """Without a file to write it is of no use, and that is a fault of the data; with one it is what was asked for."""
    (tmp_path / "model.toml").write_text(MODEL)
    (tmp_path / "r.csv").write_text("time_s,temperature_degC\n" + "".join(f"{k},{30 + 0.5 * k}\n" for k in range(60)))
    words = ("predict", tmp_path / "model.toml", tmp_path / "r.csv")
    assert "r.csv: nothing to compare; expected readings of the film" in peltier.fails(*words)
    assert peltier(*words, "--out", tmp_path / "p.csv")[0] == 0
    assert "predicted_ohm" in (tmp_path / "p.csv").read_text()


@pytest.mark.parametrize(
    ("options", "current", "said"),
    [
        (("--drive", "current"), False, "record.csv has no current_A; expected --drive temperature"),
        (("--first", "60"), True, "--first: 60: expected --initial fitted with it"),
    ],
)
def test_useless_options(options: tuple[str, ...], current: bool, said: str, peltier: Peltier, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    time = np.arange(100.0)
    columns = {"time_s": time, "temperature_degC": 50.0 + time / 9.0, "resistance_ohm": 1e4 + time}
    write_columns(tmp_path / "record.csv", columns | ({"current_A": np.ones(100)} if current else {}))
    status, out, err = peltier("predict", tmp_path / "model.toml", tmp_path / "record.csv", *options)
    assert (status, out) == (2, "")
    (line,) = err.splitlines()
    assert said in line


@pytest.mark.parametrize(
    ("lacking", "options", "said"),
    [
        ((), (), "fitted to the first 31 rows: "),
        ((), ("--first", "1e9"), "fitted to the first 150 rows (half of the rows at most: the rest is to"),
        ([(80, 120), (180, 220)], (), "fitted to the first 31 rows and 61 after 2 gaps: "),
    ],
)
def test_the_rows_that_are_fitted_are_said(
    lacking: list[tuple[int, int]], options: tuple[str, ...], said: str, peltier: Peltier, tmp_path: Path
) -> None:
    (tmp_path / "model.toml").write_text(MODEL)
    time = np.arange(300.0)
    there = [not any(begin <= t < end for begin, end in lacking) for t in time]
    columns = {"time_s": time, "temperature_degC": 60.0 + 10.0 * np.sin(time / 30.0), "resistance_ohm": 1e4 + time}
    write_columns(tmp_path / "record.csv", {name: values[there] for name, values in columns.items()})
    words = ("--initial", "fitted", *options)
    out = peltier.succeeds("predict", tmp_path / "model.toml", tmp_path / "record.csv", *words)
    assert said in out
