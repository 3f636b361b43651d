"""What is given again with the same DIR is computed again where its files have changed, and only there."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import pytest

from rig.batch import Journal
from rig.core.faults import Faults
from rig.core.outcome import Stopped
from tests.peltier import Peltier
from tests.rig.batch.test_many_records import plate_record
from tests.rig.small import write_bench

pytestmark = pytest.mark.usefixtures("undrawn", "computed_here")


def _table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def test_a_sweep_whose_target_is_another_is_no_sweep_of_this_folder(tmp_path: Path, peltier: Peltier) -> None:
    path = write_bench(tmp_path, target='"target.csv"', more="\n[sweep]\nseeds = 1\n", kind="current_profile")
    target, out = tmp_path / "target.csv", tmp_path / "out"
    target.write_text("time_s,current_A\n0,0.5\n5,0.5\n")
    words = ("sweep", path, "--out", out, "--workers", 1)
    peltier.succeeds(*words)
    rows = _table(out / "sweep.csv")[0]["rows"]
    target.write_text("time_s,current_A\n0,0.5\n9,0.5\n")
    assert "of files with other contents" in peltier.fails(*words)
    peltier.succeeds(*words[:3], tmp_path / "new", *words[4:])
    assert int(_table(tmp_path / "new" / "sweep.csv")[0]["rows"]) > int(rows)


def test_a_sweep_of_records_goes_on_without_one_that_is_refused(tmp_path: Path, peltier: Peltier) -> None:
    """And computes a record again that holds something else."""
    for k in (1, 2):
        plate_record(tmp_path / "in" / f"{k}.csv", k, 0.3)
    (tmp_path / "in" / "bad.csv").write_text("hello\n")
    path = tmp_path / "sweep.toml"
    path.write_text('[sweep]\nwhat = "identification"\nrecords = ["in/*.csv"]\n')
    words = ("sweep", path, "--out", tmp_path / "out", "--workers", 1)
    assert f"{tmp_path / 'in' / 'bad.csv'}: line 1: " in peltier.fails(*words)
    before = _table(tmp_path / "out" / "sweep.csv")
    assert [row["status"] for row in before] == ["done", "done", "failed"]
    plate_record(tmp_path / "in" / "1.csv", 1, 0.6)
    plate_record(tmp_path / "in" / "bad.csv", 3, 0.3)
    peltier.succeeds(*words)
    after = _table(tmp_path / "out" / "sweep.csv")
    assert [row["status"] for row in after] == ["done"] * 3
    assert after[1] == {name: cell for name, cell in before[1].items() if name != "text"}  # the column is gone
    assert after[0]["holds"] != before[0]["holds"]
    lines = [json.loads(line)["case"] for line in (tmp_path / "out" / "cases.jsonl").read_text().splitlines()]
    assert [Path(case["record"]).name for case in lines] == ["1.csv", "2.csv", "1.csv", "bad.csv"]


def test_records_that_come_to_others_take_nothing_from_them(tmp_path: Path, peltier: Peltier) -> None:
    """Each keeps its folder, whatever stands before it now; one with other contents gets a new one."""
    first = [plate_record(tmp_path / f"b{k} #1 50%.csv", k, 0.3) for k in (1, 2)]
    out = tmp_path / "out"
    peltier.succeeds("identify", *first, "--each", "--report", out, "--workers", 1)
    assert 'href="b1%20%231%2050%25/report.html"' in (out / "report.html").read_text()
    kept = {path: path.read_bytes() for path in out.glob("b*/*") if path.is_file()}
    lines = (out / "cases.jsonl").read_text()

    new = plate_record(tmp_path / "night" / "b1 #1 50%.csv", 3, 0.4)
    text = peltier.succeeds("identify", new, *first, "--each", "--report", out, "--workers", 1)
    assert (out / "cases.jsonl").read_text().startswith(lines)
    assert len((out / "cases.jsonl").read_text().splitlines()) == 3
    assert [row["folder"] for row in _table(out / "identifications.csv")] == ["b1 #1 50%_2", "b1 #1 50%", "b2 #1 50%"]
    assert kept == {path: path.read_bytes() for path in kept}
    assert "not in the table" not in text

    plate_record(first[0], 4, 0.5)
    text = peltier.succeeds("identify", first[0], "--each", "--report", out, "--workers", 1)
    assert [row["folder"] for row in _table(out / "identifications.csv")] == ["b1 #1 50%_3"]
    assert "3 results of records that are none of these" in text
    assert kept == {path: path.read_bytes() for path in kept}


def test_an_effect_of_ones_own_that_was_changed_is_another_task(tmp_path: Path) -> None:
    from rig.analysis.diagnosed import Asked
    from rig.report.batch import digest_of
    from rig.report.diagnosis import diagnoses

    own = tmp_path / "own.py"
    own.write_text("a = 1\n")
    task = diagnoses(Asked(effect_files=(own,)), [])
    before = digest_of(task)
    assert digest_of(task) == before
    own.write_text("a = 2\n")
    assert digest_of(task) != before


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_with_its_file_and_what_is_kept(tmp_path: Path, peltier: Peltier) -> None:
    files, out = [plate_record(tmp_path / f"{k}.csv", k, 0.3) for k in (1, 2)], tmp_path / "out"
    page = out / "2" / "identification.json"
    page.parent.mkdir(parents=True)
    page.symlink_to("/dev/full")
    words = ("identify", *files, "--each", "--report", out, "--workers", 1)
    err = peltier.fails(*words, status=1)
    assert f"No space left on device: '{page}'" in err
    assert f"{out}: the records that were done are kept" in err
    page.unlink()
    peltier.succeeds(*words)
    assert [row["status"] for row in _table(out / "identifications.csv")] == ["done", "done"]


def test_two_at_a_time_do_not_compute_into_one_folder(tmp_path: Path) -> None:
    """Each would compute everything, and cut off the line that the other is writing."""
    case = {"number": 0, "of": "a", "holds": "x"}
    first = Journal(tmp_path, "t", {0: case}, same=("of", "holds"))
    with (tmp_path / "cases.jsonl").open("a") as lines:
        lines.write('{"case": {"number"')  # half of a line is there already
    with pytest.raises(Faults, match=f"{tmp_path}: another process is computing into it"):
        Journal(tmp_path, "t", {0: case}, same=("of", "holds"))
    assert (tmp_path / "cases.jsonl").read_text() == '{"case": {"number"'
    first.close()
    Journal(tmp_path, "t", {0: case}, same=("of", "holds")).close()


def test_the_table_says_what_was_read(tmp_path: Path, peltier: Peltier) -> None:
    """By which the odd one is seen, and a unit that was taken for another."""
    plate_record(tmp_path / "a.csv", 1, 0.3)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    kelvin = [f"{time};{float(degC) + 273.15:.4f};{ampere}" for time, degC, ampere in rows[:100]]
    (tmp_path / "b.csv").write_text("\n".join(["t / min;T / K;I (A)", *kelvin]) + "\n")
    (tmp_path / "c.csv").write_text("t,T,R\n0,1,2\n1,2,3\n")
    files, out = [tmp_path / f"{name}.csv" for name in "abc"], tmp_path / "out"
    peltier.fails("identify", *files, "--each", "--report", out, "--workers", 1)
    first, second, third = _table(out / "identifications.csv")
    assert (first["rows"], first["duration_s"], first["read"]) == ("240", "239.0", "")
    assert float(first["temperature_degC.highest"]) == max(float(degC) for _, degC, _ in rows)
    assert second["duration_s"] == "5940.0"
    assert "time_s from 't / min' in min, temperature_degC from 'T / K' in K" in second["read"]
    assert third["rows"] == ""
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "100 rows in 5940 s, " in page
    assert page.count(str(tmp_path / "c.csv")) == 1  # and its faults without the name once more
    assert page.count("expected --column") >= 2


@pytest.mark.parametrize(("words", "said"), [(True, "the same command goes on"), (False, "--report DIR keeps them")])
def test_who_stops_it_is_told_what_is_kept(
    tmp_path: Path, peltier: Peltier, monkeypatch: pytest.MonkeyPatch, words: bool, said: str
) -> None:
    def stopped(*arguments: object) -> None:
        raise Stopped(signal.SIGINT)

    monkeypatch.setattr("rig.report.batch.each_record", stopped)
    files = [plate_record(tmp_path / f"{k}.csv", k, 0.3) for k in (1, 2)]
    more = ("--report", tmp_path / "out") if words else ()
    assert said in peltier.fails("identify", *files, "--each", *more, status=130)
