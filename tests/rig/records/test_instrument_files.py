"""Files as LabVIEW, bench meters, databases and MATLAB write them, made here by their own descriptions."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from rig.records.record import Record
from rig.records.record_file import RowOrder, read_record
from tests.rig.records.reading import read, refusal

END = "***End_of_Header***"
COUNT = 30
DEGC, OHM = 25.0 + np.arange(COUNT), 1e5 / (1.0 + np.arange(COUNT))


def assert_read(record: Record, step_s: float = 2.0) -> None:
    np.testing.assert_allclose(record["temperature_degC"], DEGC, atol=1e-5)
    np.testing.assert_allclose(record["resistance_ohm"], OHM, rtol=1e-5)
    np.testing.assert_allclose(record["time_s"] - record["time_s"][0], step_s * np.arange(COUNT), atol=1e-6)


def header(columns: str, **tags: str) -> str:
    lines = {
        "LabVIEW Measurement": "", "Writer_Version": "2", "Reader_Version": "2", "Separator": "Tab",
        "Decimal_Separator": ".", "Multi_Headings": "Yes", "X_Columns": columns, "Time_Pref": "Absolute", **tags,
    }  # fmt: skip
    return "".join(f"{tag}\t{text}\n" for tag, text in lines.items()) + f"{END}\t\n\t\n"


def segment(
    rows: list[str], clock: str = "15:37:48.375", step: str = "2.000000", x0: str = "0.0", units: str = ""
) -> str:
    tags = {
        "Notes": ["X values guaranteed valid only for TC", ""], "Channels": ["2", ""], "Samples": [str(len(rows))] * 2,
        "Date": ["2016/08/11"] * 2, "Time": [clock] * 2, "Y_Unit_Label": (units or "Deg C,Ohms").split(","),
        "X_Dimension": ["Time"] * 2, "X0": [x0] * 2, "Delta_X": step.split(",") if "," in step else [step] * 2,
    }  # fmt: skip
    lines = ["\t".join([tag, *texts, ""]) for tag, texts in tags.items()]
    return "\n".join([*lines, f"{END}\t\t\t", "X_Value\tTC plate\tR film\tComment", *rows]) + "\n"


def rows(first: int = 0, last: int = COUNT, begin: int = 0, x: bool = True) -> list[str]:
    return [f"{2.0 * (k - begin) if x else ''}\t{DEGC[k]:.6f}\t{OHM[k]:.6f}" for k in range(first, last)]


@pytest.mark.parametrize(
    "text",
    [
        header("One") + segment(rows()),
        header("One") + segment([row + "\tOK" * (k % 7 == 0) for k, row in enumerate(rows())]),
        header("No") + segment(rows(x=False)),
        header("One") + segment(rows(0, 15)) + "\n" + segment(rows(15, COUNT, 15), clock="15:38:18.375"),
        header("One") + segment(rows(0, 15)) + "\n" + segment(rows(15)),
        header("No") + segment(rows(0, 15, x=False)) + "\n" + segment(rows(15, x=False), x0="30.0"),
        header("One", Multi_Headings="No") + segment(["\n".join([row, ""]) for row in rows()]),
        header("One") + "***Start_Special***\nScan 1\t2\t3\n***End_Special***\n" + segment(rows()),
    ],
    ids=["comment", "some_comments", "no_times", "begin_again", "go_on", "x0", "packets", "special_block"],
)
def test_labview_files(tmp_path: Path, text: str) -> None:
    """Four of the six public examples were refused: a name without a field, times in the header, further segments."""
    assert_read(read(tmp_path / "a.lvm", text))


def test_labview_times_before_each_channel(tmp_path: Path) -> None:
    lines = [f"{2.0 * k}\t{DEGC[k]:.6f}\t{2.0 * k + 0.05:.6f}\t{OHM[k]:.6f}" for k in range(COUNT)]
    text = segment(lines, units="Deg C,,Ohms").replace("X_Value\tTC plate\tR", "X_Value\tTC plate\tX_Value\tR")
    record = read(tmp_path / "a.lvm", header("Multi") + text)
    assert_read(record)
    np.testing.assert_allclose(record["resistance_time_s"] - record["time_s"], 0.05, atol=1e-9)


def test_labview_files_that_cannot_be_placed_in_time(tmp_path: Path) -> None:
    again = header("One") + segment(rows(0, 15)) + "\n" + segment(rows(15, COUNT, 15))
    assert "segment 2 begins at 0 s, and the one before ends at 28 s" in refusal(tmp_path / "a.lvm", again)
    uneven = header("No") + segment(rows(x=False), step="2.0,1.0")
    assert "Delta_X: 1 s and 2 s, and no times in the rows" in refusal(tmp_path / "a.lvm", uneven)


SETTINGS = (
    "Model,DAQ6510\nSerial,04412345\nBuffer,defbuffer1\nCapacity,100000\nCount,60\nBase Time,03/04/2026 23:55:00\n\n"
)


def test_a_meters_buffer_with_words_in_its_rows(tmp_path: Path) -> None:
    """Its settings were taken for the names: twenty-one lines "19 fields, expected 2"."""
    head = "Index,Reading,Unit,Digits,Math,Start Group,Limit1 High,Limit2 High,Terminal,Origin,Channel,CH Label,"
    head += "Relative Time,T (C)"
    lines = [f"{k},{OHM[k]:.7E},Ohm,6,F,F,F,F,Rear,Main,102,R film,{2.0 * k:.6f},{DEGC[k]}" for k in range(COUNT)]
    assert_read(read(tmp_path / "a.csv", f"{SETTINGS}{head}\n" + "\n".join(lines) + "\n"))


@pytest.mark.parametrize("unit", ["Celsius", "Degree C", "°C"])
def test_a_meters_buffer_with_a_row_for_each_channel(tmp_path: Path, unit: str) -> None:
    lines = [
        f"{2 * k},{DEGC[k]:.6E},{unit},6,101,{2.0 * k:.6f}\n{2 * k + 1},{OHM[k]:.6E},Ohm,6,102,{2.0 * k + 0.4:.6f}"
        for k in range(COUNT)
    ]
    head = "Index,Reading,Unit,Digits,Channel,Relative Time"
    record = read(tmp_path / "a.csv", f"{SETTINGS}{head}\n" + "\n".join(lines) + "\n")
    assert_read(record)
    np.testing.assert_allclose(record["resistance_time_s"] - record["time_s"], 0.4, atol=1e-9)


def test_a_databases_rows(tmp_path: Path) -> None:
    stamps = [f"2026-11-21T14:03:{2 * k % 60:02d}Z" for k in range(COUNT)]
    lines = [f"{t},{x},T (degC)" for t, x in zip(stamps, DEGC, strict=True)]
    lines += [f"{t},{x!r},R (ohm)" for t, x in zip(stamps, OHM.tolist(), strict=True)]
    assert_read(read(tmp_path / "a.csv", "_time,_value,_field\n" + "\n".join(lines) + "\n"))


def stacked(stamps: list[str], degC: np.ndarray, ohm: np.ndarray) -> str:
    lines = [f"{t},{x!r},T (degC)" for t, x in zip(stamps, degC.tolist(), strict=True)]
    lines += [f"{t},{x!r},R (ohm)" for t, x in zip(stamps, ohm.tolist(), strict=True)]
    return "_time,_value,_field\n" + "\n".join(lines) + "\n"


def test_two_readings_in_a_second_that_is_not_parted(tmp_path: Path) -> None:
    """Of each two rows of a channel with the same stamp the first was overwritten by the second."""
    stamps = [f"2026-11-21T14:03:{k // 2:02d}Z" for k in range(COUNT)]
    said = refusal(tmp_path / "a.csv", stacked(stamps, DEGC[::-1], OHM))
    assert "the same as in the row before (15 such rows" in said
    assert "--period SECONDS if they are evenly spaced" in said
    (tmp_path / "a.csv").write_text(stacked(stamps, DEGC, OHM))
    record = read_record(tmp_path / "a.csv", needs=("temperature_degC",), order=RowOrder(period_s=0.5))
    assert_read(record, 0.5)
    assert "'_time' left" in " ".join(record.notes)


def test_a_databases_rows_with_the_begin_and_end_of_the_query(tmp_path: Path) -> None:
    """`_start` and `_stop` are the same in each row, and were taken for the times: the file was refused."""
    lines = stacked([f"2026-11-21T14:03:{2 * k % 60:02d}Z" for k in range(COUNT)], DEGC, OHM).splitlines()
    query = "2026-11-21T14:00:00Z,2026-11-21T15:00:00Z"
    lines = [f"_start,_stop,{lines[0]}", *(f"{query},{line}" for line in lines[1:])]
    assert_read(read(tmp_path / "a.csv", "\n".join(lines) + "\n"))


@pytest.mark.parametrize("missing", [10, 11, 0])
@pytest.mark.parametrize("dates", [True, False])
def test_one_reading_is_missing_of_a_meters_buffer(tmp_path: Path, missing: int, dates: bool) -> None:
    """From there on each temperature stood beside the resistance of the scan before; of dates the resistance's own
    time was forgotten."""
    lines = []
    for k in range(COUNT):
        for value, unit, channel, late in ((DEGC[k], "Celsius", 101, 0.0), (OHM[k], "Ohm", 102, 0.4)):
            seconds = 2.0 * k + late
            when = f"2026-11-21 14:{3 + int(seconds) // 60:02d}:{seconds % 60.0:04.1f}" if dates else f"{seconds:.1f}"
            lines.append(f"{len(lines)},{value:.7E},{unit},{channel},{when}")
    del lines[missing]
    text = f"Index,Reading,Unit,Channel,{'Time' if dates else 'Relative Time'}\n" + "\n".join(lines) + "\n"
    record = read(tmp_path / "a.csv", text)
    degC, ohm = (record[name] for name in ("temperature_degC", "resistance_ohm"))
    both = np.isfinite(degC) & np.isfinite(ohm)
    assert (record.rows, np.sum(both)) == (COUNT, COUNT - 1)
    np.testing.assert_allclose(ohm[both], 1e5 / (1.0 + degC[both] - 25.0), rtol=1e-5)
    np.testing.assert_allclose((record["resistance_time_s"] - record["time_s"])[both], 0.4, atol=1e-6)


def test_a_column_called_value_in_a_table_of_moments_stays_one(tmp_path: Path) -> None:
    """A label that changes from row to row names no channel where temperature and resistance are columns."""
    lines = [f"{k},{25 + k},{100 - k},{k % 4},{'AB'[k % 2]}" for k in range(COUNT)]
    head = "time_s,temperature_degC,resistance_ohm,value,label"
    assert read(tmp_path / "a.csv", f"{head}\n" + "\n".join(lines) + "\n").rows == COUNT


def element(kind: int, data: bytes) -> bytes:
    """A data element of MATLAB's file format, level 5."""
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def vector(name: bytes, values: list[float]) -> bytes:
    shape = element(5, struct.pack("<ii", len(values), 1))
    data = element(9, struct.pack(f"<{len(values)}d", *values))
    return element(14, element(6, struct.pack("<II", 6, 0)) + shape + element(1, name) + data)


def matlab_object(name: bytes, kind: bytes) -> bytes:
    """As MATLAB saves a table or a date: a class of which scipy reads the name alone."""
    words = element(1, name) + element(1, b"MCOS") + element(1, kind)
    return element(14, element(6, struct.pack("<II", 17, 0)) + words + vector(b"", [1.0, 2.0]))


HEADER = b"MATLAB 5.0 MAT-file, made for a test".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            matlab_object(b"data", b"table"),
            "data: a MATLAB table, which only MATLAB reads; expected, typed there: writetable(",
        ),
        (matlab_object(b"data", b"timetable"), "writetimetable(data, 'film.csv')"),
        (
            matlab_object(b"t", b"datetime") + vector(b"T_K", [300.0, 301.0]),
            "time_s = seconds(t - t(1)); save('film.mat', 'time_s', '-append')",
        ),
        (matlab_object(b"t", b"datetime") + matlab_object(b"data", b"table"), "data: a MATLAB table"),
    ],
)
def test_what_only_matlab_reads_is_told_with_what_to_type_there(tmp_path: Path, content: bytes, expected: str) -> None:
    """ "no vectors of numbers", or a TypeError, was all that was said."""
    assert expected in refusal(tmp_path / "film.mat", HEADER + content)


def test_vectors_beside_an_object_are_read(tmp_path: Path) -> None:
    content = (
        vector(b"time_s", [0.0, 1.0, 2.0]) + vector(b"T_K", [300.0, 301.0, 302.0]) + matlab_object(b"t", b"datetime")
    )
    path = tmp_path / "film.mat"
    path.write_bytes(HEADER + content)
    record = read_record(path)
    np.testing.assert_allclose(record["temperature_degC"], [26.85, 27.85, 28.85])
    assert "MATLAB objects left out: t" in record.notes[0]
