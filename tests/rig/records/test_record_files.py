"""Records as labs write them: read right as they are, or refused with what to type; never wrong in silence."""

from __future__ import annotations

import re
import shlex
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from rig.core.faults import Faults
from rig.records.column_names import ColumnMapping
from rig.records.conversion import record_from_arrays
from rig.records.record_file import read_record, write_columns
from rig.records.table import frame_columns
from tests.peltier import Peltier
from tests.rig.records import ways
from tests.rig.records.reading import NEEDS, read, refusal


def test_forty_ways_of_writing_one_record(tmp_path: Path) -> None:
    """Whoever gives a file to `identify` as an instrument wrote it gets its numbers, or a line to type."""
    pytest.importorskip("openpyxl")
    found = {}
    for write in ways.WAYS:
        way = write(ways.truth_of(7))
        found[way.name] = ways.judged(way, tmp_path)
    assert {name: how for name, how in found.items() if how not in ("plain", "flag")} == {}
    assert len(found) == 40
    assert list(found.values()).count("plain") >= 34


HEAD = "time_s,temperature_degC,resistance_ohm\n"
ROWS = "0,25,1000\n1,26,900\n2,27,800\n"


@pytest.mark.parametrize(
    ("head", "unit", "factor"),
    [
        ("R (Ohm)", "ohm", 1.0),
        ("Resistance / MΩ", "Mohm", 1e6),
        ("Widerstand (mOhm)", "mohm", 1e-3),
        ("R (KOHM)", "kohm", 1e3),
        (r"$R$ ($\Omega$)", "ohm", 1.0),
    ],
)
def test_units_of_resistance(file: Path, head: str, unit: str, factor: float) -> None:
    rows = "".join(f"{k},{25 + k},{1e5 * (k + 1)!r}\n" for k in range(3))
    record = read(file, f"time_s,temperature_degC,{head}\n{rows}")
    np.testing.assert_allclose(record["resistance_ohm"], factor * 1e5 * np.array([1, 2, 3]), rtol=1e-15)
    assert any("resistance_ohm from" in line for line in record.notes)
    assert unit == "ohm" or any(f"in {unit}" in line for line in record.notes)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"time_s,temperature_degC,R\n{ROWS}", "--column resistance_ohm=R@kohm"),
        (f"time_s,temperature_degC,R (mohm)\n{ROWS}", "--column 'resistance_ohm=R (mohm)@Mohm'"),
        (f"time_s,temperature_degC,R (MOHM)\n{ROWS}", "milliohms or megohms"),
        (f"time_s,temperature_degC,Conductance (Ohm)\n{ROWS}", "--column 'resistance_ohm=Conductance (Ohm)@ohm'"),
        (f"time_s,temperature_degC,Resistance (mS)\n{ROWS}", "--column 'resistance_ohm=Resistance (mS)@ohm'"),
        (f"time_s,temperature_degC,G (S)\n{ROWS}", "--column 'resistance_ohm=G (S)@ohm'"),
        (f"time_s,temperature_degC,log R\n{ROWS}", "--column 'resistance_ohm=log R@lnohm'"),
        (f"time_s,temp,resistance_ohm\n{ROWS}", "--column temperature_degC=temp@K"),
        (f"time_s,T1_C,T2_C\n{ROWS}", "--column temperature_degC=T2_C@degC"),
        (f"t,temperature_degC,resistance_ohm\n{ROWS}", "--column time_s=t@ms"),
        (f"Time (s),Time (min),temperature_degC\n{ROWS}", "--column 'time_s=Time (min)@min'"),
        (f"time,temperature_degC\n{ROWS.replace(',1000', '').replace(',900', '').replace(',800', '')}", "=time@h"),
        (ROWS, "--column 'temperature_degC=#2@degC'"),
        ("time_s,temperature_degC\n1795269782250,20\n1795269782350,21\n", "--column time_s=time_s@ms"),
        ("time_s,temperature_degC\n46352.5400,20\n46352.5401,21\n", "a spreadsheet's dates"),
        ("Date (s),temperature_degC\n46352.5400,20\n46352.5401,21\n", "--column 'time_s=Date (s)@d'"),
        ("time,temperature_degC\n46352.5400,20\n46352.5401,21\n", "=time@d"),
        ("time_s,temperature_degC,R (Ohm)\n0,25,1e-5\n1,26,2e-5\n", "--column 'resistance_ohm=R (Ohm)@S'"),
        ("Time,T_C\n01:02,25\n01:03,26\n01:04,27\n", "--column time_s=Time@mm:ss"),
        ("Time,T_C\n03/04/2026,25\n05/04/2026,26\n06/05/2026,27\n", "--column time_s=Time@dmy"),
        ("Time (s),R1 (Ohm),R2 (Ohm),T (C)\n0,1,2,25\n1,3,4,26\n", "--column 'resistance_ohm=R2 (Ohm)@ohm'"),
    ],
)
def test_what_is_not_plain_is_refused_with_what_to_type(file: Path, text: str, expected: str) -> None:
    said = refusal(file, text)
    assert expected in said
    columns = [shlex.split(part)[0] for part in said.split("--column ")[1:] if part[:1] != "O"]
    assert columns
    for column in columns:  # what is printed is understood
        ColumnMapping.parse(column)


@pytest.mark.parametrize("name", ["temperature_degC", "Temperatur [degC]"])
def test_a_film_in_kelvins_is_no_film_in_degrees(file: Path, name: str) -> None:
    text = f"time_s,{name},resistance_ohm\n" + "".join(f"{k},{298 + k},{1e5 / (k + 1)!r}\n" for k in range(66))
    said = refusal(file, text)
    assert len(said.splitlines()) == 1
    assert f"temperature_degC={name}@K" in said
    assert read(file, text, f"temperature_degC={name}@K")["temperature_degC"][0] == pytest.approx(24.85)
    assert read(file, text, f"temperature_degC={name}@degC")["temperature_degC"][0] == 298.0  # it is believed


@pytest.mark.parametrize("word", ["#N/A", "#DIV/0!", "#WERT!", "n.d.", "--"])
def test_a_word_for_no_reading(file: Path, word: str) -> None:
    rows = "".join(f"{k},{25 + k},{1000 - k if k != 7 else word}\n" for k in range(20))
    record = read(file, f"time_s,temperature_degC,resistance_ohm\n{rows}")
    assert np.flatnonzero(np.isnan(record["resistance_ohm"])).tolist() == [7]


@pytest.mark.parametrize(
    "end", ["End of data\n", "Measurement finished,,\n", "Stopped by user\nat 14:03:11, in the night\n", "\nEnd\n\n"]
)
def test_words_behind_the_last_row(file: Path, end: str) -> None:
    rows = "".join(f"{k},{25 + k},{1000 - k}\n" for k in range(20))
    record = read(file, f"time_s,temperature_degC,resistance_ohm\n{rows}{end}")
    assert record.rows == 20
    assert any("words after the last row left out" in line for line in record.notes)


@pytest.mark.parametrize("name", ["ambient_degC", "sink_degC"])
def test_a_room_and_a_sink_in_kelvins(file: Path, name: str) -> None:
    def written(room: float) -> Path:
        file.write_text(f"time_s,temperature_degC,{name}\n" + "".join(f"{k},{22 + k},{room}\n" for k in range(9)))
        return file

    with pytest.raises(Faults, match=f"{name}: 295.1 to 295.1 degC .* in K it is: expected --column {name}={name}@K"):
        read_record(written(295.15))
    mapping = ColumnMapping.parse(f"{name}={name}@K")
    assert read_record(file, [mapping])[name] == pytest.approx(22.0)
    assert read_record(written(22.0))[name] == pytest.approx(22.0)


@pytest.mark.parametrize(
    ("fields", "seconds"),
    [
        (["23:59:59.5", "00:00:00.0", "00:00:00.5"], [0, 0.5, 1.0]),
        (["59:59.5", "00:00.0", "00:00.5"], [0, 0.5, 1.0]),
        (["11:59:59 PM", "12:00:00 AM", "12:00:01 AM"], [0, 1, 2]),
        (["03:02.5", "03:03.0", "03:04.5"], [0, 0.5, 2.0]),
        (["25:00:00", "25:00:01", "25:00:03"], [0, 1, 3]),
        (["2026-11-21T23:59:59+01:00", "2026-11-22T00:00:00+01:00", "2026-11-21T23:00:01Z"], [0, 1, 2]),
        (["31.12.2026 23:59:59", "01.01.2027 00:00:00", "01.01.2027 00:00:02"], [0, 1, 3]),
        (["12/31/2026 11:59 PM", "1/1/2027 12:00 AM", "1/1/2027 12:02 AM"], [0, 60, 180]),
        (["21-Nov-2026 14:03:02", "21-Nov-2026 14:03:03", "22-Nov-2026 14:03:03"], [0, 1, 86401]),
        (["03/04/2026 01:00:00", "03/04/2026 01:00:01", "03/04/2026 01:00:02"], [0, 1, 2]),
        (["03/04/2026 23:59:59", "04/04/2026 00:00:00", "04/04/2026 00:00:01"], [0, 1, 2]),
    ],
)
def test_times_of_clocks_and_dates(file: Path, fields: list[str], seconds: list[float]) -> None:
    rows = "".join(f"{field},{25 + k}\n" for k, field in enumerate(fields))
    record = read(file, f"Time,T_C\n{rows}")
    np.testing.assert_allclose(record["time_s"], seconds, atol=1e-9)
    assert "time_s from 'Time'" in record.notes[0]


@pytest.mark.parametrize(
    ("fields", "layout", "seconds"),
    [
        (["23:58", "23:59", "00:00", "00:01"], "@hh:mm", [0, 60, 120, 180]),
        (["11:59 PM", "12:00 AM", "12:01 AM"], "@hh:mm", [0, 60, 120]),
        (["59:58", "59:59", "00:00", "00:01"], "@mm:ss", [0, 1, 2, 3]),
        (["03/04/2026", "05/04/2026", "06/05/2026"], "@dmy", [0, 172800, 2851200]),
        (["03/04/2026", "05/04/2026", "06/05/2026"], "@mdy", [0, 5270400, 8035200]),
    ],
)
def test_layouts_that_were_typed(file: Path, fields: list[str], layout: str, seconds: list[float]) -> None:
    rows = "".join(f"{field},{25 + k}\n" for k, field in enumerate(fields))
    record = read(file, f"Time,T_C\n{rows}", f"time_s=Time{layout}")
    np.testing.assert_allclose(record["time_s"], seconds, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "resistance"),
    [
        ("t_s;T_C;R_ohm\n0,5;25;1.234\n1,0;26;12.345,6\n", [1234.0, 12345.6]),
        ('t_s,T_C,R_ohm\n0.5,25,"1,234"\n1.0,26,"12,345"\n', [1234.0, 12345.0]),
        ("t_s;T_C;R_ohm\n0,5;25,1;1234\n1,0;26,2;1 234 567,5\n", [1234.0, 1234567.5]),
        ("t_s;T_C;R_ohm\n0,5;25,1;123,456\n1,0;26,2;12,345\n", [123.456, 12.345]),
        ("t_s;T_C;R_ohm\n0.5;25.1;123.456\n1.0;26.2;12.345\n", [123.456, 12.345]),
        ("t_s\tT_C\tR_ohm\n0\t25\t1'234'567\n1\t26\t1'234\n", [1234567.0, 1234.0]),
    ],
)
def test_decimals_and_thousands(file: Path, text: str, resistance: list[float]) -> None:
    np.testing.assert_array_equal(read(file, text)["resistance_ohm"], resistance)


@pytest.mark.parametrize(
    "text",
    [
        "t_s;T_C;R_ohm\n0;25;123,456\n1;26;12,345\n",
        "t_s;T_C;R_ohm\n0;25;123.456\n1;26;12.345\n",
        "t_s;T_C;R_ohm\n0,5;25,5;123.456\n1,5;26,5;12.345\n",
        't_s,T_C,R_ohm\n0,25,"123,456"\n1,26,"12,345"\n',
    ],
)
def test_a_thousand_or_one_and_a_bit_is_asked_for(file: Path, text: str) -> None:
    assert "--decimal" in refusal(file, text)
    comma = "," in text.splitlines()[1].split(";")[-1]
    expected = {".": 123456.0, ",": 123.456} if comma else {".": 123.456, ",": 123456.0}
    if '"' in text:
        expected = {".": 123456.0, ",": 123.456}
    for decimal, value in expected.items():
        if decimal == "." and "0,5" in text:  # the other columns have decimal commas
            continue
        assert read(file, text, decimal=decimal)["resistance_ohm"][0] == value


def test_of_several_names_the_first_that_a_file_has(file: Path) -> None:
    columns = ("time_s=t|Zeit@ms", "temperature_degC=T_C|temp", "resistance_ohm=#3@kohm")
    for names in ("t,temp,x", "Zeit,T_C,x", "Zeit,temp,"):
        record = read(file, f"{names}\n0,25,1\n500,26,2\n", *columns)
        np.testing.assert_array_equal(record["time_s"], [0.0, 0.5])
        np.testing.assert_array_equal(record["temperature_degC"], [25.0, 26.0])
        np.testing.assert_array_equal(record["resistance_ohm"], [1000.0, 2000.0])
    assert "no column 't|Zeit'" in refusal(file, "a,temp,x\n0,25,1\n500,26,2\n", *columns)


def test_a_column_that_is_typed_twice_or_the_wrong_way_round(file: Path) -> None:
    """The last of two was taken without a word, in another unit."""
    text = "time_s,T\n0,25\n1,26\n"
    twice = refusal(file, text, "temperature_degC=T@degC", "temperature_degC=T@K")
    assert "--column temperature_degC was typed twice; expected once" in twice
    assert "expected --column temperature_degC=T" in refusal(file, text, "T=temperature_degC")


def test_a_typed_name_without_a_unit_has_that_of_the_file(file: Path) -> None:
    record = read(file, "a,T_K,c\n0,298,1\n1,363,2\n", "time_s=a", "temperature_degC=T_K")
    np.testing.assert_allclose(record["temperature_degC"], [24.85, 89.85])
    assert "as its name says" in record.notes[0]


def test_shares_of_full_drive(file: Path) -> None:
    text = "t_s,T_C,u\n0,25,-1\n1,26,0.5\n"
    assert read(file, text, "current_A=u@duty").drive == "duty"
    np.testing.assert_array_equal(
        read(file, text.replace("0.5", "255").replace("-1", "51"), "current_A=u@pwm255")["current_A"], [0.2, 1.0]
    )
    assert read(file, "t_s,T_C,duty\n0,25,-1\n1,26,0.5\n").drive == "duty"


def test_names_that_are_ours_are_taken_without_a_word(file: Path) -> None:
    columns = {"time_s": np.arange(3.0), "temperature_degC": np.array([25.0, 26.0, 27.0]), "R_heater": np.ones(3)}
    write_columns(file, columns)
    record = read_record(file)
    assert record.notes == ()
    assert set(record.columns) == set(columns)


@pytest.mark.parametrize("blank", [True, False])
def test_long_tables_read_to_the_same_bits(file: Path, blank: bool) -> None:
    random = np.random.default_rng(5)
    columns = {"time_s": np.cumsum(random.random(5000)), "temperature_degC": random.normal(60.0, 10.0, 5000)}
    columns["resistance_ohm"] = 10.0 ** random.normal(4.0, 1.0, 5000)
    if blank:
        columns["resistance_ohm"][4000:4010] = np.nan
        columns["resistance_ohm"][4500] = np.inf
    write_columns(file, columns)
    record = read_record(file)
    for name, values in columns.items():
        np.testing.assert_array_equal(record[name], values)


LONG = "9" * 5000
GARBAGE = bytes(np.random.default_rng(3).integers(1, 256, 20000, dtype=np.uint8))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (f"{HEAD}0,{'9' * 140000},5\n1,20,5\n", "line 2"),
        (f"{HEAD}0,20,5\n1,\0,5\n", "line 3: a NUL"),
        (f"{HEAD}0,20,5\n1,{LONG},5\n2,22,5\n", "line 3: temperature_degC: '9999"),
        (f"{HEAD}0,20,5\n1,1e308,5\n2,22,5\n", "line 3: temperature_degC: 1e+308"),
        (f"{HEAD}0,20,5\n1e308,20,5\n", "time_s"),
        (f"{HEAD}0,20,5\n1,21,1e308\n", "line 3: resistance_ohm: 1e+308"),
        (f'{HEAD}0,20,"5\n' + "1,20,5\n" * 40000, "field larger than field limit"),
        ("1," * 200000, "400000 characters"),
        ("a,b\n" + "1:" * 20 + "\n" * 3, "line 1: no row of numbers below it"),
        (GARBAGE, ""),
        (b"\xff\xfe\x00", "expected UTF-16"),
        (b"\xef\xbb\xbf", "file is empty"),
        (",".join("x" * 3000) + "\n" + ",".join("1" * 3000) + "\n", "3000 columns"),
        ("time_s,temperature_degC\n0,5,25,1\n1,5,25,2\n", "decimal comma in a comma-separated file"),
        (f"{HEAD}0,20,5\n1,x,5\n2,22,5\n", "line 3: temperature_degC: 'x': expected a number"),
        (f"{HEAD}0,x,5\n1,21,5\n2,22,5\n", "line 2: temperature_degC: 'x': expected a number"),
        ("time_s,temperature_degC,temperature_degC\n0,1,2\n1,2,3\n", "appears twice"),
    ],
)
def test_bad_files_get_a_line_each(peltier: Peltier, file: Path, content: str | bytes, expected: str) -> None:
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    status, out, err = peltier("identify", file)
    assert (status, out) == (2, "")
    assert expected in err
    assert len(err.splitlines()) <= 6
    assert all(line.startswith(str(file)) and len(line) < 700 for line in err.splitlines())


@pytest.mark.parametrize(("name", "expected"), [("a.xlsx", "cannot be read as .xlsx"), ("a.mat", "as .mat")])
def test_broken_workbooks(peltier: Peltier, tmp_path: Path, name: str, expected: str) -> None:
    pytest.importorskip("openpyxl")
    (tmp_path / name).write_bytes(b"PK\x03\x04 this is none" * 40)
    err = peltier.fails("identify", tmp_path / name)
    assert expected in err
    assert len(err.splitlines()) == 1


def said_of_itself(path: Path, dimension: str) -> None:
    """Rewrite a workbook so that its sheet says another size of itself, as some instruments' writers do."""
    with zipfile.ZipFile(path) as package:
        members = {name: package.read(name) for name in package.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        for name, text in members.items():
            if "sheet1" in name:
                text, changed = re.subn(rb'<dimension ref="[^"]*"', f'<dimension ref="{dimension}"'.encode(), text)
                assert changed == 1
            package.writestr(name, text)


@pytest.mark.parametrize("dimension", ["A1", "A1:B4", "A1:XFD1048576"])
def test_a_workbook_that_says_a_wrong_size_of_its_sheet_is_read_whole(tmp_path: Path, dimension: str) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [["time_s", "temperature_degC", "note"], *([k, 25.0 + k, None] for k in range(9)), [9, 34.0, "end"]]:
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    said_of_itself(tmp_path / "a.xlsx", dimension)
    record = read_record(tmp_path / "a.xlsx", [], NEEDS)
    assert list(record["temperature_degC"]) == [25.0 + k for k in range(10)]


def test_packed_files_too_large_are_refused(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    openpyxl.Workbook().save(tmp_path / "a.xlsx")
    scipy.io.savemat(tmp_path / "a.mat", {"time_s": np.zeros(2000)}, do_compression=True)
    monkeypatch.setattr("rig.records.file_formats.MOST_BYTES", 1000)
    monkeypatch.setattr("rig.records.file_formats.MOST_NUMBERS", 1000)
    for name, expected in (("a.xlsx", "unpacks to"), ("a.mat", "an array of 2000 numbers")):
        status, _, err = peltier("identify", tmp_path / name)
        assert (status, len(err.splitlines())) == (2, 1)
        assert expected in err


def test_a_matlab_file_on_which_its_reader_dies_is_refused(peltier: Peltier, tmp_path: Path) -> None:
    file = tmp_path / "a.mat"
    scipy.io.savemat(file, {"time_s": np.arange(3.0)})
    content = bytearray(file.read_bytes())
    content[content.index(np.arange(3.0).tobytes()) - 8] = 127  # the kind of its numbers: there is none of this code
    file.write_bytes(content)
    status, _, err = peltier("identify", file)
    assert (status, err) == (2, f"{file}: cannot be read as .mat: its sizes and kinds do not fit its bytes\n")


def test_openpyxl_missing_is_told(peltier: Peltier, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("openpyxl", "openpyxl.reader.excel"):  # the second one too, where another test has read a workbook
        monkeypatch.setitem(__import__("sys").modules, name, None)
    (tmp_path / "a.xlsx").write_bytes(b"PK")
    assert "pip install 'openpyxl>=3.1'" in peltier.fails("identify", tmp_path / "a.xlsx")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Time (s),T (C)\n0,25\n1,26\n0,27\n1,28\n", "line 4: time_s: 0.0 after 1.0: expected increasing times"),
        ("Time,T_C\n11:59:59,25\n12:00:00,26\n01:00:00,27\n", "expected increasing times"),
        ("Time,T_C\n14:00:00,25\n14:00:00,26\n14:00:01,27\n", "expected increasing times"),
        ("Time,T_C\n14:00:00,25\n14:00:01,26\n14:61:00,27\n", "'14:61:00'"),
        ("Time,T_C\n2026-11-21T23:59:59+01:00,25\n2026-11-22T00:00:00,26\n", "with a zone"),
        ("t_s,T_K,R_ohm\n300,0,5\n310,1,6\n305,2,7\n", "temperature_degC do in every row: are two columns swapped?"),
        (f"{HEAD}0,20,5\n1,21,6\npaused\n2,22,7\n", "line 4: 1 field, expected 3"),
        (f"{HEAD}0,1e5,25\n1,9e4,26\n2,8e4,27\n", "temperature_degC: to 100000 degC: are two columns swapped?"),
        ("Time (s),T (C)\n0,25\n1,26\n2,27\nMean,26\n", "line 5: time_s: 'Mean'"),
        ("Time (s),T (C),R\n0,25,1\n1,26,x\n2,27,2\n", "'R': its unit is not given"),
        ("Time (s),R1 (Ohm),R2 (Ohm),T (C)\n0,1,2,25\n1,3,4,26\n", "more than one column may be it"),
        ("Time [ms],T [K]\ns,degC\n0,25\n1,26\n", "two units, 'ms' and 's'"),
    ],
)
def test_what_is_wrong_is_what_is_told(file: Path, text: str, expected: str) -> None:
    assert expected in refusal(file, text)


@pytest.mark.parametrize(
    ("text", "name", "values", "note"),
    [
        ("t_s,T_C,R_shunt (Ohm)\n0,25,100\n1,26,100\n", "T_C", None, "'R_shunt (Ohm)' left"),
        (f"{HEAD}0,20,5\n1,21,6\n2,2", "temperature_degC", [20.0, 21.0], "line 4 left out, it was cut off"),
        ("t_s,T_C,I_A\n0,25,1e-6\n1,26,2e-6\n", "current_A", None, "'I_A' left"),  # no plate moves by so little
        ("t_s,T_C,pwm\n0,25,0\n1,26,200\n", "current_A", None, "--column current_A=pwm@pwm255"),
    ],
)
def test_what_is_left_out_is_told(file: Path, text: str, name: str, values: list[float] | None, note: str) -> None:
    record = read(file, text)
    assert note in record.notes[0]
    assert values is None if name not in record.columns else record[name].tolist() == values


def test_an_unplugged_thermometer_has_no_reading(file: Path) -> None:
    record = read(file, f"{HEAD}0,20,5\n1,-999,6\n2,22,7\n")
    np.testing.assert_array_equal(record["temperature_degC"], [20.0, np.nan, 22.0])
    told = "temperature_degC: row 2 (1 s) reads -999 degC: absolute zero (0 K) or below is no temperature; left out"
    assert record.left_out_lines() == [told]
    assert "expected -273.15 to" in refusal(file, f"{HEAD}0,-999,5\n1,-999,6\n2,22,7\n")


@pytest.mark.parametrize("beyond", ["inf", "-inf", "9.9E37"])
def test_a_temperature_beyond_the_range_is_told_as_no_reading(file: Path, beyond: str) -> None:
    record = read(file, f"{HEAD}0,20,5\n1,{beyond},6\n2,22,7\n")
    np.testing.assert_array_equal(record["temperature_degC"], [20.0, np.nan, 22.0])
    assert "in temperature_degC values beyond the range read as no reading (1 rows)" in record.notes[0]


def test_records_from_arrays_and_frames() -> None:
    kelvin, kilohm = np.array([298.0, 320.0, 363.0]), [100.0, 50.0, 0.2]
    record = record_from_arrays({"t / min": [0, 1, 2], "T [K]": kelvin, "R": kilohm}, ["resistance_ohm=R@kohm"])
    np.testing.assert_array_equal(record["time_s"], [0.0, 60.0, 120.0])
    np.testing.assert_allclose(record["temperature_degC"], [24.85, 46.85, 89.85])
    np.testing.assert_array_equal(record["resistance_ohm"], [1e5, 5e4, 200.0])
    with pytest.raises(Faults, match="@kohm"):
        record_from_arrays({"time_s": [0, 1, 2], "temperature_degC": [25, 26, 27], "R": kilohm})
    with pytest.raises(Faults, match="unequal length"):
        record_from_arrays({"time_s": [0, 1], "temperature_degC": [25, 26, 27]})
    pandas = pytest.importorskip("pandas")
    for name in ("when", None):  # an index of dates is a column without a name, too
        index = pandas.date_range("2026-11-21 23:59:59.5", periods=3, freq="500ms", name=name)
        frame = pandas.DataFrame(
            {"T_C": [25.0, 26.0, 27.0], "R_kohm": [3, 2, 1], "note": ["a", None, "b"]}, index=index
        )
        record = record_from_arrays(frame_columns(frame))
        np.testing.assert_array_equal(record["time_s"], [0.0, 0.5, 1.0])
        np.testing.assert_array_equal(record["resistance_ohm"], [3000.0, 2000.0, 1000.0])
        assert record.text_columns["note"] == ["a", "", "b"]


# files of measured records, with --column for names at most: our columns
MEASURED = {
    "vo2_film_major_loop.tsv": ((), {"time_s", "temperature_degC", "resistance_ohm"}),
    "vo2_film_small_gap_raw.tsv": ((), {"time_s", "temperature_degC", "resistance_ohm"}),
    "peltier_8010.csv": ((), {"time_s", "temperature_degC", "current_A"}),
    "peltier_8020.csv": ((), {"time_s", "temperature_degC", "current_A"}),
    "peltier_8055.csv": ((), {"time_s", "temperature_degC", "current_A"}),
    "peltier_500.csv": ((), {"time_s", "temperature_degC", "current_A"}),
    "peltier_runaway.csv": ((), {"time_s", "temperature_degC", "current_A"}),
    "peltier_8051.csv": (("time_s=time", "temperature_degC=temp", "current_A=output@duty"), {"current_A"}),
    "peltier_8052.csv": (("time_s=time", "temperature_degC=temp", "current_A=output@duty"), {"current_A"}),
    "peltier_80510.csv": (("time_s=time", "temperature_degC=temp", "current_A=output@duty"), {"current_A"}),
    "heater_random_steps.csv": (("temperature_degC=T1_C",), {"time_s", "temperature_degC", "current_A"}),
    "heater_two_channels.txt": (("temperature_degC=Temperature 1 (degC)",), {"time_s", "temperature_degC"}),
    "heater_two_channels_later.txt": (("temperature_degC=Temperature 1",), {"time_s", "temperature_degC"}),
    "lamp_heating.csv": (("temperature_degC=y_C",), {"time_s", "temperature_degC"}),
    "heater_step.csv": ((), {"time_s", "temperature_degC"}),
    **{f"tclab_{part}.csv": ((), {"time_s", "temperature_degC"}) for part in ("train", "valid")},
    **{f"tec_{run}.csv": (("current_A=out@pwm255",), {"current_A"}) for run in ("run12", "run2_1s")},
    **{f"tune{n}.csv": (("temperature_degC=oven_c@degC",), {"temperature_degC"}) for n in (22, 23, 24, 25)},
}


@pytest.mark.parametrize("name", MEASURED)
def test_measured_records_are_read_as_they_are(measured: Path, name: str) -> None:
    columns, ours = MEASURED[name]
    record = read_record(measured / name, [ColumnMapping.parse(column) for column in columns], NEEDS)
    assert ours <= set(record.columns)
    lines = [line for line in (measured / name).read_text().splitlines() if line and line[0] in "-0123456789"]
    assert record.rows == len(lines)
    assert record.left_out == ()  # real thermometers, with steps of 0.25 and 0.49 K and unsteady sampling, do not lie
    temperature = record["temperature_degC"]
    assert 15.0 < np.min(temperature) < 135.0  # degC, whatever the file had: the lamp's begins at 129 degC
    assert np.max(temperature) < 300.0
    if record.has_output():
        assert np.min(record["resistance_ohm"]) > 10.0
        assert np.max(record["resistance_ohm"]) < 1e7
        assert record["temperature_degC"][0] == pytest.approx(96.66, abs=0.01)  # 369.81 K
    if record.has("current_A"):
        assert record.drive in ("duty", "pwm255")
        assert np.max(np.abs(record["current_A"])) <= 1.01
