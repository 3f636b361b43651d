"""Records whose rows say nothing of time, or something that cannot be: told in one line, with what to type; and what is
typed is right."""

from __future__ import annotations

import argparse
import re
import shlex
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import rig
from rig.command.record_arguments import add_record_arguments, read_each
from rig.core.faults import Faults
from rig.notebook.files import as_records
from rig.records.branches import join_branches
from rig.records.record import Record, Refused
from rig.records.record_file import RowOrder
from tests.peltier import Peltier
from tests.rig.records.reading import read, refusal

HALF = 150  # rows of a branch
HEATING_DEGC, COOLING_DEGC = 66.0, 60.0  # where this film is steepest


def branch(heating: bool, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Temperature (degC) and resistance (ohm) of a film on one branch, in the order of time."""
    random = np.random.default_rng(seed + heating)
    degC = np.linspace(25.0, 90.0, HALF) if heating else np.linspace(90.0, 25.0, HALF)
    middle = HEATING_DEGC if heating else COOLING_DEGC
    logs = 3.5 - 1.5 * np.tanh((degC - middle) / 3.0) + random.normal(0.0, 0.002, HALF)
    return degC + random.normal(0.0, 0.01, HALF), 10.0**logs


def rows_of(*columns: np.ndarray, separator: str = ",") -> str:
    return "\n".join(separator.join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)) + "\n"


@pytest.fixture
def loop() -> tuple[np.ndarray, np.ndarray]:
    parts = branch(True), branch(False)
    return np.concatenate([parts[0][0], parts[1][0]]), np.concatenate([parts[0][1], parts[1][1]])


def typed_on(path: Path, text: str) -> Record:
    """The record with the first --column that the refusal offers."""
    words = re.search(r"--column ('[^']*'|\S+)", refusal(path, text))
    assert words is not None
    return read(path, text, *shlex.split(words[1]))


def transition(record: Record) -> tuple[float | None, float | None]:
    """Where the resistance passes its middle (degC), falling as on heating and rising as on cooling."""
    read = np.isfinite(record["temperature_degC"])
    degC, high = record["temperature_degC"][read], record["resistance_ohm"][read] > 10.0**3.5
    found = {bool(high[k]): 0.5 * float(degC[k] + degC[k + 1]) for k in np.flatnonzero(np.diff(high))}
    return found.get(True), found.get(False)


def assert_the_loop(record: Record) -> None:
    heating, cooling = transition(record)
    assert heating == pytest.approx(HEATING_DEGC, abs=0.3)
    assert cooling == pytest.approx(COOLING_DEGC, abs=0.3)


def test_a_table_without_times_is_asked_for_the_order_of_its_rows(tmp_path: Path, loop: tuple) -> None:
    """Most published R(T) tables: there was no way to read them, and another column was offered as the time."""
    text = "Temperature (K)\tResistance (Ohm)\n" + rows_of(loop[0] + 273.15, loop[1], separator="\t")
    said = refusal(tmp_path / "loop.txt", text)
    assert "no column of times: expected --column time_s=row" in said
    assert "--period SECONDS" in said
    assert "--reversed" in said
    assert "time_s=Temp" not in said
    record = typed_on(tmp_path / "loop.txt", text)
    assert record.times == "rows"
    assert_the_loop(record)


@pytest.mark.parametrize("words", [("--column", "time_s=row"), ("--period", "0.5")])
def test_no_rates_of_rows_without_times(tmp_path: Path, peltier: Peltier, loop: tuple, words: tuple[str, ...]) -> None:
    """The ramps of a published table would be those of its rows, 1 K/s."""
    path = tmp_path / "loop.csv"
    path.write_text("T (C),R (Ohm)\n" + rows_of(*loop))
    status, out, err = peltier("identify", path, *words, "--operators", "8", "--json", tmp_path / "a.json")
    assert status == 0, err
    assert "transition temperature on heating   66" in out
    assert "K/s" not in out + err
    assert '"rate_K_per_s": null' in (tmp_path / "a.json").read_text()


def test_times_without_a_clock_are_no_times_of_a_diagnosis_or_a_plate(tmp_path: Path, peltier: Peltier) -> None:
    """Lags and time constants would be told in rows, as if they were seconds."""
    path = tmp_path / "plate.csv"
    path.write_text("T (C),I (A)\n" + rows_of(25.0 + np.arange(40.0) % 7, np.arange(40.0) % 3))
    for verb in ("diagnose", "identify"):
        err = peltier.fails(verb, path, "--column", "time_s=row")
        assert "times" in err.splitlines()[-1] or "current_A" in err.splitlines()[-1]
    err = peltier.fails("diagnose", path, "--column", "time_s=row")
    assert "a diagnosis needs them: expected --period SECONDS" in err


def test_a_cooling_branch_that_is_sorted_upwards(tmp_path: Path) -> None:
    """It was reported as heating."""
    degC, ohm = branch(False)
    text = "T (C),R (Ohm)\n" + rows_of(degC[::-1], ohm[::-1])
    record = read(tmp_path / "branch.csv", text, "time_s=row", order=RowOrder(reversed=True))
    assert transition(record) == (None, pytest.approx(COOLING_DEGC, abs=0.3))
    named = read(tmp_path / "film_cooling.csv", text, "time_s=row")
    (turned,) = join_branches([named], RowOrder())
    assert transition(turned) == (None, pytest.approx(COOLING_DEGC, abs=0.3))
    assert "its name says cooling" in " ".join(turned.notes)


@pytest.mark.parametrize(
    ("names", "asked"),
    [
        (("b_heating.csv", "b_cooling.csv"), False),
        (("warm_up.csv", "cool_down.csv"), False),
        (("1.csv", "2.csv"), True),
    ],
)
def test_branches_in_two_files(tmp_path: Path, names: tuple[str, str], asked: bool) -> None:
    """Two records of a branch each have no hysteresis."""
    rows = RowOrder(branches=asked)
    found = []
    for name, heating in zip(names, (True, False), strict=True):
        degC, ohm = branch(heating)
        order = slice(None) if heating else slice(None, None, -1)  # both sorted upwards
        found.append(
            read(tmp_path / name, "T (C),R (Ohm)\n" + rows_of(degC[order], ohm[order]), "time_s=row", order=rows)
        )
    (joined,) = join_branches(found, rows)
    assert_the_loop(joined)
    assert np.all(np.diff(joined["time_s"]) > 0.0)
    assert len(join_branches(found[:1], RowOrder())) == 1


@pytest.mark.parametrize(
    "head",
    [
        "T_heating (C),R_heating (ohm),T_cooling (C),R_cooling (ohm)",
        "Temperature (heating) [C],R (heating) [ohm],Temperature (cooling) [C],R (cooling) [ohm]",
        "Heating T (C),Heating R (ohm),Cooling T (C),Cooling R (ohm)",
        "T up (C),R up (ohm),T down (C),R down (ohm)",
    ],
)
def test_branches_side_by_side(tmp_path: Path, head: str) -> None:
    """A column of temperatures was offered as that of times."""
    text = f"{head}\n" + rows_of(*branch(True), *(values[::-1] for values in branch(False)))
    for order in (None, RowOrder(reversed=True)):  # which turns no number that the program itself has given
        record = read(tmp_path / "film.csv", text, order=order)
        assert_the_loop(record)
        assert "branches of a loop taken one after the other" in " ".join(record.notes)


@pytest.mark.parametrize(
    ("head", "asked"),
    [
        ("T,R,T,R\nK,kOhm,degC,Ohm", True),
        ("T heating (K),R heating (kOhm),T cooling (C),R cooling (Ohm)", False),
    ],
)
def test_branches_side_by_side_in_two_units(tmp_path: Path, head: str, asked: bool) -> None:
    """Both were taken in the first one's unit: degrees as kelvins, ohms as kilohms."""
    (warm_degC, warm_ohm), cold = branch(True), branch(False)
    text = f"{head}\n" + rows_of(warm_degC + 273.15, warm_ohm / 1e3, *cold)
    if asked:
        assert "heating and cooling side by side? expected --branches" in refusal(tmp_path / "film.csv", text)
    assert_the_loop(read(tmp_path / "film.csv", text, order=RowOrder(branches=asked)))
    half = read(tmp_path / "film.csv", text, "time_s=row", "temperature_degC=#1@K", "resistance_ohm=#2@kohm")
    assert transition(half) == (pytest.approx(HEATING_DEGC, abs=0.3), None)  # a number is one of the file's columns


def test_branches_side_by_side_of_which_cooling_came_first(tmp_path: Path) -> None:
    """Heating was put first, and the times of cooling were moved without a word."""
    seconds = np.arange(float(HALF))
    head = "t_heating (s),T_heating (C),R_heating (ohm),t_cooling (s),T_cooling (C),R_cooling (ohm)"
    text = f"{head}\n" + rows_of(seconds + HALF + 60.0, *branch(True), seconds, *branch(False))
    record = read(tmp_path / "film.csv", text)
    assert "cooling first" in " ".join(record.notes)
    assert "shifted behind" not in " ".join(record.notes)
    np.testing.assert_allclose(record["time_s"], np.concatenate([seconds, seconds + HALF + 60.0]))
    np.testing.assert_allclose(record["temperature_degC"][:HALF], branch(False)[0], rtol=1e-5)
    anew = read(tmp_path / "film.csv", f"{head}\n" + rows_of(seconds, *branch(True), seconds, *branch(False)))
    assert "heating first; its times shifted behind the first" in " ".join(anew.notes)


@pytest.mark.parametrize("line", ["cooling,cooling,heating,heating", "Cooling,,Heating,", "cooled run,,heated run,"])
@pytest.mark.parametrize("rows", [None, RowOrder(branches=True)])
def test_a_line_above_the_rows_says_which_branch_is_which(tmp_path: Path, line: str, rows: RowOrder | None) -> None:
    """Origin's line of comments was ignored, and the branch that stands first was heating whatever it said."""
    text = f"T,R,T,R\ndegC,Ohm,degC,Ohm\n{line}\n" + rows_of(*branch(False), *branch(True))
    record = read(tmp_path / "film.csv", text, order=rows)
    assert_the_loop(record)
    np.testing.assert_allclose(record["temperature_degC"][:HALF], branch(True)[0], rtol=1e-5)


def test_branches_below_each_other(tmp_path: Path) -> None:
    """Both sorted upwards, the cooling branch would be a second heating."""
    parts = [branch(True), tuple(values[::-1] for values in branch(False))]
    text = "T (C),R (ohm)\n" + "".join(rows_of(*part) for part in parts)
    said = refusal(tmp_path / "film.csv", text, "time_s=row")
    assert "in one row: two branches, sorted the same way? expected --branches" in said
    assert_the_loop(read(tmp_path / "film.csv", text, "time_s=row", order=RowOrder(branches=True)))
    named = "T (C),R (ohm),sweep\n"
    for part, word in zip(parts, ("heating", "cooling"), strict=True):
        named += rows_of(*part).replace("\n", f",{word}\n")
    assert_the_loop(read(tmp_path / "film.csv", named))


SAME = ("a_heating.csv", "b_heating.csv")
GONE = 40, HALF + 30  # rows of two branches below each other
FAULT_ROWS = slice(20, 23)  # in the order of the file


def with_a_fault(heating: bool, upwards: bool = True) -> str:
    """A branch with three rows in which its thermometer reads a fault value."""
    degC, ohm = branch(heating)
    order = slice(None) if heating == upwards else slice(None, None, -1)
    degC, ohm = degC[order].copy(), ohm[order]
    degC[FAULT_ROWS] = -127.0
    return "T (C),R (Ohm)\n" + rows_of(degC, ohm)


def assert_left_out(record: Record, *rows: list[int]) -> None:
    """Rows from 1, first and last: those named are those without a temperature, and the fault value is kept aside."""
    assert [one["rows"] for one in record.left_out_document()] == list(rows)
    assert record.raw_temperature_degC is not None
    assert np.array_equal(np.isnan(record["temperature_degC"]), record.raw_temperature_degC == -127.0)
    named = [k for first, last in rows for k in range(first - 1, last)]
    assert np.flatnonzero(np.isnan(record["temperature_degC"])).tolist() == named
    assert record.raw_columns()["temperature_degC"].shape == record["resistance_ohm"].shape


def test_rows_that_are_left_out_are_joined_with_their_branches(tmp_path: Path) -> None:
    """Those of the second file were forgotten, and `predict --out` met columns of two lengths."""
    named = {"film_heating.csv": True, "film_cooling.csv": False}
    found = [read(tmp_path / name, with_a_fault(heating), "time_s=row") for name, heating in named.items()]
    (joined,) = join_branches(found, RowOrder())
    assert isinstance(joined, Record)
    assert joined.rows == 2 * HALF
    assert_left_out(joined, [21, 23], [2 * HALF - 22, 2 * HALF - 20])
    plain = read(tmp_path / "film_heating.csv", "T (C),R (Ohm)\n" + rows_of(*branch(True)), "time_s=row")
    (joined,) = join_branches([plain, found[1]], RowOrder())
    assert isinstance(joined, Record)
    assert_left_out(joined, [2 * HALF - 22, 2 * HALF - 20])


@pytest.mark.parametrize("missing", ["", "850", "-300"])
def test_branches_below_each_other_where_a_temperature_is_missing(tmp_path: Path, missing: str) -> None:
    """One empty field, and the cooling branch was taken for a second heating, whatever was typed."""
    parts = [branch(True), tuple(values[::-1] for values in branch(False))]
    lines = "".join(rows_of(*part) for part in parts).splitlines()
    for k in GONE:
        lines[k] = f"{missing},{lines[k].split(',')[1]}"
    text = "\n".join(["T (C),R (ohm)", *lines]) + "\n"
    assert "two branches, sorted the same way? expected --branches" in refusal(
        tmp_path / "film.csv", text, "time_s=row"
    )
    record = read(tmp_path / "film.csv", text, "time_s=row", order=RowOrder(branches=True))
    if missing == "850":  # one reading that is far off, as noise makes them, is not left out
        assert np.flatnonzero(record["temperature_degC"] == 850.0).tolist() == [40, 2 * HALF - 31]
    else:
        assert_the_loop(record)
        assert np.flatnonzero(np.isnan(record["temperature_degC"])).tolist() == [40, 2 * HALF - 31]


def test_a_file_that_cannot_be_read_changes_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One of many was refused, and every cooling branch beside it was taken for a heating, without a word."""
    paths = [tmp_path / name for name in ("a_heating.csv", "broken.csv", "a_cooling.csv", "b_cooling.csv")]
    for path in paths:
        heating = "heating" in path.name
        part = branch(heating) if heating else tuple(values[::-1] for values in branch(False))
        path.write_text("T (C),R (Ohm)\n" + rows_of(*part) if path.name != "broken.csv" else "nothing\n")
    parser = argparse.ArgumentParser()
    add_record_arguments(parser)
    loop, broken, cooling = read_each(paths, parser.parse_args(["--column", "time_s=row"]))
    assert isinstance(broken, Refused)
    assert isinstance(loop, Record)
    assert isinstance(cooling, Record)
    assert_the_loop(loop)
    assert transition(cooling) == (None, pytest.approx(COOLING_DEGC, abs=0.3))
    assert "its name says cooling" in capsys.readouterr().err


def test_the_word_for_branches_and_files_that_need_it_not(tmp_path: Path) -> None:
    """A file with its branches side by side, or with a whole loop, and times was refused: "expected two files"; two
    such files became one loop."""
    rows, seconds = RowOrder(branches=True), np.arange(float(HALF))
    head = "t_heating (s),T_heating (C),R_heating (ohm),t_cooling (s),T_cooling (C),R_cooling (ohm)"
    text = f"{head}\n" + rows_of(seconds, *branch(True), seconds, *branch(False))
    found = [read(tmp_path / name, text, order=rows) for name in ("a.csv", "b.csv")]
    assert join_branches(found, rows) == found
    assert join_branches(found[:1], rows) == found[:1]
    held_out = read(tmp_path / "c.csv", "time_s,T (C),R (ohm)\n" + rows_of(seconds, *branch(True)), order=rows)
    assert join_branches([held_out], rows) == [held_out]
    same = [
        read(tmp_path / name, "T (C),R (Ohm)\n" + rows_of(*branch(True)), "time_s=row", order=rows) for name in SAME
    ]
    with pytest.raises(Faults, match="expected one of heating and one of cooling"):  # two films are no loop
        join_branches(same, rows)


@pytest.mark.parametrize("names", [("film_heating.csv", "film_cooling.csv"), ("film_cooling.csv", "film_heating.csv")])
def test_branches_in_python(tmp_path: Path, names: tuple[str, str]) -> None:
    """`rig.identify` took each branch for a record of its own, and a cooling one that is sorted upwards for a
    heating."""
    found = []
    for name in names:
        heating = "heating" in name
        part = branch(True) if heating else tuple(values[::-1] for values in branch(False))
        (tmp_path / name).write_text("T (C),R (Ohm)\n" + rows_of(*part))
        found.append(rig.read_record(tmp_path / name, "time_s=row"))
        assert (found[-1]["temperature_degC"][0] < 30.0) == heating
    (joined,) = as_records(found)
    assert_the_loop(joined)


@pytest.mark.parametrize("framed", [False, True])
def test_the_order_of_rows_of_arrays(loop: tuple, framed: bool) -> None:
    """What was said of it in Python was ignored, but for files."""
    columns = {"T (C)": loop[0][::-1], "R (ohm)": loop[1][::-1]}
    source = pytest.importorskip("pandas").DataFrame(columns) if framed else columns
    record = rig.read_record(source, period_s=0.5, reversed=True)
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.5)
    np.testing.assert_allclose(record["temperature_degC"], loop[0])
    side = np.split(loop[0], 2), np.split(loop[1], 2)
    names = ("T_heating (C)", "T_cooling (C)", "R_heating (ohm)", "R_cooling (ohm)")
    assert_the_loop(rig.read_record(dict(zip(names, [*side[0], *side[1]], strict=True)), branches=True))
    with pytest.raises(Faults, match="expected a number of seconds > 0"):
        rig.read_record(columns, period_s=-1.0)


def test_a_heater_beside_a_film_is_no_branch(tmp_path: Path) -> None:
    """T_heating of a rig with times is a thermometer of its own."""
    text = "Time (s),T_heating (C),T_cooling (C),T (C)\n" + "".join(
        f"{k},60,{15 + k % 2},{25 + k % 5}\n" for k in range(40)
    )
    record = read(tmp_path / "rig.csv", text)
    assert record.rows == 40
    assert "T_heating (C)" in record.columns


@pytest.mark.parametrize(
    ("head", "typed"),
    [
        ("1000/T (1/K)", "temperature_degC=1000/T (1/K)@K"),
        ("1/T (K^-1)", "temperature_degC=1/T (K^-1)@degC"),
        ("Ramp (K/min)", "temperature_degC=Ramp (K/min)@K"),
        ("Signal (mV)", "temperature_degC=Signal (mV)@degC"),
        ("Resistivity (Ohm cm)", "resistance_ohm=Resistivity (Ohm cm)@ohm"),
    ],
)
def test_a_unit_against_the_file_s_own_is_refused(tmp_path: Path, head: str, typed: str) -> None:
    """1000/T as kelvins was believed: a transition at -270 degC."""
    text = f"Time (s),T (C),{head}\n" + "".join(f"{k},{25 + k % 5},{3.0 + 0.01 * k}\n" for k in range(40))
    assert "which is no unit of that" in refusal(tmp_path / "a.csv", text, typed)


def test_a_reciprocal_temperature_is_read_as_one(tmp_path: Path, loop: tuple) -> None:
    kelvin = loop[0] + 273.15
    rows = zip(np.arange(kelvin.size), 1e3 / kelvin, np.log(loop[1]), strict=True)
    text = "Time (s),1000/T (1/K),ln R (ohm)\n" + "".join(f"{t},{x:.7g},{y:.6g}\n" for t, x, y in rows)
    said = refusal(tmp_path / "a.csv", text)
    assert "1/K is a reciprocal temperature" in said
    assert "@K" not in said
    assert_the_loop(typed_on(tmp_path / "a.csv", text))


def test_one_column_is_taken_for_one_quantity(tmp_path: Path) -> None:
    text = "Time (s),T (C)\n0,25\n1,26\n2,27\n"
    said = refusal(tmp_path / "a.csv", text, "temperature_degC=T (C)", "sink_degC=T (C)")
    assert "was typed for temperature_degC and for sink_degC" in said


def test_a_date_is_no_number_of_seconds(tmp_path: Path) -> None:
    text = "date;T (C)\n" + "".join(f"20/10/2026-23:5{k}:00;{25 + k}\n" for k in range(9))
    assert "is a date or a clock's time" in refusal(tmp_path / "a.csv", text, "time_s=date@s")
    assert "was typed as a date" in refusal(tmp_path / "a.csv", "t (s),T (C)\n0,25\n1,26\n", "time_s=t (s)@dmy")
    np.testing.assert_allclose(np.diff(read(tmp_path / "a.csv", text)["time_s"]), 60.0)


@pytest.mark.parametrize(
    "form",
    [
        "%d/%m/%Y-%H:%M:%S", "%Y-%m-%d_%H-%M-%S", "%Y%m%d-%H%M%S", "%Y%m%d%H%M%S", "%H:%M:%S %d/%m/%Y",
        "%d-%b-%Y-%H:%M:%S", "%a %b %d %H:%M:%S %Y", "%d.%m.%Y %H.%M.%S", "%Y-%m-%d %H:%M:%S UTC", "%d/%b/%Y:%H:%M:%S",
    ],
)  # fmt: skip
def test_ways_of_writing_a_date_with_its_time(tmp_path: Path, form: str) -> None:
    """Each was "expected a number"; 20261020235500 is one, and was 100 s a minute."""
    when = [datetime(2026, 10, 20, 23, 58) + timedelta(seconds=20 * k) for k in range(12)]
    text = "date,T (C)\n" + "".join(f"{stamp.strftime(form)},{25 + k}\n" for k, stamp in enumerate(when))
    np.testing.assert_allclose(np.diff(read(tmp_path / "a.csv", text)["time_s"]), 20.0)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S", "%d/%m/%Y %H:%M:%S", "%H:%M:%S"])
def test_the_hour_that_comes_twice(tmp_path: Path, form: str) -> None:
    """It was told as another sweep, to be put in a file of its own: the film's memory would be lost in between."""
    when = [datetime(2026, 10, 25, 2, 55) + timedelta(seconds=2 * k) for k in range(300)]
    local = [one - timedelta(hours=1) if one >= datetime(2026, 10, 25, 3) else one for one in when]
    text = "Timestamp,T (C)\n" + "".join(f"{one.strftime(form)},{25 + k % 9}\n" for k, one in enumerate(local))
    assert "the clock went back by 1 h (end of summer time?)" in refusal(tmp_path / "a.csv", text)
    np.testing.assert_allclose(np.diff(typed_on(tmp_path / "a.csv", text)["time_s"]), 2.0)


def test_a_clock_of_twelve_hours_that_does_not_say_which(tmp_path: Path) -> None:
    """ "Expected increasing times" was all that was said, or that another sweep begins."""
    when = [datetime(2026, 10, 20, 12, 55) + timedelta(seconds=2 * k) for k in range(300)]
    text = "Timestamp,T (C)\n" + "".join(f"{one:%Y-%m-%d %I:%M:%S},{25 + k % 9}\n" for k, one in enumerate(when))
    said = refusal(tmp_path / "a.csv", text)
    assert "line 152: time_s: the clock went back by 12 h: of 12 hours, without AM or PM? expected" in said


LINES = [f"{2 * k}.0,{25 + k % 30}.5,{1000 - k}" for k in range(200)]
HEAD = "time_s,temperature_degC,resistance_ohm"


@pytest.mark.parametrize(
    "lines", [[*LINES[:100], LINES[99], *LINES[100:]], [*LINES, LINES[-1]], [*LINES[:100], *LINES[90:]]]
)
def test_rows_that_are_doubled_word_for_word_are_left_out(tmp_path: Path, lines: list[str]) -> None:
    """One such row in 601 refused the file, and an editor was the only way on."""
    record = read(tmp_path / "a.csv", "\n".join([HEAD, *lines]) + "\n")
    assert record.rows == 200
    assert "left out, the same word for word as line" in record.notes[0]


def test_a_clock_that_is_set_back_a_little_leaves_rows_out(tmp_path: Path) -> None:
    lines = [f"{0.2 * k - (0.4 if k > 100 else 0.0):.1f},{25 + k % 30},{1000 - k}" for k in range(200)]
    record = read(tmp_path / "a.csv", "\n".join([HEAD, *lines]) + "\n")
    assert record.rows == 198
    assert "line 103 and 1 more left out: the clock went back by 0.4 s" in record.notes[0]
    assert np.all(np.diff(record["time_s"]) > 0.0)


def test_a_clock_that_is_wrong_throughout_is_refused(tmp_path: Path) -> None:
    back = [f"{2 * k - (5 if k > 100 else 0)},{25 + k % 30},{1000 - k}" for k in range(200)]
    assert "expected increasing times" in refusal(tmp_path / "a.csv", "\n".join([HEAD, *back]) + "\n")
    full = [f"{k // 2},{25 + k % 30},{1000 - k}" for k in range(200)]
    said = refusal(tmp_path / "a.csv", "\n".join([HEAD, *full]) + "\n")
    assert "the same as in the row before (100 such rows, to line 201)" in said


def test_times_beside_a_period_that_is_typed(tmp_path: Path) -> None:
    """A file's own times were thrown away in silence; and a period was offered for times that stand still, and refused
    when it was typed."""
    rows = RowOrder(period_s=0.5)
    text = "".join(f"{k // 2},{25 + k % 30},{1000 - k}\n" for k in range(200))
    assert "expected a time of its own for each row, or --period" in refusal(tmp_path / "a.csv", f"{HEAD}\n{text}")
    record = read(tmp_path / "a.csv", f"{HEAD}\n{text}", order=rows)
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.5)
    assert "'time_s' left out: the times are those of --period" in " ".join(record.notes)
    record = read(tmp_path / "b.csv", "Time (s),T (C)\n" + "".join(f"{k},{25 + k}\n" for k in range(20)), order=rows)
    assert "'Time (s)' left out: the times are those of --period" in " ".join(record.notes)
    with pytest.raises(Faults, match="a period or time_s=row was typed, and the file has time_s"):
        read(tmp_path / "c.csv", "\n".join([HEAD, *LINES]) + "\n", order=rows)


@pytest.mark.parametrize("name", ["ms", "Milliseconds", "Fractional Seconds", "nsec"])
def test_seconds_and_their_fractions_in_two_columns(tmp_path: Path, name: str) -> None:
    """Two rows a second: the second was told as another sweep."""
    part = {"ms": "500", "Milliseconds": "500", "Fractional Seconds": "0.500000", "nsec": "500000000"}[name]
    lines = [f"11/21/2026,14:03:{k // 2:02d},{part if k % 2 else '0'},{25 + k}" for k in range(40)]
    record = read(tmp_path / "a.csv", f"Date,Time,{name},T (C)\n" + "\n".join(lines) + "\n")
    np.testing.assert_allclose(np.diff(record["time_s"]), 0.5)
    assert name in " ".join(record.notes)


@pytest.mark.parametrize(
    "written", ["-9.9E37", "-9.90000000E+037", "-1.000000000e+38", "-OL", "-OVLD", "-inf", "-9.99999E+9"]
)
def test_overflow_has_the_sign_of_the_input(tmp_path: Path, written: str) -> None:
    """ "-inf: expected > 0" was said of a file that says -9.9E+37, and the whole of it refused."""
    lines = [f"{k},{25 + k},{written if k in (5, 9) else 1000 - k}" for k in range(40)]
    record = read(tmp_path / "a.csv", f"{HEAD}\n" + "\n".join(lines) + "\n")
    assert np.flatnonzero(np.isposinf(record["resistance_ohm"])).tolist() == [5, 9]
    assert "beyond the range" in " ".join(record.notes)
