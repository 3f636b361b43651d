"""A record in memory: columns by name, with units in the names."""

from __future__ import annotations

import hashlib
import math
import pickle
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.film_output import RISING_RESISTANCE, column_of, in_decades, is_negative, unit_of
from rig.records.thermometer_faults import FalseReadings, describe_false_readings, find_false_readings, mask_readings

__all__ = ["Record", "Refused", "content_digest", "unit_of"]


@dataclass(frozen=True)
class Refused:
    """A file among others that could not be read as a record: its name as given, and a line for each reason."""

    source: str
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Record:
    """Columns of measurements by name.

    Attributes
    ----------
    columns : arrays of shape (rows,), with units in their names
    source : the file, or another name
    drive : the unit of `current_A` if it is a share of full drive ("duty", "percent", "pwm255"), else None
    text_columns : columns of words, by name
    notes : which of the file's columns was taken for which, and what was left out, for people
    left_out : the rows with false temperatures (`rig.records.thermometer_faults`), nan in `temperature_degC`
    raw_temperature_degC : the temperatures with the false ones; None if there are none
    times : "file" if the file has times, "period" if the user typed the time between rows, "rows" if only their order
        is known; no rates are reported for the last two
    """

    columns: dict[str, Array]
    source: str = "record"
    drive: str | None = None
    text_columns: dict[str, list[str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    left_out: tuple[FalseReadings, ...] = ()
    raw_temperature_degC: Array | None = None
    times: str = "file"

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with all columns. Raises Faults if pandas is not installed."""
        try:
            from pandas import DataFrame
        except ImportError:
            text = "is not installed; `pip install pandas` has it, and the columns are arrays in record.columns"
            raise fault("to_frame", "pandas", text) from None
        return DataFrame({**self.columns, **self.text_columns})

    def __repr__(self) -> str:
        """Return a line for the record and one for each column, with its range."""
        lines = [f"Record of {self.source}: {self.rows} rows"]
        for name, values in self.columns.items():
            read = np.asarray(values, dtype=np.float64)
            read = read[np.isfinite(read)]
            span = f"{read.min():.6g} to {read.max():.6g}" if read.size else "no readings"
            few = f", {read.size} readings" if 0 < read.size < self.rows else ""
            lines.append(f"  {name}: {span}{few}")
        lines += [f"  {name}: text" for name in self.text_columns]
        if self.drive is not None:
            lines.append(f"  current_A is a share of full drive ({self.drive})")
        return "\n".join(lines)

    @property
    def rows(self) -> int:
        """The number of rows."""
        return int(self.columns["time_s"].size)

    def has(self, name: str) -> bool:
        """Return True if the record has a column with at least one finite value."""
        return name in self.columns and bool(np.any(np.isfinite(self.columns[name])))

    def has_output(self, name: str = "minus_log10_ohm") -> bool:
        """Return True if the record has the film's output."""
        return self.has(column_of(name, self.columns))

    def left_out_lines(self) -> list[str]:
        """Return a sentence for each false value of the thermometer."""
        return describe_false_readings(self.left_out, self["time_s"])

    def left_out_document(self) -> list[dict[str, Any]]:
        return [{"record": self.source, **one.document(self["time_s"])} for one in self.left_out]

    def raw_columns(self) -> dict[str, Array]:
        """Return the columns with all readings of the thermometer, the false ones too."""
        raw = self.raw_temperature_degC
        return self.columns if raw is None else {**self.columns, "temperature_degC": raw}

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def output(self, name: str = "minus_log10_ohm") -> Array:
        """Return the film's output of a name of `rig.records.film_output`; nan if there is no resistance > 0."""
        column = self.columns[column_of(name, self.columns)]
        if not in_decades(name):
            return -column if is_negative(name, self.columns) else column
        good = np.isfinite(column) & (column > 0.0)
        output = np.full(column.size, math.nan)
        output[good] = np.log10(column[good])
        return output if name == RISING_RESISTANCE else -output


def without_false_readings(record: Record) -> Record:
    """Return the record with nan in place of the thermometer's false readings, which are looked for anew."""
    columns = record.raw_columns()
    false = tuple(find_false_readings(columns))
    if not false:
        return replace(record, columns=columns, left_out=(), raw_temperature_degC=None)
    raw = columns["temperature_degC"]
    masked = {**columns, "temperature_degC": mask_readings(raw, false)}
    return replace(record, columns=masked, left_out=false, raw_temperature_degC=raw)


def content_digest(record: Record | Refused) -> str:
    """Return twelve hexadecimal digits of a record's content, whatever its name is; of a refused file its faults'."""
    content = record.faults if isinstance(record, Refused) else (record.columns, record.drive)
    return hashlib.sha256(pickle.dumps(content)).hexdigest()[:12]
