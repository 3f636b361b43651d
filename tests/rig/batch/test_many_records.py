"""Several records of one verb: each as if it were alone, side by side; a table with links; nothing is done twice."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from rig.batch import EngineChoice
from rig.records.record import Record
from rig.report.batch import Task, each_record
from tests.peltier import Peltier
from tests.rig.batch.work import refused


def plate_record(path: Path, seed: int, gain: float) -> Path:
    """A plate that is driven back and forth; Euler, by hand."""
    random = np.random.default_rng(seed)
    rows, plate = ["time_s,temperature_degC,current_A"], 25.0
    for k in range(240):
        ampere = 0.8 if k % 96 < 48 else -0.4
        rows.append(f"{k},{plate + 0.01 * random.standard_normal():.4f},{ampere}")
        plate += gain * ampere + 0.02 * ampere**2 - 0.02 * (plate - 25.0)
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture
def records(tmp_path: Path) -> list[Path]:
    return [plate_record(tmp_path / f"night{k}" / "record.csv", k, 0.3 + 0.1 * k) for k in (1, 2)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("verb", "document"),
    [("identify", "identification.json"), ("diagnose", "diagnosis.json")],
)
def test_each_is_as_if_alone(verb: str, document: str, records: list[Path], tmp_path: Path, peltier: Peltier) -> None:
    more = ("--each",) if verb == "identify" else ()
    broken = tmp_path / "short.csv"
    broken.write_text("time_s,temperature_degC,current_A\n0,25,1\n1,26,1\n2,27,1\n")
    out = tmp_path / "out"
    words = (verb, *records, broken, *more, "--report", out, "--workers", 2, "--json", "-")
    status, text, err = peltier(*words)
    assert status == 2, err  # one of three is refused; the others are there all the same
    assert f"{broken}: " in err
    together = json.loads(text)
    assert len(together) == 2
    for record, one in zip(records, together, strict=True):
        text = peltier.succeeds(verb, record, "--json", "-")
        alone = json.loads(text)
        assert {k: v for k, v in one.items() if k != "model"} == {k: v for k, v in alone.items() if k != "model"}
    for name in ("record", "record_2"):
        assert (out / name / document).is_file()
        assert (out / name / "report.html").is_file()
        assert (out / name / "model.toml").is_file()
        assert f'href="{name}/report.html"' in (out / "report.html").read_text()
    table = out / ("identifications.csv" if verb == "identify" else "diagnoses.csv")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["status"] for row in rows] == ["done", "done", "failed"]

    lines = (out / "cases.jsonl").read_text().splitlines(keepends=True)
    (out / "cases.jsonl").write_text("".join(line for line in lines if '"number": 1,' not in line))
    before = table.read_bytes()
    status, text, err = peltier(*words)
    assert status == 2, err  # one of three is refused; the others are there all the same
    assert json.loads(text) == together
    assert len((out / "cases.jsonl").read_text().splitlines()) == 3
    assert table.read_bytes() == before
    assert "is of other" in peltier.fails(verb, *records, broken, *more, "--report", out, "--plate", "heater")


def test_the_others_are_written_where_one_is_refused(records: list[Path], tmp_path: Path, peltier: Peltier) -> None:
    """Told at the beginning and the end, with status 2; once it is mended the same command computes this one alone."""
    bad, out = tmp_path / "a_lamp.csv", tmp_path / "out"
    bad.write_text("t_s,u_V,y_C\n0,1,20\n1,1,21\n")
    words = ("identify", bad, records[0], "--each", "--report", out)
    status, text, err = peltier(*words)
    assert status == 2
    assert "column 'temperature_degC' missing" in err
    assert "1 of 2 records could not be taken" in text
    assert (out / "record" / "report.html").is_file()
    assert "column &#x27;temperature_degC&#x27; missing" in (out / "report.html").read_text()
    rows = list(csv.DictReader((out / "identifications.csv").read_text().splitlines()))
    assert [row["status"] for row in rows] == ["failed", "done"]

    before = (out / "cases.jsonl").read_text()
    bad.write_text(plate_record(tmp_path / "night3" / "record.csv", 3, 0.5).read_text())
    peltier.succeeds(*words)
    assert (out / "cases.jsonl").read_text().startswith(before)
    assert len((out / "cases.jsonl").read_text().splitlines()) == 2
    err = peltier.fails("identify", tmp_path / "none.csv", tmp_path / "nor.csv", "--each")
    assert err.splitlines() == [f"{tmp_path / name}: no such file" for name in ("none.csv", "nor.csv")]


def test_the_faults_of_a_record_stay_apart(tmp_path: Path) -> None:
    """On the page and when the command is given again, whatever stands in them; one cell in the table."""
    task = Task(refused, None, "identification.json", "identifications", "", dict, len, {})
    faults = ["a.csv: row 3 / a.csv: row 4", "a.csv: row 9"]
    record = Record({"time_s": np.arange(3.0)}, source="a.csv")
    for _ in range(2):
        told = each_record([record], task, tmp_path, EngineChoice(workers=1), lambda *_: None)
        assert told == ([], faults, 0)
    assert "row 3 / a.csv: row 4<br>row 9</td>" in (tmp_path / "report.html").read_text()
    (row,) = csv.DictReader((tmp_path / "identifications.csv").read_text().splitlines())
    assert row["text"] == " / ".join(faults)


def test_a_fault_is_told_once_where_no_record_is_left(tmp_path: Path, peltier: Peltier) -> None:
    """When its record ends, and not at the end again."""
    flat = tmp_path / "flat.csv"
    rows = "".join(f"{second},25,1000\n" for second in range(100))
    flat.write_text(f"time_s,temperature_degC,resistance_ohm\n{rows}")
    err = peltier.fails("identify", flat, "--each", "--workers", 1)
    assert err.count("temperature_degC: constant at 25") == 1


def test_what_is_said_of_all_records_alike_is_said_once(records: list[Path], peltier: Peltier) -> None:
    for record in records:
        record.write_text(record.read_text().replace("temperature_degC", "T_C", 1))
    odd = plate_record(records[0].with_name("odd.csv"), 3, 0.5)
    odd.write_text(odd.read_text().replace("temperature_degC", "Temp_C", 1))
    status, _, err = peltier("identify", *records, odd, "--each", "--workers", 1)
    assert status == 0, err
    said = [line for line in err.splitlines() if "taken: " in line]
    assert said == [
        f"{records[0]} and 1 more: taken: temperature_degC from 'T_C'",
        f"{odd}: taken: temperature_degC from 'Temp_C'",
    ]


def test_one_more_record_does_not_take_the_table_away(
    records: list[Path], tmp_path: Path, peltier: Peltier, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A batch's folder stays one when a single record is given to it."""
    out = tmp_path / "out"
    peltier.succeeds("identify", *records, "--each", "--report", out, "--workers", 1)
    page = (out / "report.html").read_text()
    err = peltier.fails("identify", records[0], "--report", out)
    assert "has the table of many records; expected --each, or another DIR" in err
    for words in ((*records, "--joint"), (records[0], "--out", tmp_path / "model.toml")):
        status, _, err = peltier("diagnose", *words, "--report", out)
        assert status == 2, words
    assert (out / "report.html").read_text() == page
    taken: list[int] = []

    def report_each(records: list[Record], *rest: object) -> int:
        taken.append(len(records))
        return 0

    monkeypatch.setattr("rig.command.records.report_each", report_each)
    assert peltier("diagnose", records[0], "--report", out)[0] == 0
    assert taken == [1]
