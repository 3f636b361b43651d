"""Sixty ways in which labs and their instruments write one record, each as it was met, none made for the reader.

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


FIRST_WAYS: tuple[Callable[[Truth], Way], ...] = (
    own_names, pandas_index, r_frame, savetxt, writematrix, fortran, labview_lvm, labview_spreadsheet, excel_german,
    excel_french, excel_thousands, excel_unicode_text, igor_itx, origin, qcodes, quantum_design,
    chart_recorder, bluesky, benchlink, bench_meter, midi_logger, tec_service, hand_meter, physics_slashes, fahrenheit,
    clock_over_midnight, german_dates, date_and_time, conductance, misnamed_conductance, pid_log,
    kelvin_called_celsius, names_only, japanese, restarted, workbook, workbook_dates, matlab, log_resistance, iso_zone,
)  # fmt: skip


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
WAYS = (*FIRST_WAYS, *FURTHER_WAYS)
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
