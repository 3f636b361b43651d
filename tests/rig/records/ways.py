"""Forty ways in which labs and their instruments write one record, each as it was met, none made for the reader.

The truth's units are converted here by factors of its own. Read right: every column that was written is there, and its
values are the truth's to the file's digits. A flag is a line that the refusal printed, typed as it stands; where it
offers several units, whoever wrote the file takes the one that it is in. Wrong in silence: read without a refusal, and
a value is another one, or a column that was written is missing and no line says so.
"""

from __future__ import annotations

import io
import math
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

from rig.core.faults import Faults
from rig.records.column_names import ColumnMapping
from rig.records.record_file import Record, read_record

Values = np.ndarray

# unit in the file -> (from ours to it, from it to ours)
UNITS: dict[str, tuple[Callable[[Values], Values], Callable[[Values], Values]]] = {
    "as ours": (lambda x: x, lambda x: x),
    "ms": (lambda x: x * 1e3, lambda x: x / 1e3),
    "min": (lambda x: x / 60.0, lambda x: x * 60.0),
    "K": (lambda x: x + 273.15, lambda x: x - 273.15),
    "degF": (lambda x: x * 1.8 + 32.0, lambda x: (x - 32.0) / 1.8),
    "kohm": (lambda x: x / 1e3, lambda x: x * 1e3),
    "Mohm": (lambda x: x / 1e6, lambda x: x * 1e6),
    "log10ohm": (np.log10, lambda x: 10.0**x),
    "uS": (lambda x: 1e6 / x, lambda x: 1e6 / x),
    "mA": (lambda x: x * 1e3, lambda x: x / 1e3),
    "percent": (lambda x: x * 100.0, lambda x: x / 100.0),
}


@dataclass(frozen=True)
class Truth:
    """What was measured: seconds from 0, degC, ohm, A, and the sink's degC."""

    time_s: Values
    temperature_degC: Values
    resistance_ohm: Values
    current_A: Values
    sink_degC: Values

    def of(self, ours: str) -> Values:
        values: Values = getattr(self, ours)
        return values


@dataclass
class Way:
    """A file as somebody writes it. expected: our column -> (values, what the digits leave open); drive: whether
    current_A is a share of full drive; units: what whoever wrote it knows of the units, for a reader who has to ask."""

    name: str
    file: str
    content: bytes
    expected: dict[str, tuple[Values, Values]]
    units: dict[str, str] = field(default_factory=dict)
    drive: bool = False


def truth_of(seed: int, rows: int = 240, step_s: float = 0.5) -> Truth:
    """A film taken once round its loop by a plate, with noise; another seed is another film, another evening."""
    random = np.random.default_rng(seed)
    time = np.arange(rows) * step_s
    phase = np.arange(rows) / (rows - 1)
    top, bottom = random.uniform(84.0, 94.0), random.uniform(22.0, 28.0)
    temperature = bottom + (top - bottom) * (1.0 - np.abs(2.0 * phase - 1.0)) + random.normal(0.0, 0.02, rows)
    middle = np.where(phase < 0.5, 66.0, 59.0) + random.normal(0.0, 1.0)
    decades = random.uniform(2.2, 3.0)
    log = 5.4 - decades * 0.5 * (1.0 + np.tanh((temperature - middle) / 4.0)) - 0.006 * (temperature - bottom)
    resistance = 10.0 ** (log + random.normal(0.0, 0.002, rows))
    current = np.where(phase < 0.5, 0.6 + 2.4 * phase, 0.4 - 2.6 * (phase - 0.5)) + random.normal(0.0, 0.03, rows)
    sink = 24.0 + 3.0 * phase + random.normal(0.0, 0.05, rows)
    return Truth(time, temperature, resistance, current, sink)


def written(truth: Truth, ours: str, unit: str, form: str) -> tuple[list[str], tuple[Values, Values]]:
    """A column's fields in a unit, by a format such as '.3f', and what a reader must find, with the digits' slack."""
    to_file, to_ours = UNITS[unit]
    values = truth.of(ours)
    texts = [format(float(v), form) for v in to_file(values)]
    low, high = [], []
    for text in texts:
        half = 0.5001 * last_place(text)
        low.append(float(text) - half)
        high.append(float(text) + half)
    ends = to_ours(np.array(low)), to_ours(np.array(high))
    slack = np.maximum(np.abs(ends[0] - values), np.abs(ends[1] - values)) + 1e-12 * np.abs(values)
    return texts, (values, slack)


def last_place(text: str) -> float:
    """The worth of a number's last written digit: 0.01 of '3.14', 1e2 of '3.1e3'."""
    match = re.fullmatch(r"[-+]?\d+(?:\.(\d*))?(?:[eE]([-+]?\d+))?", text)
    assert match is not None, text
    return math.pow(10.0, int(match[2] or 0) - len(match[1] or ""))


Column = tuple[str, str, str]  # ours, unit in the file, format
Expected = dict[str, tuple[Values, Values]]
EVENING = datetime(2026, 11, 21, 14, 3, 2, 500000)


def columns_of(truth: Truth, columns: Sequence[Column]) -> tuple[list[list[str]], Expected]:
    """Fields by column, and what a reader must find."""
    fields, expected = [], {}
    for ours, unit, form in columns:
        texts, wanted = written(truth, ours, unit, form)
        fields.append(texts)
        expected[ours] = wanted
    return fields, expected


def times(truth: Truth, slack_s: float = 1e-6) -> tuple[Values, Values]:
    """What a reader must find of times that are written as a clock's."""
    return truth.time_s, 0.0 * truth.time_s + slack_s


def stamps(truth: Truth, start: datetime = EVENING) -> list[datetime]:
    return [start + timedelta(seconds=float(t)) for t in truth.time_s]


def lines_of(fields: Sequence[Sequence[str]], separator: str) -> list[str]:
    return [separator.join(row) for row in zip(*fields, strict=True)]


def encoded(lines: Sequence[str], encoding: str = "utf-8", end: str = "\n") -> bytes:
    return (end.join(lines) + end).encode(encoding)


def comma(texts: Sequence[str]) -> list[str]:
    return [text.replace(".", ",") for text in texts]


TIME: Column = ("time_s", "as ours", ".2f")
KELVIN: Column = ("temperature_degC", "K", ".3f")
CELSIUS: Column = ("temperature_degC", "as ours", ".3f")
OHM: Column = ("resistance_ohm", "as ours", ".6e")
AMPERE: Column = ("current_A", "as ours", ".4f")


def own_names(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, OHM, AMPERE))
    head = "time_s,temperature_degC,resistance_ohm,current_A"
    return Way("our own names", "record.csv", encoded([head, *lines_of(fields, ",")]), expected)


def pandas_index(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    index = [stamp.isoformat(" ", "microseconds") for stamp in stamps(truth)]
    lines = ["timestamp,temperature_C,resistance_ohm", *lines_of([index, *fields], ",")]
    return Way("pandas, a DatetimeIndex", "frame.csv", encoded(lines), expected)


def r_frame(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, OHM))
    fields[2][7], fields[2][40] = "NA", "Inf"
    resistance, slack = expected["resistance_ohm"]
    resistance = resistance.copy()
    resistance[7], resistance[40] = float("nan"), float("inf")
    expected["resistance_ohm"] = resistance, slack
    names = [f'"{k}"' for k in range(1, len(fields[0]) + 1)]
    lines = ['"","time_s","temperature_degC","resistance_ohm"', *lines_of([names, *fields], ",")]
    return Way("R's write.csv: row names, quotes, NA, Inf", "frame.csv", encoded(lines), expected)


def savetxt(truth: Truth) -> Way:
    columns = [("time_s", "as ours", ".18e"), ("temperature_degC", "K", ".18e"), ("resistance_ohm", "as ours", ".18e")]
    fields, expected = columns_of(truth, columns)
    return Way("numpy.savetxt", "run7.txt", encoded(["# t_s T_K R_ohm", *lines_of(fields, " ")]), expected)


def writematrix(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, OHM))
    units = {"time_s": "s", "temperature_degC": "degC", "resistance_ohm": "ohm"}
    return Way("MATLAB writematrix: no header", "data.csv", encoded(lines_of(fields, ",")), expected, units)


def fortran(truth: Truth) -> Way:
    columns = [("time_s", "as ours", ".6E"), ("temperature_degC", "K", ".6E"), ("resistance_ohm", "as ours", ".6E")]
    fields, expected = columns_of(truth, columns)
    lines = ["! film 12, second cool-down", "! time [s]   T [K]   R [Ohm]"]
    rows = ["   " + "   ".join(t.replace("E", "D") for t in row) for row in zip(*fields, strict=True)]
    return Way("Fortran, D exponents, names in a comment", "film12.out", encoded([*lines, *rows]), expected)


def labview_lvm(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".6f"), CELSIUS, OHM, AMPERE))
    count = str(len(fields[0]))
    head = [
        "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
        "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative", "Operator\tlab", "Date\t2026/11/21",
        "Time\t14:03:02.5123456789", "***End_of_Header***\t", "\t", "Channels\t3\t\t\t",
        f"Samples\t{count}\t{count}\t{count}\t", "Date\t2026/11/21\t2026/11/21\t2026/11/21\t",
        "Time\t14:03:02.5\t14:03:02.5\t14:03:02.5\t", "Y_Unit_Label\tdegC\tOhm\tA\t",
        "X_Dimension\tTime\tTime\tTime\t", "X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t",
        "Delta_X\t0.500000\t0.500000\t0.500000\t", "***End_of_Header***\t\t\t\t",
        "X_Value\tTemperature\tResistance\tCurrent\tComment",
    ]  # fmt: skip
    rows = [line + "\t" for line in lines_of(fields, "\t")]
    return Way("LabVIEW .lvm", "test_001.lvm", encoded([*head, *rows], end="\r\n"), expected)


def labview_spreadsheet(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, ("resistance_ohm", "as ours", ".3f")))
    lines = lines_of([comma(texts) for texts in fields], "\t")
    units = {"time_s": "s", "temperature_degC": "degC", "resistance_ohm": "ohm"}
    name = "LabVIEW Write To Spreadsheet: no header, decimal comma"
    return Way(name, "Messung.xls.txt", encoded(lines, end="\r\n"), expected, units)


def excel_german(truth: Truth) -> Way:
    columns = [TIME, ("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "kohm", ".4f"), AMPERE]
    fields, expected = columns_of(truth, columns)
    head = "Zeit [s];Temperatur [°C];Widerstand [kOhm];Strom [A]"
    lines = [head, *lines_of([comma(texts) for texts in fields], ";")]
    return Way("Excel, German, cp1252", "Messung 3.csv", encoded(lines, "cp1252", "\r\n"), expected)


def excel_french(truth: Truth) -> Way:
    columns = [TIME, ("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "as ours", ".1f")]
    fields, expected = columns_of(truth, [*columns, ("current_A", "mA", ".1f")])
    head = "Temps (s);Température (°C);Résistance (Ω);Courant (mA)"
    lines = [head, *lines_of([comma(texts) for texts in fields], ";")]
    return Way("Excel, French, UTF-8 with BOM", "relevé.csv", encoded(lines, "utf-8-sig", "\r\n"), expected)


def excel_thousands(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, ("resistance_ohm", "as ours", ".2f")))
    fields[2] = [f'"{float(text):,.2f}"' if float(text) >= 1e3 else text for text in fields[2]]
    lines = ["Time (s),Temperature (C),Resistance (ohms)", *lines_of(fields, ",")]
    return Way("Excel, US, thousands separators in quotes", "Book1.csv", encoded(lines, end="\r\n"), expected)


def excel_unicode_text(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "min", ".5f"), KELVIN, ("resistance_ohm", "kohm", ".5f")))
    lines = ["Time [min]\tT [K]\tR [kΩ]", *lines_of(fields, "\t")]
    return Way("Excel's Unicode text: UTF-16, tabs", "Book1.txt", encoded(lines, "utf-16", "\r\n"), expected)


def igor_itx(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, KELVIN, OHM))
    rows = ["\t" + line for line in lines_of(fields, "\t")]
    tail = ["END", 'X SetScale/P x 0,1,"", t_s; SetScale y 0,0,"", t_s', 'X SetScale/P x 0,1,"", T_K']
    lines = ["IGOR", "WAVES/D\tt_s\tT_K\tR_ohm", "BEGIN", *rows, *tail]
    return Way("Igor Text", "waves.itx", encoded(lines, end="\r"), expected)


def origin(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, KELVIN, ("resistance_ohm", "as ours", ".5g")))
    lines = ["Time\tTemperature\tResistance", "sec\tK\tOhm", "\tCernox\t4-wire", *lines_of(fields, "\t")]
    return Way("Origin: long names, units, comments", "Graph2.dat", encoded(lines, end="\r\n"), expected)


def qcodes(truth: Truth) -> Way:
    columns = [("time_s", "as ours", ".12g"), ("temperature_degC", "K", ".12g"), ("resistance_ohm", "as ours", ".12g")]
    fields, expected = columns_of(truth, columns)
    head = ["# time\ttemperature\tresistance", '# "Time (s)"\t"Temperature (K)"\t"Resistance (Ohm)"']
    return Way("QCoDeS .dat", "data.dat", encoded([*head, f"# {len(fields[0])}", *lines_of(fields, "\t")]), expected)


def quantum_design(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (KELVIN, ("resistance_ohm", "as ours", ".6g")))
    expected["time_s"] = times(truth)
    time = [f"{3973100582.5 + float(t):.2f}" for t in truth.time_s]
    head = [
        "[Header]", "; PPMS Resistivity Data File", "TITLE,VO2 film 12, 120 nm on sapphire",
        "BYAPP,Resistivity,1.0,1.2",
        "INFO,PPMS,APPNAME", "INFO,film 12,SAMPLE1_NAME", "DATATYPE,COMMENT,1", "DATATYPE,TIME,2",
        "STARTUPAXIS,X,4", "STARTUPAXIS,Y1,7", "[Data]",
        "Comment,Time Stamp (sec),Status (code),Temperature (K),Magnetic Field (Oe),Sample Position (deg),"
        "Bridge 1 Resistance (Ohms),Bridge 1 Excitation (uA),Bridge 2 Resistance (Ohms),Bridge 2 Excitation (uA)",
    ]  # fmt: skip
    pairs = zip(time, *fields, strict=True)
    rows = [f",{stamp},4177,{kelvin},0.1,0,{ohm},1.0,," for stamp, kelvin, ohm in pairs]
    return Way("Quantum Design PPMS", "film12.dat", encoded([*head, *rows], end="\r\n"), expected)


def chart_recorder(truth: Truth) -> Way:
    truth = truth_of(int(truth.resistance_ohm[0]), step_s=2.0)
    fields, expected = columns_of(truth, (KELVIN, ("resistance_ohm", "kohm", ".4f")))
    expected["time_s"] = times(truth)
    clock = [f"{s.month}/{s.day}/{s.year} {s:%I:%M:%S %p}" for s in stamps(truth, datetime(2026, 11, 21, 11, 57, 0))]
    lines = ["Date/Time,Input A (K),Sensor B (kOhm)", *lines_of([clock, *fields], ",")]
    return Way("a chart recorder's US dates over noon", "chart.csv", encoded(lines, end="\r\n"), expected)


def bluesky(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    epoch = [f"{1795269782.25 + float(t):.6f}" for t in truth.time_s]
    number = [str(k) for k in range(1, len(epoch) + 1)]
    lines = ["seq_num,time,thermo_temperature,dmm_resistance", *lines_of([number, epoch, *fields], ",")]
    units = {"time_s": "s", "temperature_degC": "degC", "resistance_ohm": "ohm"}
    return Way("a Bluesky table: seconds since 1970, no units", "scan_42.csv", encoded(lines), expected, units)


def benchlink(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    clock = [f"{s:%m/%d/%Y %H:%M:%S}:{s.microsecond // 1000:03d}" for s in stamps(truth)]
    scan = [str(k) for k in range(1, len(clock) + 1)]
    head = [
        "Data for:,film 12", "Owner:,lab", "Comments:,", "Acquisition Date:,11/21/2026 2:03:02 PM", "",
        "Instrument:,34970A,Address:,GPIB0::9::INSTR,,", "Total Channels:,2", "",
        "Scan,Time,101 (C),102 (OHM)",
    ]  # fmt: skip
    lines = [*head, *lines_of([scan, clock, *fields], ",")]
    return Way("a scanner's UTF-16, a colon before the ms", "Data 1.csv", encoded(lines, "utf-16", "\r\n"), expected)


def bench_meter(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "as ours", ".3f"), CELSIUS, OHM))
    fields[2][0] = "+9.900000E+37"
    resistance, slack = expected["resistance_ohm"]
    resistance = resistance.copy()
    resistance[0] = float("inf")
    expected["resistance_ohm"] = resistance, slack
    head = [
        '"Project Name","film 12"', '"Application","Data Logger"', '"Instrument","DMM6500 SN04412345"',
        '"Start Time","11/21/2026 14:03:02"', '"Channel","101","102"', "",
        '"Relative Time (s)","Temperature (°C)","4W Resistance (Ω)"',
    ]  # fmt: skip
    lines = [*head, *lines_of(fields, ",")]
    return Way("a meter's preamble and 9.9E37 for overflow", "run 12.csv", encoded(lines, end="\r\n"), expected)


def midi_logger(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("temperature_degC", "as ours", ".1f"), ("resistance_ohm", "kohm", ".3f")))
    expected["time_s"] = times(truth)
    number = [str(k) for k in range(1, len(fields[0]) + 1)]
    clock = [f"{s:%Y/%m/%d %H:%M:%S}" for s in stamps(truth)]
    milli = [str(s.microsecond // 1000) for s in stamps(truth)]
    spaced = [[f"+{float(text):>9}" for text in texts] for texts in fields]
    head = [
        "Vendor,Some Instruments", "Model,MIDI-LOGGER", "Version,Ver1.22", "Sampling interval,500ms",
        f"Total data points,{len(number)}", "Start time,2026/11/21,14:03:02", "AMP settings",
        "CH,Signal name,Input,Range,Filter,Span", '1,"plate",TEMP,TC_K,Off,100,0', '2,"film",DC,1V,Off,1,0',
        "Data", "Number,Date&Time,ms,plate temperature,film resistance,Alarm", "NO.,Time,ms,degC,kohm,A1",
    ]  # fmt: skip
    lines = [*head, *lines_of([number, clock, milli, *spaced, ["LL"] * len(number)], ",")]
    return Way("a logger: milliseconds in a column, '+   25.3'", "261121.CSV", encoded(lines, end="\r\n"), expected)


def tec_service(truth: Truth) -> Way:
    columns = [CELSIUS, ("sink_degC", "as ours", ".2f"), ("current_A", "as ours", ".3f")]
    fields, expected = columns_of(truth, columns)
    expected["time_s"] = times(truth)
    clock = [f"{s:%d.%m.%Y %H:%M:%S},{s.microsecond // 1000:03d}" for s in stamps(truth)]
    fields = [comma(texts) for texts in fields]
    head = "Time;Object Temperature [°C];Sink Temperature [°C];Actual Output Current [A];Device Status"
    lines = [head, *lines_of([clock, *fields, ["Run"] * len(clock)], ";")]
    return Way("a TEC controller's log, German", "LOG_1.csv", encoded(lines, "utf-8-sig", "\r\n"), expected)


def hand_meter(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, ("temperature_degC", "as ours", ".1f")))
    texts, low, slack = [], truth.resistance_ohm.copy(), 0.0 * truth.resistance_ohm
    for k, ohm in enumerate(truth.resistance_ohm):
        scale, unit = (1.0, "Ω") if ohm < 1e3 else (1e3, "kΩ") if ohm < 1.2e5 else (1e6, "MΩ")
        texts.append(f"{ohm / scale:.4f} {unit}")
        slack[k] = 0.51e-4 * scale
    texts[3], low[3] = "OL", float("inf")
    expected["resistance_ohm"] = low, slack
    fields[1] = [f"{text} °C" for text in fields[1]]
    lines = ["Time (s)\tTC1\tDMM", *lines_of([*fields, texts], "\t")]
    units = {"temperature_degC": "degC", "resistance_ohm": "ohm"}
    return Way("a handheld meter: a unit in every field, OL", "log.txt", encoded(lines), expected, units)


def physics_slashes(truth: Truth) -> Way:
    columns = [("time_s", "min", ".4f"), CELSIUS, ("resistance_ohm", "kohm", ".4f"), ("current_A", "mA", ".1f")]
    fields, expected = columns_of(truth, columns)
    lines = ["t / min\tϑ / °C\tR / kΩ\tI / mA", *lines_of(fields, "\t")]
    return Way("quantities over units: t / min", "Versuch.txt", encoded(lines), expected)


def fahrenheit(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("temperature_degC", "degF", ".2f"), OHM))
    expected["time_s"] = times(truth)
    clock = [f"{int(t // 3600)}:{int(t % 3600 // 60):02d}:{t % 60:04.1f}" for t in truth.time_s]
    lines = ["Elapsed,Temp (°F),Res (ohm)", *lines_of([clock, *fields], ",")]
    return Way("degrees Fahrenheit, elapsed h:mm:ss", "omega.csv", encoded(lines), expected)


def clock_over_midnight(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (CELSIUS, OHM))
    expected["time_s"] = times(truth)
    clock = [f"{s:%H:%M:%S}.{s.microsecond // 100000}" for s in stamps(truth, datetime(2026, 11, 21, 23, 59, 12))]
    lines = ["Time,T_C,R_ohm", *lines_of([clock, *fields], ",")]
    return Way("a clock, over midnight", "night.csv", encoded(lines), expected)


def german_dates(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "as ours", ".2f")))
    expected["time_s"] = times(truth)
    clock = [f"{s:%d.%m.%Y %H:%M:%S},{s.microsecond // 100000}" for s in stamps(truth)]
    swap = str.maketrans(",.", ".,")
    fields = [[f"{float(text):,.2f}".translate(swap) for text in texts] for texts in fields]
    lines = ["Datum/Uhrzeit;Temperatur (°C);Widerstand (Ohm)", *lines_of([clock, *fields], ";")]
    return Way("German dates, 123.456,78", "Export.csv", encoded(lines, "cp1252", "\r\n"), expected)


def date_and_time(truth: Truth) -> Way:
    truth = truth_of(int(truth.resistance_ohm[0]), step_s=2.0)
    fields, expected = columns_of(truth, (("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "as ours", ".1f")))
    expected["time_s"] = times(truth)
    when = stamps(truth, datetime(2026, 4, 3, 23, 57, 30))
    date, clock = [f"{s:%d/%m/%Y}" for s in when], [f"{s:%H:%M:%S}" for s in when]
    lines = ["Date,Time,Temp(C),Resistance(ohm)", *lines_of([date, clock, *fields], ",")]
    units = {"time_s": "dmy"}
    return Way("date and time apart, 03/04/2026 into 04/04", "log.csv", encoded(lines), expected, units)


def conductance(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, KELVIN, ("resistance_ohm", "uS", ".6g")))
    lines = ["Time (s),Temperature (K),Conductance (µS)", *lines_of(fields, ",")]
    return Way("conductance in microsiemens", "G.csv", encoded(lines), expected, {"resistance_ohm": "uS"})


def misnamed_conductance(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (("time_s", "ms", ".0f"), KELVIN, ("resistance_ohm", "as ours", ".2f")))
    lines = ["Time (ms),Temperature (K),Conductance (Ohm)", *lines_of(fields, ",")]
    return Way("resistance that is called conductance", "R.csv", encoded(lines), expected, {"resistance_ohm": "ohm"})


def pid_log(truth: Truth) -> Way:
    share = Truth(truth.time_s, truth.temperature_degC, truth.resistance_ohm, truth.current_A / 4.0, truth.sink_degC)
    fields, expected = columns_of(share, (TIME, CELSIUS, ("current_A", "percent", ".2f")))
    setpoint = [f"{25.0 + 10.0 * (k // 60):.1f}" for k in range(len(fields[0]))]
    lines = ["Time (s),PV (degC),SP (degC),Output (%)", *lines_of([*fields[:2], setpoint, fields[2]], ",")]
    units = {"current_A": "percent"}
    return Way("a PID controller's log, output in percent", "pid.csv", encoded(lines), expected, units, drive=True)


def kelvin_called_celsius(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, KELVIN, OHM))
    lines = ["time_s,temperature_degC,resistance_ohm", *lines_of(fields, ",")]
    return Way("kelvin under the name of degC", "film.csv", encoded(lines), expected, {"temperature_degC": "K"})


def names_only(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, ("resistance_ohm", "kohm", ".4f")))
    lines = ["time,temp,R", *lines_of(fields, ",")]
    units = {"time_s": "s", "temperature_degC": "degC", "resistance_ohm": "kohm"}
    return Way("bare names, R in kilohms", "x.csv", encoded(lines), expected, units)


def japanese(truth: Truth) -> Way:
    fields, expected = columns_of(
        truth, (TIME, ("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "kohm", ".4f"))
    )
    lines = ["時間(s),温度(℃),抵抗(kΩ)", *lines_of(fields, ",")]
    units = {"time_s": "s", "temperature_degC": "degC", "resistance_ohm": "kohm"}
    return Way("a Japanese logger, cp932", "data.csv", encoded(lines, "cp932", "\r\n"), expected, units)


def restarted(truth: Truth) -> Way:
    fields, expected = columns_of(truth, (TIME, CELSIUS, OHM))
    head, rows = "Time (s),Temperature (°C),Resistance (Ω),,", [line + ",," for line in lines_of(fields, ",")]
    lines = [head, *rows[:90], head, *rows[90:], ",,,,", ",,,,"]
    return Way("header again after a restart, blank columns", "append.csv", encoded(lines), expected)


def workbook(truth: Truth) -> Way:
    from openpyxl import Workbook

    fields, expected = columns_of(truth, (TIME, KELVIN, ("resistance_ohm", "kohm", ".5f")))
    book = Workbook()
    sheet = book.active
    assert sheet is not None
    for row in (["VO2 film 12, second run"], [], ["Time", "Temperature", "Resistance"], ["s", "K", "kΩ"]):
        sheet.append(row)
    for row in zip(*fields, strict=True):
        sheet.append([float(text) for text in row])
    return Way("Excel workbook: a title, units below the names", "film12.xlsx", _saved(book), expected)


def workbook_dates(truth: Truth) -> Way:
    from openpyxl import Workbook

    fields, expected = columns_of(truth, (CELSIUS, ("resistance_ohm", "as ours", ".3f")))
    expected["time_s"] = times(truth, 2e-3)  # a workbook keeps days, to the millisecond
    book = Workbook()
    notes, sheet = book.active, book.create_sheet("Data")
    assert notes is not None
    notes.append(["see the next sheet"])
    sheet.append(["Date", "Temperature (°C)", "Resistance (Ω)"])
    for stamp, *row in zip(stamps(truth), *fields, strict=True):
        sheet.append([stamp, *(float(text) for text in row)])
    return Way("Excel workbook: dates, second sheet", "log.xlsx", _saved(book), expected)


def _saved(book: object) -> bytes:
    file = io.BytesIO()
    book.save(file)  # type: ignore[attr-defined]
    return file.getvalue()


def matlab(truth: Truth) -> Way:
    from scipy.io import savemat

    columns = [("time_s", "as ours", ".15g"), ("temperature_degC", "K", ".15g"), ("resistance_ohm", "as ours", ".15g")]
    fields, expected = columns_of(truth, columns)
    t, kelvin, ohm = (np.array([float(text) for text in texts])[:, None] for texts in fields)
    file = io.BytesIO()
    savemat(file, {"data": {"time_s": t, "T_K": kelvin, "R_ohm": ohm, "sample": "film 12"}, "fs": 2.0})
    return Way("MATLAB .mat, a struct", "film12.mat", file.getvalue(), expected)


def log_resistance(truth: Truth) -> Way:
    columns = [TIME, ("temperature_degC", "as ours", ".2f"), ("resistance_ohm", "log10ohm", ".5f")]
    fields, expected = columns_of(truth, columns)
    lines = ["t (s)  T (°C)  log10(R/Ohm)", *lines_of(fields, "  ")]
    return Way(
        "log10 of the resistance, two spaces", "loop.txt", encoded(lines), expected, {"resistance_ohm": "log10ohm"}
    )


def iso_zone(truth: Truth) -> Way:
    columns = [("temperature_degC", "as ours", ".3f"), ("resistance_ohm", "Mohm", ".8f"), ("current_A", "mA", ".2f")]
    fields, expected = columns_of(truth, columns)
    expected["time_s"] = times(truth)
    zone = timezone(timedelta(hours=1))
    clock = [s.replace(tzinfo=zone).isoformat(timespec="milliseconds") for s in stamps(truth)]
    lines = ["# plate 3, film 12", "#", "time,T [degC],R [MOhm],I [mA]", *lines_of([clock, *fields], ",")]
    return Way("ISO times with a zone, comments", "telegraf.csv", encoded(lines), expected)


WAYS: tuple[Callable[[Truth], Way], ...] = (
    own_names, pandas_index, r_frame, savetxt, writematrix, fortran, labview_lvm, labview_spreadsheet, excel_german,
    excel_french, excel_thousands, excel_unicode_text, igor_itx, origin, qcodes, quantum_design,
    chart_recorder, bluesky, benchlink, bench_meter, midi_logger, tec_service, hand_meter, physics_slashes, fahrenheit,
    clock_over_midnight, german_dates, date_and_time, conductance, misnamed_conductance, pid_log,
    kelvin_called_celsius, names_only, japanese, restarted, workbook, workbook_dates, matlab, log_resistance, iso_zone,
)  # fmt: skip


FLAG = re.compile(r"--column (?:'[^']*'|\S+)")


def wrong(record: Record, way: Way) -> str:
    """What is not as it was written; '' where nothing is."""
    for name, (values, slack) in way.expected.items():
        if name not in record.columns:
            told = any(name in line or "left" in line for line in record.notes)
            return f"{name} missing{'' if told else ' in silence'}"
        found = record[name]
        if found.shape != values.shape:
            return f"{found.size} rows of {values.size} in silence"
        if name.endswith("time_s"):  # clocks begin anywhere, and all of a record with the first row
            begin = record["time_s"][0], way.expected["time_s"][0][0]
            found, values = found - begin[0], values - begin[1]
        same = np.isfinite(values)
        if not np.array_equal(np.isfinite(found), same) or not np.array_equal(np.isinf(found), np.isinf(values)):
            return f"{name}: readings and gaps mixed up in silence"
        found, values, slack = found[same], values[same], slack[same]
        if name.endswith("time_s"):  # both ends of a time from the first row are rounded
            slack = 2.0 * slack + 1e-9
        off = np.abs(found - values) - slack
        if np.any(off > 0.0):
            k = int(np.argmax(off))
            return f"{name}: {found[k]:.6g} for {values[k]:.6g} in silence"
    if (record.drive is not None) != way.drive:
        return "a share of full drive as amperes in silence"
    return ""


def typed_by_the_writer(refusal: str, way: Way) -> list[str]:
    """The printed lines that somebody types who knows the units of the file: for each of our columns the one offered
    in the right unit, else the first."""
    offered: dict[str, list[str]] = {}
    for text in FLAG.findall(refusal):
        mapping = shlex.split(text)[1]
        offered.setdefault(mapping.partition("=")[0], []).append(mapping)
    chosen = []
    for ours, mappings in offered.items():
        if ours not in (*way.expected, "time_s"):
            continue
        unit = way.units.get(ours)
        suited = [m for m in mappings if unit is not None and m.rpartition("@")[2] == unit]
        chosen.append((suited or mappings)[0])
    return chosen


def judged(way: Way, folder: Path) -> str:
    """'plain', 'flag', 'refused', or what is wrong."""
    path = folder / way.file
    path.write_bytes(way.content)
    flags: list[str] = []
    try:
        record = read_record(path, needs=("temperature_degC",))
    except Faults as refusal:
        flags = typed_by_the_writer(str(refusal), way)
        if not flags:
            return "refused, nothing to type"
        try:
            record = read_record(path, [ColumnMapping.parse(text) for text in flags], ("temperature_degC",))
        except Faults:
            return "refused again"
    return wrong(record, way) or ("flag" if flags else "plain")
