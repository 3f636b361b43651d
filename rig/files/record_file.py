"""Records: a CSV file with one header line, units in the names, columns in any order; more columns are kept.

A record from elsewhere has other names and units: `--column OURS=THEIRS[@UNIT]`. Comma-, semicolon- and
tab-separated files are read; an empty field is nan, `inf` in resistance_ohm an overrange.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np

from compensator.functions import Array
from rig.faults import Faults, fault

KNOWN = (
    "time_s",
    "temperature_degC",
    "resistance_ohm",
    "current_A",
    "meter_current_A",
    "resistance_time_s",
    "setpoint_degC",
    "target_ohm",
    "ambient_degC",
    "sink_degC",
)

UNITS: Mapping[str, Mapping[str, Callable[[Array], Array]]] = {
    "s": {
        "s": lambda x: x,
        "ms": lambda x: x * 1e-3,
        "min": lambda x: x * 60.0,
        "h": lambda x: x * 3600.0,
    },
    "degC": {
        "degC": lambda x: x,
        "K": lambda x: x - 273.15,
        "degF": lambda x: (x - 32.0) / 1.8,
    },
    "ohm": {
        "ohm": lambda x: x,
        "mohm": lambda x: x * 1e-3,
        "kohm": lambda x: x * 1e3,
        "Mohm": lambda x: x * 1e6,
        "log10ohm": lambda x: 10.0**x,
    },
    "A": {
        "A": lambda x: x,
        "mA": lambda x: x * 1e-3,
        "uA": lambda x: x * 1e-6,
        "duty": lambda x: x,
        "percent": lambda x: x / 100.0,
        "pwm255": lambda x: x / 255.0,
    },
}


@dataclass(frozen=True)
class ColumnMapping:
    """OURS=THEIRS[@UNIT]: where one of our columns comes from, and in which unit it is there."""

    ours: str
    theirs: str
    unit: str

    @classmethod
    def parse(cls, text: str) -> ColumnMapping:
        ours, equals, rest = text.partition("=")
        if not equals or not ours or not rest:
            raise fault("--column", repr(text), "expected OURS=THEIRS[@UNIT], as in temperature_degC=T_K@K")
        quantity = ours.rpartition("_")[2]
        theirs, _, unit = rest.rpartition("@") if "@" in rest else (rest, "", quantity)
        if ours in KNOWN:
            if unit not in UNITS[quantity]:
                known = ", ".join(UNITS[quantity])
                raise fault("--column", repr(text), f"unit {unit!r} is none of {known}")
        elif "@" in rest:
            raise fault("--column", repr(text), f"{ours!r} is none of {', '.join(KNOWN)}, so it has no unit to convert")
        return cls(ours, theirs, unit)


@dataclass(frozen=True, eq=False)
class Record:
    """Columns by name, each of the shape (rows,); `drive` tells that current_A is a share of full drive."""

    columns: dict[str, Array]
    source: str = "record"
    drive: str | None = None
    text_columns: dict[str, list[str]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        return int(self.columns["time_s"].size)

    def has(self, name: str) -> bool:
        """Whether a column is there and holds at least one finite value."""
        return name in self.columns and bool(np.any(np.isfinite(self.columns[name])))

    def has_output(self, name: str = "minus_log10_ohm") -> bool:
        """Whether the film's output is there."""
        return self.has("resistance_ohm" if name == "minus_log10_ohm" else name)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def output(self, name: str = "minus_log10_ohm") -> Array:
        """The film's output: -log10(R / 1 ohm), nan where there is no finite reading > 0; or a column of that name."""
        if name != "minus_log10_ohm":
            return self.columns[name]
        resistance = self.columns["resistance_ohm"]
        good = np.isfinite(resistance) & (resistance > 0.0)
        output = np.full(resistance.size, math.nan)
        output[good] = -np.log10(resistance[good])
        return output


def read_record(path: Path, mappings: Iterable[ColumnMapping] = (), needs: Iterable[str] = ()) -> Record:
    """Read a record. Raises Faults: a missing column, a field that is no number, time that does not increase."""
    try:
        if path.is_char_device():  # /dev/zero has no end
            raise fault(path, "", "is a device; expected a file")
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else f"byte {error.start}: expected UTF-8"
        raise fault(path, "", f"cannot be read as text: {why}") from None
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")]
    if not lines:
        raise fault(path, "line 1", "expected a header line with column names, the file is empty")
    header_line = lines[0][1]
    delimiter = max("\t;,", key=header_line.count)
    header = [name.strip() for name in _fields(path, [header_line], delimiter)[0]]
    faults = [
        f"{path}: line {lines[0][0]}: column {name!r} appears twice" for name in set(header) if header.count(name) > 1
    ]
    mapping = {m.theirs: m for m in mappings}
    faults += [
        f"{path}: line {lines[0][0]}: no column {m.theirs!r} for {m.ours}; there are {', '.join(header)}"
        for m in mapping.values()
        if m.theirs not in header
    ]
    names = [mapping[name].ours if name in mapping else name for name in header]
    for name in ("time_s", *needs):
        if name not in names and not any(m.ours == name for m in mapping.values()):
            faults.append(f"{path}: line {lines[0][0]}: column {name!r} missing; there are {', '.join(header)}")
    if faults:
        raise Faults(faults)
    rows = _fields(path, io.StringIO("\n".join(line for _, line in lines[1:])), delimiter)
    values: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    for k, row in enumerate(rows):
        if len(row) != len(header) and len(faults) < 20:
            faults.append(f"{path}: line {lines[k + 1][0]}: {len(row)} fields, expected {len(header)}")
    if faults:
        raise Faults(faults)
    for column, (their_name, our_name) in enumerate(zip(header, names, strict=True)):
        fields = [row[column].strip() for row in rows]
        try:
            array = np.array([float(text) if text else math.nan for text in fields])
        except ValueError:
            if our_name in KNOWN:
                for k, text in enumerate(fields):
                    if not _is_number(text) and len(faults) < 5:
                        hint = " with a point" if re.fullmatch(r"[-+]?\d+,\d+", text) else ""
                        faults.append(f"{path}: line {lines[k + 1][0]}: {our_name}: {text!r}: expected a number{hint}")
                more = sum(not _is_number(text) for text in fields) - len(faults)
                if more > 0:
                    faults.append(f"{path}: {our_name}: and {more} more fields that are no numbers")
            texts[our_name] = fields
            continue
        unit = mapping[their_name].unit if their_name in mapping else None
        quantity = our_name.rpartition("_")[2]
        values[our_name] = UNITS[quantity][unit](array) if unit and our_name in KNOWN else array
    if not faults:
        faults = _faults_in(values, path, lines)
    if faults:
        raise Faults(faults)
    current = next((m for m in mapping.values() if m.ours == "current_A"), None)
    drive = current.unit if current and current.unit in ("duty", "percent", "pwm255") else None
    return Record(values, str(path), drive, texts)


def _fields(path: Path, lines: Iterable[str], delimiter: str) -> list[list[str]]:
    """Each line's fields. Raises Faults."""
    try:
        return list(csv.reader(lines, delimiter=delimiter))
    except csv.Error as error:
        raise fault(path, "", f"is no table: {error}") from None


def unit_of(output: str) -> str:
    """The unit of a film's output, for people and for keys: decades of a resistance, else what the name ends in."""
    return "dec" if output == "minus_log10_ohm" else output.partition("_")[2] or "1"


def _is_number(text: str) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True


def _faults_in(values: dict[str, Array], path: Path, lines: list[tuple[int, str]]) -> list[str]:
    faults = []
    time = values["time_s"]
    if time.size < 2:
        return [f"{path}: {time.size} rows: expected at least 2"]
    for k in np.flatnonzero(~np.isfinite(time))[:5]:
        faults.append(f"{path}: line {lines[k + 1][0]}: time_s: expected a finite number")
    for k in np.flatnonzero(np.diff(time) <= 0.0)[:5]:
        after = f"{float(time[k + 1])!r} after {float(time[k])!r}"
        faults.append(f"{path}: line {lines[k + 2][0]}: time_s: {after}: expected increasing times")
    resistance = values.get("resistance_ohm")
    if resistance is not None:
        for k in np.flatnonzero(resistance <= 0.0)[:5]:
            faults.append(f"{path}: line {lines[k + 1][0]}: resistance_ohm: {float(resistance[k])!r}: expected > 0")
    return faults


def write_columns(path: Path, columns: Mapping[str, Array | list[str]]) -> None:
    """Write columns as a CSV file; numbers read back to the same bits, nan becomes an empty field."""
    with path.open("w", encoding="utf-8", newline="") as file:
        print_columns(file, columns)


def print_columns(file: TextIO, columns: Mapping[str, Array | list[str]]) -> None:
    """The same into an open file."""
    names = list(columns)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    for row in zip(*(columns[name] for name in names), strict=True):
        writer.writerow([_shown(value) for value in row])


def _shown(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    number = float(value)  # type: ignore[arg-type]
    return "" if math.isnan(number) else repr(number)
