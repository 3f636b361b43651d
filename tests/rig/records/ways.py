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
Clock = Callable[[datetime, float, int], str]  # of a row: its moment, its time (s), its number from 0


def table(
    name: str,
    file: str,
    columns: Sequence[Column],
    head: Sequence[str],
    separator: str = ",",
    *,
    clock: Sequence[Clock] = (),
    start: datetime = EVENING,
    step_s: float = 0.5,
    change: Callable[[list[str]], list[str]] = lambda texts: texts,
    row: str = "{}",
    tail: Sequence[str] = (),
    encoding: str = "utf-8",
    end: str = "\n",
    units: str = "",
) -> Callable[[Truth], Way]:
    """A way that is names above columns. clock: columns before them; change: of all other fields; row: around each;
    units: what the writer knows, as NAME=UNIT with blanks between."""

    def write(truth: Truth) -> Way:
        if step_s != 0.5:
            truth = truth_of(int(truth.resistance_ohm[0]), step_s=step_s)
        fields, expected = columns_of(truth, columns)
        expected.setdefault("time_s", times(truth))
        moments = list(zip(stamps(truth, start), truth.time_s.tolist(), range(truth.time_s.size), strict=True))
        before = [[of(*moment) for moment in moments] for of in clock]
        rows = [row.format(line) for line in lines_of([*before, *map(change, fields)], separator)]
        known = dict(one.split("=") for one in units.split())
        return Way(name, file, encoded([*head, *rows, *tail], encoding, end), expected, known)

    return write


def dotted(texts: list[str]) -> list[str]:
    """123.456,78 for 123456.78."""
    return [f"{float(text):,.2f}".translate(str.maketrans(",.", ".,")) for text in texts]


def thousands(texts: list[str]) -> list[str]:
    """1,234.56 in quotes, as spreadsheets write what is large."""
    return [f'"{float(text):,.2f}"' if float(text) >= 1e3 else text for text in texts]


def finest(ours: str, unit: str, form: str = ".18e") -> Column:
    return ours, unit, form


TENTH: Clock = lambda s, t, k: f"{s:%H:%M:%S}.{s.microsecond // 100000}"  # noqa: E731
NUMBER: Clock = lambda s, t, k: str(k + 1)  # noqa: E731
MINUTES: Column = ("time_s", "min", ".4f")
CENTI: Column = ("temperature_degC", "as ours", ".2f")
KOHM: Column = ("resistance_ohm", "kohm", ".4f")
MA: Column = ("current_A", "mA", ".1f")
PLAIN = "time_s=s temperature_degC=degC resistance_ohm=ohm"
LVM_HEAD = [
    "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
    "Multi_Headings\tNo", "X_Columns\tOne", "Time_Pref\tRelative", "Operator\tlab", "Date\t2026/11/21",
    "Time\t14:03:02.5123456789", "***End_of_Header***\t", "\t", "Channels\t3\t\t\t", "Samples\t240\t240\t240\t",
    "Date\t2026/11/21\t2026/11/21\t2026/11/21\t", "Time\t14:03:02.5\t14:03:02.5\t14:03:02.5\t",
    "Y_Unit_Label\tdegC\tOhm\tA\t", "X_Dimension\tTime\tTime\tTime\t",
    "X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t",
    "Delta_X\t0.500000\t0.500000\t0.500000\t", "***End_of_Header***\t\t\t\t",
    "X_Value\tTemperature\tResistance\tCurrent\tComment",
]  # fmt: skip
SCANNER_HEAD = [
    "Data for:,film 12", "Owner:,lab", "Comments:,", "Acquisition Date:,11/21/2026 2:03:02 PM", "",
    "Instrument:,34970A,Address:,GPIB0::9::INSTR,,", "Total Channels:,2", "", "Scan,Time,101 (C),102 (OHM)",
]  # fmt: skip
TABLES: tuple[Callable[[Truth], Way], ...] = (
    table("our own names", "record.csv", (TIME, CELSIUS, OHM, AMPERE),
          ["time_s,temperature_degC,resistance_ohm,current_A"]),
    table("pandas, a DatetimeIndex", "frame.csv", (CELSIUS, OHM), ["timestamp,temperature_C,resistance_ohm"],
          clock=[lambda s, t, k: s.isoformat(" ", "microseconds")]),
    table("numpy.savetxt", "run7.txt", [finest("time_s", "as ours"), finest("temperature_degC", "K"),
          finest("resistance_ohm", "as ours")], ["# t_s T_K R_ohm"], " "),
    table("MATLAB writematrix: no header", "data.csv", (TIME, CELSIUS, OHM), [], units=PLAIN),
    table("Fortran, D exponents, names in a comment", "film12.out", [finest("time_s", "as ours", ".6E"),
          finest("temperature_degC", "K", ".6E"), finest("resistance_ohm", "as ours", ".6E")],
          ["! film 12, second cool-down", "! time [s]   T [K]   R [Ohm]"], "   ", row="   {}",
          change=lambda texts: [text.replace("E", "D") for text in texts]),
    table("LabVIEW .lvm", "test_001.lvm", (("time_s", "as ours", ".6f"), CELSIUS, OHM, AMPERE), LVM_HEAD, "\t",
          row="{}\t", end="\r\n"),
    table("LabVIEW Write To Spreadsheet: no header, decimal comma", "Messung.xls.txt",
          (TIME, CELSIUS, ("resistance_ohm", "as ours", ".3f")), [], "\t", change=comma, end="\r\n", units=PLAIN),
    table("Excel, German, cp1252", "Messung 3.csv", (TIME, CENTI, KOHM, AMPERE),
          ["Zeit [s];Temperatur [°C];Widerstand [kOhm];Strom [A]"], ";", change=comma, encoding="cp1252", end="\r\n"),
    table("Excel, French, UTF-8 with BOM", "relevé.csv", (TIME, CENTI, ("resistance_ohm", "as ours", ".1f"), MA),
          ["Temps (s);Température (°C);Résistance (Ω);Courant (mA)"], ";", change=comma,
          encoding="utf-8-sig", end="\r\n"),
    table("Excel, US, thousands separators in quotes", "Book1.csv",
          (TIME, CELSIUS, ("resistance_ohm", "as ours", ".2f")),
          ["Time (s),Temperature (C),Resistance (ohms)"], change=thousands, end="\r\n"),
    table("Excel's Unicode text: UTF-16, tabs", "Book1.txt",
          (("time_s", "min", ".5f"), KELVIN, ("resistance_ohm", "kohm", ".5f")), ["Time [min]\tT [K]\tR [kΩ]"], "\t",
          encoding="utf-16", end="\r\n"),
    table("Igor Text", "waves.itx", (TIME, KELVIN, OHM), ["IGOR", "WAVES/D\tt_s\tT_K\tR_ohm", "BEGIN"], "\t",
          row="\t{}", tail=["END", 'X SetScale/P x 0,1,"", t_s; SetScale y 0,0,"", t_s', 'X SetScale/P x 0,1,"", T_K'],
          end="\r"),
    table("Origin: long names, units, comments", "Graph2.dat", (TIME, KELVIN, ("resistance_ohm", "as ours", ".5g")),
          ["Time\tTemperature\tResistance", "sec\tK\tOhm", "\tCernox\t4-wire"], "\t", end="\r\n"),
    table("QCoDeS .dat", "data.dat", [finest("time_s", "as ours", ".12g"), finest("temperature_degC", "K", ".12g"),
          finest("resistance_ohm", "as ours", ".12g")],
          ["# time\ttemperature\tresistance", '# "Time (s)"\t"Temperature (K)"\t"Resistance (Ohm)"', "# 240"], "\t"),
    table("a chart recorder's US dates over noon", "chart.csv", (KELVIN, KOHM),
          ["Date/Time,Input A (K),Sensor B (kOhm)"],
          clock=[lambda s, t, k: f"{s.month}/{s.day}/{s.year} {s:%I:%M:%S %p}"],
          start=datetime(2026, 11, 21, 11, 57, 0), step_s=2.0, end="\r\n"),
    table("a Bluesky table: seconds since 1970, no units", "scan_42.csv", (CELSIUS, OHM),
          ["seq_num,time,thermo_temperature,dmm_resistance"],
          clock=[NUMBER, lambda s, t, k: f"{1795269782.25 + t:.6f}"], units=PLAIN),
    table("a scanner's UTF-16, a colon before the ms", "Data 1.csv", (CELSIUS, OHM), SCANNER_HEAD,
          clock=[NUMBER, lambda s, t, k: f"{s:%m/%d/%Y %H:%M:%S}:{s.microsecond // 1000:03d}"],
          encoding="utf-16", end="\r\n"),
    table("a TEC controller's log, German", "LOG_1.csv",
          (CELSIUS, ("sink_degC", "as ours", ".2f"), ("current_A", "as ours", ".3f")),
          ["Time;Object Temperature [°C];Sink Temperature [°C];Actual Output Current [A];Device Status"], ";",
          clock=[lambda s, t, k: f"{s:%d.%m.%Y %H:%M:%S},{s.microsecond // 1000:03d}"], change=comma, row="{};Run",
          encoding="utf-8-sig", end="\r\n"),
    table("quantities over units: t / min", "Versuch.txt", (MINUTES, CELSIUS, KOHM, MA),
          ["t / min\tϑ / °C\tR / kΩ\tI / mA"], "\t"),
    table("degrees Fahrenheit, elapsed h:mm:ss", "omega.csv", (("temperature_degC", "degF", ".2f"), OHM),
          ["Elapsed,Temp (°F),Res (ohm)"],
          clock=[lambda s, t, k: f"{int(t // 3600)}:{int(t % 3600 // 60):02d}:{t % 60:04.1f}"]),
    table("a clock, over midnight", "night.csv", (CELSIUS, OHM), ["Time,T_C,R_ohm"], clock=[TENTH],
          start=datetime(2026, 11, 21, 23, 59, 12)),
    table("German dates, 123.456,78", "Export.csv", (CENTI, ("resistance_ohm", "as ours", ".2f")),
          ["Datum/Uhrzeit;Temperatur (°C);Widerstand (Ohm)"], ";", change=dotted, encoding="cp1252", end="\r\n",
          clock=[lambda s, t, k: f"{s:%d.%m.%Y %H:%M:%S},{s.microsecond // 100000}"]),
    table("date and time apart, 03/04/2026 into 04/04", "log.csv", (CENTI, ("resistance_ohm", "as ours", ".1f")),
          ["Date,Time,Temp(C),Resistance(ohm)"],
          clock=[lambda s, t, k: f"{s:%d/%m/%Y}", lambda s, t, k: f"{s:%H:%M:%S}"],
          start=datetime(2026, 4, 3, 23, 57, 30), step_s=2.0, units="time_s=dmy"),
    table("conductance in microsiemens", "G.csv", (TIME, KELVIN, ("resistance_ohm", "uS", ".6g")),
          ["Time (s),Temperature (K),Conductance (µS)"], units="resistance_ohm=uS"),
    table("resistance that is called conductance", "R.csv",
          (("time_s", "ms", ".0f"), KELVIN, ("resistance_ohm", "as ours", ".2f")),
          ["Time (ms),Temperature (K),Conductance (Ohm)"], units="resistance_ohm=ohm"),
    table("kelvin under the name of degC", "film.csv", (TIME, KELVIN, OHM), ["time_s,temperature_degC,resistance_ohm"],
          units="temperature_degC=K"),
    table("bare names, R in kilohms", "x.csv", (TIME, CELSIUS, KOHM), ["time,temp,R"],
          units="time_s=s temperature_degC=degC resistance_ohm=kohm"),
    table("a Japanese logger, cp932", "data.csv", (TIME, CENTI, KOHM), ["時間(s),温度(℃),抵抗(kΩ)"], encoding="cp932",
          end="\r\n", units="time_s=s temperature_degC=degC resistance_ohm=kohm"),
    table("log10 of the resistance, two spaces", "loop.txt", (TIME, CENTI, ("resistance_ohm", "log10ohm", ".5f")),
          ["t (s)  T (°C)  log10(R/Ohm)"], "  ", units="resistance_ohm=log10ohm"),
    table("ISO times with a zone, comments", "telegraf.csv",
          (CELSIUS, ("resistance_ohm", "Mohm", ".8f"), ("current_A", "mA", ".2f")),
          ["# plate 3, film 12", "#", "time,T [degC],R [MOhm],I [mA]"],
          clock=[lambda s, t, k: s.replace(tzinfo=timezone(timedelta(hours=1))).isoformat(timespec="milliseconds")]),
)  # fmt: skip


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


def pid_log(truth: Truth) -> Way:
    share = Truth(truth.time_s, truth.temperature_degC, truth.resistance_ohm, truth.current_A / 4.0, truth.sink_degC)
    fields, expected = columns_of(share, (TIME, CELSIUS, ("current_A", "percent", ".2f")))
    setpoint = [f"{25.0 + 10.0 * (k // 60):.1f}" for k in range(len(fields[0]))]
    lines = ["Time (s),PV (degC),SP (degC),Output (%)", *lines_of([*fields[:2], setpoint, fields[2]], ",")]
    units = {"current_A": "percent"}
    return Way("a PID controller's log, output in percent", "pid.csv", encoded(lines), expected, units, drive=True)


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


WAYS: tuple[Callable[[Truth], Way], ...] = (
    *TABLES, r_frame, quantum_design, bench_meter, midi_logger, hand_meter, pid_log, restarted, workbook,
    workbook_dates, matlab,
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
