"""Workbooks as labs keep them, and what loggers compress: read as they are, or refused with what to do."""

from __future__ import annotations

import bz2
import datetime
import gzip
import lzma
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from rig.core.faults import Faults
from rig.records import file_formats as matlab_table
from rig.records.file_formats import MOST_NUMBERS, _load, _vectors
from rig.records.record_file import read_record

HEAD = ["time_s", "temperature_degC", "current_A"]
ROWS = [[0.5 * k, 25.0 + 0.1 * k, 0.8] for k in range(30)]
TEXT = "\n".join(",".join(map(str, row)) for row in [HEAD, *ROWS]) + "\n"


def workbook(path: Path, *sheets: tuple[str, list[list[Any]]], merged: Sequence[str] = ()) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
        for cells in merged:
            sheet.merge_cells(cells)
    book.save(path)
    return path


def is_read(path: Path) -> tuple[str, ...]:
    """What is said of the record, whose numbers have to be those above."""
    record = read_record(path, [], HEAD)
    assert list(record["time_s"]) == [row[0] for row in ROWS]
    assert list(record["temperature_degC"]) == [row[1] for row in ROWS]
    return tuple(record.notes)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, lzma.compress])
def test_what_a_logger_compressed_is_read(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "a.csv"  # it is the first bytes that tell
    path.write_bytes(pack(TEXT.encode()))
    assert any("unpacked" in text for text in is_read(path))
    path.write_bytes(pack(TEXT.encode())[:-20])
    with pytest.raises(Faults, match="cut off; expected the whole file"):
        read_record(path)


def test_what_is_damaged_or_far_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.csv.gz"
    packed = bytearray(gzip.compress(TEXT.encode()))
    packed[-8] ^= 1  # of the sum over all bytes
    for content in (
        bytes(packed),
        b"\x1f\x8b\x08\0" + bytes(range(1, 60)),
        b"\xfd7zXZ\0" + bytes(60),
        b"BZh9" + bytes(60),
    ):
        path.write_bytes(content)
        with pytest.raises(Faults, match=f"^{path}: compressed .*, and damaged"):
            read_record(path)
    monkeypatch.setattr("rig.records.record_file.MOST_BYTES", 100)
    path.write_bytes(gzip.compress(TEXT.encode()))
    with pytest.raises(Faults, match="unpacks to more than"):
        read_record(path)


def test_text_under_the_name_of_a_workbook_is_read_and_told(tmp_path: Path) -> None:
    path = tmp_path / "a.xlsx"
    path.write_text(TEXT)
    assert any("no workbook as its name" in text for text in is_read(path))
    path.write_bytes(b"\xd0\xcf\x11\xe0" + bytes(600))  # what a workbook with a password is
    with pytest.raises(Faults, match="password"):
        read_record(path)


def test_a_short_table_beside_the_record_is_a_summary(tmp_path: Path) -> None:
    summary = ("Summary", [["mean T", "max T"], [25.7, 26.5]])
    about = ("About", [["Sample", "VO2 #7"], ["Date", datetime.date(2026, 5, 3)]])
    path = workbook(tmp_path / "a.xlsx", about, ("Data", [HEAD, *ROWS]), summary)
    assert any("sheet 'Data'" in text for text in is_read(path))
    again = ("Again", [HEAD, *ROWS])
    with pytest.raises(Faults, match=r"tables in 2 sheets \(Data, Again\)"):
        read_record(workbook(tmp_path / "a.xlsx", ("Data", [HEAD, *ROWS]), again))


def test_formulas_without_their_values_are_no_empty_column(tmp_path: Path) -> None:
    """Of a resistance that is one, the record would be a plate's without a word. Where a sheet is, the package's
    relations say: most programs write xl/worksheets/sheet1.xml, and none has to."""
    rows = [[*row, f"=1000*C{k}"] for k, row in enumerate(ROWS, 2)]
    path, moved = workbook(tmp_path / "a.xlsx", ("Data", [[*HEAD, "resistance_ohm"], *rows])), tmp_path / "b.xlsx"
    with zipfile.ZipFile(path) as package, zipfile.ZipFile(moved, "w") as elsewhere:
        for name in package.namelist():
            content = package.read(name).replace(b"/xl/worksheets/sheet1.xml", b"/data/one.part")
            elsewhere.writestr("data/one.part" if name == "xl/worksheets/sheet1.xml" else name, content)
    for book in (path, moved):
        with pytest.raises(Faults, match=r"sheet 'Data': D2, and 29 more: expected the values of formulas"):
            read_record(book)


def test_what_is_merged_over_rows_is_in_each_of_them(tmp_path: Path) -> None:
    """The first row alone had it, and a plateau of 15 rows was one reading."""
    rows = [[*row, 40.0 + k if k % 15 == 0 else None] for k, row in enumerate(ROWS)]
    words = ["end", None, None, None]
    table = ("Data", [[*HEAD, "setpoint_degC"], *rows, words])
    path = workbook(tmp_path / "a.xlsx", table, merged=["D2:D16", "D17:D31", "A32:D32", "F3:F9"])
    said = "; ".join(is_read(path))
    assert "merged cells taken as the same in each of their rows: D2:D16 and 1 more" in said
    assert "words after the last row left out: 'end'" in said
    assert list(read_record(path)["setpoint_degC"]) == [40.0] * 15 + [55.0] * 15


def test_a_name_over_several_columns_is_the_name_of_each(tmp_path: Path) -> None:
    units = ["s", "degC", "A"]
    is_read(workbook(tmp_path / "a.xlsx", ("Data", [["Time", "Plate", None], units, *ROWS]), merged=["B1:C1"]))
    groups = [["time_s", "Plate", None], [None, *HEAD[1:]]]
    is_read(workbook(tmp_path / "a.xlsx", ("Data", [*groups, *ROWS]), merged=["A1:A2", "B1:C1"]))
    two = [["time", "temperature", None], ["s", "degC", "degC"], *ROWS]
    path = workbook(tmp_path / "a.xlsx", ("Data", two), merged=["B1:C1"])
    with pytest.raises(Faults, match="temperature_degC=temperature@degC or --column 'temperature_degC=#3@degC'"):
        read_record(path, [], HEAD[:2])


def structs(path: Path, **more: Any) -> Path:
    """The record as an array of structs, one for each row, as data(k).time_s = ... makes it."""
    data = np.empty((1, len(ROWS)), dtype=[(name, object) for name in [*HEAD, "note"]])
    data[0] = [(*row, "warm") for row in ROWS]
    for name, value in more.items():
        data[name][0, 3] = value
    scipy.io.savemat(path, {"data": data, "range": np.arange(1.0, 4.0)})
    return path


def test_an_array_of_structs_is_a_table(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    assert is_read(structs(path)) == ("left out, of another length: range",)
    assert np.isnan(read_record(structs(path, current_A=[]))["current_A"][3])
    for value, told in (("off", "'off'"), ([1.0, 2.0], "'2 values'")):
        with pytest.raises(Faults, match=f"row 3: current_A: {told}: expected a number"):
            read_record(structs(path, current_A=value))


CLOCK = [f"03-May-2026 12:00:{0.5 * k:04.1f}" for k in range(len(ROWS))]  # as datestr writes it


def cells(values: Sequence[Any]) -> Any:
    """A cell array, a column of it."""
    array = np.empty((len(values), 1), dtype=object)
    array[:, 0] = values
    return array


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """A .mat file is read in this process: one of its own takes a second to begin, and others test that."""
    monkeypatch.setattr(matlab_table, "read_vectors", lambda path: (list(_vectors(_load(path, MOST_NUMBERS))), []))


@pytest.mark.usefixtures("read_here")
@pytest.mark.parametrize("way", ["cells", "characters", "structs"])
def test_text_in_cells_and_dates_in_text_are_columns(way: str, tmp_path: Path) -> None:
    """Also of numbers that a program kept as text; what is of another length decides nothing."""
    _, temperature, current = np.array(ROWS).T
    if way == "structs":
        data = np.empty((1, len(ROWS)), dtype=[(name, object) for name in ("time", *HEAD[1:], "phase")])
        data[0] = [(when, *row[1:], "up") for when, row in zip(CLOCK, ROWS, strict=True)]
    else:
        time = np.array(CLOCK) if way == "characters" else cells(CLOCK)
        texts = cells([str(value) for value in current])
        data = {"time": time, HEAD[1]: temperature, HEAD[2]: texts, "phase": cells(["up"] * len(ROWS))}
    channels = {f"names{k}": cells(["Pt100", "film", "sink"]) for k in range(9)}
    scipy.io.savemat(tmp_path / "a.mat", {"data": data, **channels})
    is_read(tmp_path / "a.mat")
    record = read_record(tmp_path / "a.mat")
    assert list(record["current_A"]) == [row[2] for row in ROWS]
    assert list(record.text_columns["phase"]) == ["up"] * len(ROWS)


@pytest.mark.usefixtures("read_here")
def test_cells_that_are_no_numbers_are_told_with_their_name(tmp_path: Path) -> None:
    columns = dict(zip(HEAD, np.array(ROWS).T, strict=True))
    scipy.io.savemat(tmp_path / "a.mat", {"data": {**columns, "current_A": cells(["weak"] * len(ROWS))}})
    with pytest.raises(Faults, match="row 0: current_A: 'weak': expected a number"):
        read_record(tmp_path / "a.mat")


def test_settings_in_an_array_of_structs_are_no_record(tmp_path: Path) -> None:
    """There are more of them than columns, and none has a column's name."""
    settings = np.array([[(0.0, 1.0, 2.0, 3.0, 4.0)] * 3], dtype=[(name, object) for name in "abcde"])
    columns = dict(zip(HEAD, np.array(ROWS).T, strict=True))
    scipy.io.savemat(tmp_path / "a.mat", {"channels": settings, **columns})
    is_read(tmp_path / "a.mat")


def test_a_date_and_a_clock_in_columns_of_their_own(tmp_path: Path) -> None:
    begin = datetime.datetime(2026, 5, 3, 23, 59, 55)
    times = [begin + datetime.timedelta(seconds=row[0]) for row in ROWS]
    rows = [[time.date(), time.time(), *row[1:]] for time, row in zip(times, ROWS, strict=True)]
    is_read(workbook(tmp_path / "a.xlsx", ("Data", [["Date", "Time", *HEAD[1:]], *rows])))


def test_a_folder_says_where_its_record_is(tmp_path: Path) -> None:
    with pytest.raises(Faults, match=r"is a folder; expected a file$"):
        read_record(tmp_path)
    (tmp_path / "record.csv").write_text(TEXT)
    with pytest.raises(Faults, match=rf"is a folder; expected a file, as {tmp_path / 'record.csv'}"):
        read_record(tmp_path)
