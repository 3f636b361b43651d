"""Workbooks as labs keep them, and what loggers compress: read as they are, or refused with what to do."""

from __future__ import annotations

import bz2
import datetime
import gzip
import lzma
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.core.faults import Faults
from rig.files.record_file import read_record

HEAD = ["time_s", "temperature_degC", "current_A"]
ROWS = [[0.5 * k, 25.0 + 0.1 * k, 0.8] for k in range(30)]
TEXT = "\n".join(",".join(map(str, row)) for row in [HEAD, *ROWS]) + "\n"


def workbook(path: Path, *sheets: tuple[str, list[list[Any]]]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets:
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def is_read(path: Path) -> tuple[str, ...]:
    """What is said of the record, whose numbers have to be those above."""
    record = read_record(path, [], HEAD)
    assert list(record["time_s"]) == [row[0] for row in ROWS]
    assert list(record["temperature_degC"]) == [row[1] for row in ROWS]
    return tuple(record.said)


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
    monkeypatch.setattr("rig.files.unpacked.MOST_BYTES", 100)
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
    """Of a resistance that is one, the record would be a plate's without a word."""
    rows = [[*row, f"=1000*C{k}"] for k, row in enumerate(ROWS, 2)]
    path = workbook(tmp_path / "a.xlsx", ("Data", [[*HEAD, "resistance_ohm"], *rows]))
    with pytest.raises(Faults, match=r"sheet 'Data': D2, and 29 more: expected the values of formulas"):
        read_record(path)


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
