"""Twenty more ways of writing one record, from public reports and files: without times, branches side by side, LabVIEW
files of five kinds, buffers of meters, clocks that were set, times in parts.

LabVIEW: National Instruments' specification of .lvm and the example files of lvm_read. Meters: what a buffer of
Keithley's 2450 and DAQ6510 is exported as. Each is written here from the truth of `_files_truth`, by rules of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta

import numpy as np
from _files_truth import Truth, Way, truth_of, written
from _files_ways import CELSIUS, KELVIN, OHM, Expected, columns_of, comma, encoded, lines_of, stamps, times

END = "***End_of_Header***"


def without_times(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (KELVIN, OHM))
    lines = ["Temperature (K)\tResistance (Ohm)", *lines_of(fields, "\t")]
    return Way("a published table: no times", "loop.txt", encoded(lines), expected)


def _branches(truth: Truth, columns: Sequence[tuple[str, str, str]], cut: int) -> tuple[list[list[str]], Expected]:
    """Fields of heating and, from its cold end on, of cooling, and what a reader must find one after the other."""
    fields, expected = columns_of(truth, columns)
    parts = [texts[:cut] for texts in fields] + [texts[cut:][::-1] for texts in fields]
    longest = max(map(len, parts))
    return [[*part, *[""] * (longest - len(part))] for part in parts], expected


def side_by_side(truth: Truth) -> Way:
    fields, expected = _branches(truth, (CELSIUS, OHM), 120)
    lines = ["T_heating (C),R_heating (ohm),T_cooling (C),R_cooling (ohm)", *lines_of(fields, ",")]
    return Way("branches side by side", "film.csv", encoded(lines), expected)


def up_and_down(truth: Truth) -> Way:
    fields, expected = _branches(truth, (KELVIN, ("resistance_ohm", "kohm", ".5f")), 126)
    name, head = "branches of unequal length", ["Temp up\tRes up\tTemp down\tRes down", "K\tkOhm\tK\tkOhm"]
    return Way(name, "Graph1.dat", encoded([*head, *lines_of(fields, "\t")]), expected)


def _lvm(columns: str, headings: str = "No", decimal: str = ".", separator: str = "\t") -> list[str]:
    tags = {
        "LabVIEW Measurement": "", "Writer_Version": "2", "Reader_Version": "2",
        "Separator": "Tab" if separator == "\t" else "Comma", "Decimal_Separator": decimal, "Multi_Headings": headings,
        "X_Columns": columns, "Time_Pref": "Relative", "Operator": "lab", "Date": "2026/11/21",
        "Time": f"14:03:02{decimal}5", END: "",
    }  # fmt: skip
    return [*(f"{tag}{separator}{text}" for tag, text in tags.items()), separator]


def _segment(fields: dict[str, Sequence[str]], names: str, separator: str = "\t") -> list[str]:
    return [*(separator.join([tag, *texts, ""]) for tag, texts in fields.items()), END + 3 * separator, names]


def _tags(count: int, clock: str = "14:03:02.5", step: str = "0.500000") -> dict[str, Sequence[str]]:
    return {
        "Channels": ["2", ""], "Samples": [str(count)] * 2, "Date": ["2026/11/21"] * 2, "Time": [clock] * 2,
        "Y_Unit_Label": ["degC", "Ohm"], "X_Dimension": ["Time"] * 2, "X0": ["0.0000000000000000E+0"] * 2,
        "Delta_X": [step] * 2,
    }  # fmt: skip


LVM = (("time_s", "as ours", ".6f"), CELSIUS, OHM)
NAMES = "X_Value\tTemperature\tResistance\tComment"


def lvm_comment(truth: Truth) -> Way:
    fields, expected = columns_of(truth, LVM)
    lines = [*_lvm("One"), *_segment(_tags(240), NAMES), *lines_of(fields, "\t")]
    return Way("LabVIEW .lvm: Comment is named, no field", "test_002.lvm", encoded(lines, end="\r\n"), expected)


def lvm_multi(truth: Truth) -> Way:
    fields, expected = columns_of(truth, LVM)
    later = [f"{float(t) + 0.05:.6f}" for t in truth.time_s]
    tags = {tag: [texts[0], "", texts[1]] for tag, texts in _tags(240).items()}
    names = "X_Value\tTemperature\tX_Value\tResistance\tComment"
    rows = lines_of([fields[0], fields[1], later, fields[2]], "\t")
    expected["resistance_time_s"] = truth.time_s + 0.05, 0.0 * truth.time_s + 1e-6
    content = encoded([*_lvm("Multi"), *_segment(tags, names), *rows], end="\r\n")
    return Way("LabVIEW .lvm: times before each channel", "test_003.lvm", content, expected)


def lvm_no_times(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    rows = ["\t" + line for line in lines_of([comma(texts) for texts in fields], "\t")]
    tags = _tags(240, "14:03:02,5", "5,000000E-1") | {"X0": ["0,0000000000000000E+0"] * 2}
    lines = [*_lvm("No", "Yes", ","), *_segment(tags, NAMES), *rows]
    return Way("LabVIEW .lvm: times in the header alone", "test_004.lvm", encoded(lines, end="\r\n"), expected)


def lvm_segments(truth: Truth) -> Way:
    fields, expected = columns_of(truth, LVM)
    expected["time_s"] = times(truth, 1e-5)
    again = [f"{float(t) - 60.0:.6f}" for t in truth.time_s[120:]]
    first = lines_of([texts[:120] for texts in fields], "\t")
    second = lines_of([again, *(texts[120:] for texts in fields[1:])], "\t")
    lines = [*_lvm("One", "Yes"), *_segment(_tags(120), NAMES), *first, ""]
    lines += [*_segment(_tags(120, "14:04:02.5"), NAMES), *second, ""]
    return Way("LabVIEW .lvm: two segments, times begin again", "test_005.lvm", encoded(lines, end="\r\n"), expected)


def lvm_comma(truth: Truth) -> Way:
    fields, expected = columns_of(truth, LVM)
    rows = [line + (",lamp on" if k % 50 == 0 else "") for k, line in enumerate(lines_of(fields, ","))]
    special = ["***Start_Special***", "Scan 1,2,3", "***End_Special***"]
    lines = [*_lvm("One", separator=","), *special, *_segment(_tags(240), NAMES.replace("\t", ","), ","), *rows]
    return Way("LabVIEW .lvm: commas, some comments, a special block", "test_006.lvm", encoded(lines), expected)


def _buffer(count: int) -> list[str]:
    return [
        "Model,DAQ6510", "Serial,04412345", "Firmware,1.7.3b", "Buffer,defbuffer1", "Capacity,100000",
        f"Count,{count}", "Base Time,11/21/2026 14:03:02", "",
    ]  # fmt: skip


def buffer_one_channel(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".6f"), OHM, CELSIUS))
    head = "Index,Reading,Unit,Range Digits,Disp Digits,Math,Start Group,Limit1 High,Terminal,Origin,Channel,CH Label,"
    rows = [
        f"{k + 1},{ohm},Ohm,6,6.5,F,F,F,Rear,Main,102,R film,{t},{degC}"
        for k, (t, ohm, degC) in enumerate(zip(*fields, strict=True))
    ]
    lines = [*_buffer(240), head + "Relative Time,Temperature (C)", *rows]
    return Way("a meter's buffer: settings above, words in rows", "defbuffer1.csv", encoded(lines), expected)


def buffer_row_a_channel(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".6f"), CELSIUS, OHM))
    later = [f"{float(t) + 0.2:.6f}" for t in truth.time_s]
    expected["resistance_time_s"] = truth.time_s + 0.2, 0.0 * truth.time_s + 1e-6
    rows = []
    for k, (t, degC, ohm, after) in enumerate(zip(*fields, later, strict=True)):
        rows += [f"{2 * k + 1},{degC},Celsius,6,101,{t},F", f"{2 * k + 2},{ohm},Ohm,6,102,{after},F"]
    lines = [*_buffer(480), "Index,Reading,Unit,Range Digits,Channel,Relative Time,Questionable", *rows]
    return Way("a meter's buffer: a row for each channel", "scan.csv", encoded(lines), expected)


def buffer_dates(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (OHM, CELSIUS))
    expected["time_s"] = times(truth)
    when = stamps(truth)
    parts = [
        [f"{s:%m/%d/%Y}" for s in when],
        [f"{s:%H:%M:%S}" for s in when],
        [f"{s.microsecond / 1e6:.6f}" for s in when],
    ]
    lines = [
        "Reading [Ohm],Date,Time,Fractional Seconds,Temperature (C)",
        *lines_of([fields[0], *parts, fields[1]], ","),
    ]
    return Way("date, time and fractional seconds in columns", "buffer2450.csv", encoded(lines), expected)


def negative_overflow(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".2f"), CELSIUS, OHM))
    low = expected["resistance_ohm"][0].copy()
    for k, text in ((5, "-9.9E+37"), (6, "+9.9E37"), (90, "-1.000000000e+38"), (91, "-OL")):
        fields[2][k], low[k] = text, np.inf
    expected["resistance_ohm"] = low, expected["resistance_ohm"][1]
    lines = ["Time (s),Temperature (C),Resistance (Ohm)", *lines_of(fields, ",")]
    return Way("overflow below zero: -9.9E37, -1E38, -OL", "leads.csv", encoded(lines), expected)


def date_dash_clock(truth: Truth) -> Way:
    truth = truth_of(int(truth.resistance_ohm[0]), step_s=20.0)
    fields, expected = columns_of(truth, (OHM, CELSIUS))
    expected["time_s"] = times(truth)
    clock = [f"{s:%d/%m/%Y-%H:%M:%S}" for s in stamps(truth, datetime(2026, 10, 20, 23, 55, 0))]
    lines = ["date;R (ohm);dut_temp (degC);", *(line + ";" for line in lines_of([clock, *fields], ";"))]
    return Way("day/month/year-hh:mm:ss", "sweep.dsv", encoded(lines), expected)


def compact_dates(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (KELVIN, OHM))
    expected["time_s"] = times(truth)
    clock = [f"{s:%Y%m%d_%H%M%S}.{s.microsecond // 100000}" for s in stamps(truth)]
    lines = ["Timestamp,T (K),R (Ohm)", *lines_of([clock, *fields], ",")]
    return Way("dates as 20261121_140302.5", "log.csv", encoded(lines), expected)


def end_of_summer(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    back = datetime(2026, 10, 25, 3, 0, 0)
    when = [s - timedelta(hours=1) if s >= back else s for s in stamps(truth, datetime(2026, 10, 25, 2, 59, 3))]
    clock = [f"{s:%d.%m.%Y %H:%M:%S}.{s.microsecond // 100000}" for s in when]
    lines = ["Timestamp;Temperature (C);Resistance (Ohm)", *lines_of([clock, *fields], ";")]
    return Way("local time, the hour that comes twice", "night.csv", encoded(lines), expected)


def arrhenius(truth: Truth) -> Way:
    time, expected = columns_of(truth, (("time_s", "as ours", ".2f"),))
    kelvin = truth.temperature_degC + 273.15
    reciprocal = [f"{1e3 / t:.6f}" for t in kelvin]
    expected["temperature_degC"] = truth.temperature_degC, 0.51e-6 * kelvin**2 / 1e3
    logs = [f"{np.log(ohm):.5f}" for ohm in truth.resistance_ohm]
    expected["resistance_ohm"] = truth.resistance_ohm, 0.52e-5 * truth.resistance_ohm
    lines = ["Time (s),1000/T (1/K),ln R (ohm)", *lines_of([*time, reciprocal, logs], ",")]
    return Way("an Arrhenius plot's table: 1000/T, ln R", "arrhenius.csv", encoded(lines), expected)


def doubled_row(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".2f"), CELSIUS, OHM))
    rows = lines_of(fields, ",")
    lines = ["time_s,temperature_degC,resistance_ohm", *rows[:121], rows[120], *rows[121:], rows[-1]]
    return Way("two rows doubled word for word", "logger.csv", encoded(lines), expected)


def clock_set_back(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    moved = truth.time_s - np.where(np.arange(240) > 100, 0.7, 0.0)
    kept = np.arange(240) != 101
    when = [datetime(2026, 11, 21, 14, 3, 2) + timedelta(seconds=float(t)) for t in moved]
    expected = {name: (values[kept], slack[kept]) for name, (values, slack) in expected.items()}
    expected["time_s"] = moved[kept], 0.0 * moved[kept] + 1e-6
    lines = ["time,T (C),R (ohm)", *lines_of([[s.isoformat(timespec="milliseconds") for s in when], *fields], ",")]
    return Way("a clock that was set back by 0.7 s", "ntp.csv", encoded(lines), expected)


def seconds_and_nanoseconds(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    full = [str(1795269782 + int((t + 0.5) // 1.0)) for t in truth.time_s]
    parts = [str(round((t + 0.5) % 1.0 * 1e9)) for t in truth.time_s]
    lines = ["secs,nsecs,Temperature (C),Resistance (ohm)", *lines_of([full, parts, *fields], ",")]
    units = {"time_s": "s"}
    return Way("seconds since 1970, nanoseconds beside them", "bag.csv", encoded(lines), expected, units)


def database_rows(truth: Truth) -> Way:
    expected: Expected = {"time_s": times(truth)}
    clock = [s.isoformat(timespec="milliseconds") + "Z" for s in stamps(truth)]
    lines = ["_time,_value,_field,_measurement"]
    for ours, name in (("temperature_degC", "temperature_C"), ("resistance_ohm", "resistance_ohm")):
        texts, wanted = written(truth, ours, "as ours", ".6f")
        expected[ours] = wanted
        lines += [f"{stamp},{text},{name},film" for stamp, text in zip(clock, texts, strict=True)]
    return Way("a database's rows, one quantity after the other", "influx.csv", encoded(lines), expected)


FURTHER_WAYS: tuple[Callable[[Truth], Way], ...] = (
    without_times, side_by_side, up_and_down, lvm_comment, lvm_multi, lvm_no_times, lvm_segments, lvm_comma,
    buffer_one_channel, buffer_row_a_channel, buffer_dates, negative_overflow, date_dash_clock, compact_dates,
    end_of_summer, arrhenius, doubled_row, clock_set_back, seconds_and_nanoseconds, database_rows,
)  # fmt: skip
