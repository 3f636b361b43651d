"""A table as a file or a program holds it: names, units, columns of text or numbers, and the place of each row.

Tables with a row for each reading, as meters' buffers and databases are exported, become tables with a row a moment:

    Index,Reading,Unit,Channel,Relative Time
    1,26.98,Celsius,101,0.0
    2,305761,Ohm,102,0.4

Each channel becomes a column. A resistance that was read later than the temperature keeps its own time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.column_names import Meaning, interpret_name
from rig.records.numbers import UNITS, DecimalSign, Numbers, is_blank, parse_unit, read_numbers, replace_sentinels
from rig.records.times import SECOND_FRACTIONS, is_time, read_times

RowIndices = Sequence[int] | NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Column:
    """A column: name as in the file ('' for none), fields (texts or numbers), unit in the line below the names."""

    name: str
    fields: Sequence[str] | Array
    unit: str = ""

    @property
    def texts(self) -> list[str] | None:
        return self.fields if isinstance(self.fields, list) else None

    @property
    def meaning(self) -> Meaning:
        return interpret_name(self.name, self.unit)

    def select(self, rows: RowIndices) -> Column:
        """Return the column with these rows in this order; row -1 is an empty field."""
        texts = self.texts
        if texts is not None:
            return replace(self, fields=[texts[k] if k >= 0 else "" for k in rows])
        index = np.asarray(rows, dtype=np.intp)
        return replace(self, fields=np.where(index < 0, np.nan, np.asarray(self.fields)[index]))

    def filled(self) -> NDArray[np.bool_]:
        if self.texts is not None:
            return np.array([not is_blank(text) for text in self.texts], dtype=np.bool_)
        return np.isfinite(np.asarray(self.fields, dtype=np.float64))

    def first(self) -> str:
        """Return the first text that is not blank; '' if there is none."""
        return next((text for text in self.texts or () if not is_blank(text)), "")

    def numbers(self, decimal: DecimalSign, ending: str | None = None) -> Numbers:
        """Return the fields as numbers. Raises ValueError as `read_numbers` does."""
        if self.texts is not None:
            return read_numbers(self.texts, decimal, ending)
        return replace_sentinels(np.asarray(self.fields, dtype=np.float64), ending)


@dataclass(frozen=True, eq=False)
class Table:
    """A table with names.

    place: of the names, such as 'line 1'. line_of: the line of each row, for messages; row_word: 'line', or 'row' if
    the file has no lines. named: False if the file has no names. notes: what was read as what, for people. times: where
    they come from: "file", "period" (typed) or "rows" (only their order is known).
    """

    source: str
    place: str
    columns: list[Column]
    line_of: Sequence[int]
    row_word: str = "line"
    named: bool = True
    decimal: DecimalSign = field(default_factory=DecimalSign)
    notes: list[str] = field(default_factory=list)
    times: str = "file"

    def place_of(self, row: int) -> str:
        return f"{self.row_word} {self.line_of[row]}"

    def shown_names(self) -> list[str]:
        """Return the names for messages: '#3' for a third column without a name."""
        return [column.name or f"#{k + 1}" for k, column in enumerate(self.columns)]

    def select(self, rows: RowIndices) -> Table:
        lines = [self.line_of[k] for k in rows]
        return replace(self, columns=[column.select(rows) for column in self.columns], line_of=lines)


def table_from_arrays(columns: Mapping[str, Any], source: str) -> Table:
    """Return a table of arrays by name. Raises Faults: no arrays, of unequal length, or of several dimensions."""
    table = [Column(str(name), _fields(np.asarray(values), str(name), source)) for name, values in columns.items()]
    lengths = {column.name: len(column.fields) for column in table}
    if not table:
        raise fault(source, "", "no columns; expected time_s and what was measured")
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise fault(source, "", f"columns of unequal length: {shown}")
    return Table(source, "", table, range(len(table[0].fields)), row_word="row")


def _fields(values: Any, name: str, source: str) -> Any:
    """Return numbers as float64, dates as text, durations as seconds, all else as text."""
    values = np.squeeze(values) if values.ndim > 1 else values
    if values.ndim != 1:
        raise fault(source, repr(name), f"{values.ndim} dimensions; expected one")
    if values.dtype.kind == "M":
        return ["" if np.isnat(value) else str(value) for value in values.astype("datetime64[us]")]
    if values.dtype.kind == "m":
        return values / np.timedelta64(1, "ns") * 1e-9
    if values.dtype.kind in "biufO":
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError):
            pass
    return ["" if text in ("None", "nan", "NaN", "NaT", "<NA>") else text for text in map(str, values)]


def frame_columns(frame: Any) -> dict[str, Any]:
    """Return the columns of a pandas DataFrame by name, and its index if it holds dates or has a name of its own."""
    columns: dict[str, Any] = {}
    index = getattr(frame, "index", None)
    name = getattr(index, "name", None)
    if index is not None and str(name) not in map(str, frame.columns):
        values = np.asarray(index)
        if values.dtype.kind == "M" or name is not None:
            columns[str(name) if name is not None else "time"] = values
    return columns | {str(name): np.asarray(frame[name]) for name in frame.columns}


VALUE_NAMES = ("reading", "value", "_value", "readings", "measurement", "measured value", "wert", "messwert")
UNIT_NAMES = ("unit", "units", "reading unit", "einheit")
CHANNEL_NAMES = (
    "channel", "ch", "chan", "ch label", "channel label", "channel number", "channel name", "kanal", "label", "name",
    "sensor", "parameter", "variable", "field", "_field", "signal", "metric", "tag", "quantity", "series", "item",
)  # fmt: skip
MOST_CHANNELS = 100  # a column with more labels names no channels
Label = tuple[str, ...]


def pivot_readings(table: Table) -> Table:
    """Return the table with a column for each channel; the table itself if its rows are not single readings."""
    names = [column.name.strip().lower() for column in table.columns]
    filled = [k for k, column in enumerate(table.columns) if np.any(column.filled())]
    value = next((k for name in VALUE_NAMES for k in filled if names[k] == name), None)
    unit = next((k for k in filled if names[k] in UNIT_NAMES and table.columns[k].texts is not None), None)
    keys = [k for k in filled if names[k] in CHANNEL_NAMES]
    meanings = {column.meaning.ours for column in table.columns}
    if value is None or (unit is None and not keys) or {"temperature_degC", "resistance_ohm"} <= meanings:
        return table
    columns = list(table.columns)
    if "relative time" in names and unit is not None:  # Keithley's manuals: in seconds
        k = names.index("relative time")
        columns[k] = replace(columns[k], unit="s")
    # the channel of each row: its labels, and its unit last
    units = _texts(columns[unit]) if unit is not None else [""] * len(table.line_of)
    labels: list[Label] = list(zip(*(_texts(columns[k]) for k in keys), units, strict=True))
    channels = list(dict.fromkeys(labels))
    if len(channels) == 1:  # no other channel: its unit belongs to the column
        columns[value] = replace(columns[value], unit=channels[0][-1])
        return replace(table, columns=columns) if parse_unit(channels[0][-1]) is not None else table
    if len(channels) > MOST_CHANNELS or 2 * len(channels) > len(labels):
        return table
    return _pivot(replace(table, columns=columns), {value, unit, *keys}, columns[value], labels, channels)


def _texts(column: Column) -> Sequence[str]:
    return column.texts if column.texts is not None else [f"{value:g}" for value in np.asarray(column.fields)]


def _pivot(
    table: Table, taken: set[int | None], value: Column, labels: Sequence[Label], channels: Sequence[Label]
) -> Table:
    """Return the table with the values of each channel in a column. taken: the columns of values, units and labels."""
    others = [column for k, column in enumerate(table.columns) if k not in taken]
    clocks = [clock for column in others if (clock := _seconds(column, table)) is not None]
    clocks.sort(key=lambda clock: bool(np.ptp(clock[0]) == 0.0))  # a clock that stands still is the last choice
    seconds, known, dated = clocks[0] if clocks else (None, False, False)
    stacked = sum(a != b for a, b in pairwise(labels)) == len(channels) - 1  # a channel's rows below another's
    moments = _moments(labels, seconds, len(channels), stacked)
    if stacked and 2 * sum(len(one) == len(channels) for one in moments) <= len(moments):  # no time tells them apart
        return table
    named = [(" ".join(channel[:-1]).strip(), channel[-1]) for channel in channels]
    meanings = [interpret_name(name, unit).ours for name, unit in named]
    main = meanings.index("temperature_degC") if "temperature_degC" in meanings else 0
    rows = [[moment.get(channel, -1) for moment in moments] for channel in channels]
    row_of = [next(k for k in (row[main], *row) if k >= 0) for row in zip(*rows, strict=True)]
    columns = [column.select(row_of) for column in others]
    columns += [replace(value.select(own), name=name, unit=unit) for (name, unit), own in zip(named, rows, strict=True)]
    fractions = any(column.name.strip().lower() in SECOND_FRACTIONS for column in others)
    if seconds is not None and known and meanings.count("resistance_ohm") == 1 and not fractions:
        read = np.asarray(rows[meanings.index("resistance_ohm")])
        read_s = np.where(read < 0, np.nan, seconds[read])
        if np.any(np.abs(read_s - seconds[row_of]) > 0.0):
            columns.append(Column("resistance_time_s", read_s - (seconds[row_of[0]] if dated else 0.0)))
    notes = [*table.notes, f"a row for each reading, of {', '.join(repr(name) for name, _ in named)}: taken as columns"]
    return replace(table, columns=columns, line_of=[table.line_of[k] for k in row_of], notes=notes)


def _seconds(column: Column, table: Table) -> tuple[Array, bool, bool] | None:
    """Return a column of times in seconds; True if its unit is known; True if it holds dates or clock times, which
    count from the first row. None if it has no times, or some that cannot be read."""
    meaning, texts = column.meaning, column.texts
    dated = texts is not None and is_time(next((text for text in texts if text.strip()), ""))
    if meaning.ours != "time_s" and meaning.unit != "s" and not dated:
        return None
    try:
        if texts is not None and dated:
            seconds = read_times(texts).seconds
        else:
            seconds = np.asarray(UNITS["s"][meaning.unit or "s"](column.numbers(table.decimal).values))
    except (ValueError, KeyError):
        return None
    return (seconds, dated or meaning.unit is not None, dated) if np.all(np.isfinite(seconds)) else None


def _moments(labels: Sequence[Label], seconds: Array | None, channels: int, stacked: bool) -> list[dict[Label, int]]:
    """Return the rows of each moment by channel.

    A moment ends when a channel comes again, or if a row is much later than the one before. Rows of channels that are
    stacked are put in the order of time before: of those with the same time a channel's first belongs with the first of
    the others.
    """
    order = list(range(len(labels)))
    if stacked and seconds is not None:
        again: Counter[tuple[float, Label]] = Counter()
        keys = []
        for key in zip(seconds.tolist(), labels, strict=True):
            keys.append((key[0], again[key]))
            again[key] += 1
        order.sort(key=keys.__getitem__)
    late = _late_rows(seconds[order] if seconds is not None else None, channels)
    moments: list[dict[Label, int]] = [{}]
    for place, k in enumerate(order):
        if labels[k] in moments[-1] or (late is not None and late[place]):
            moments.append({})
        moments[-1][labels[k]] = k
    return moments


def _late_rows(seconds: Array | None, channels: int) -> NDArray[np.bool_] | None:
    """Return the rows that come later after the one before than rows of one moment do: one step in `channels`."""
    if seconds is None or seconds.size < 2 * channels:
        return None
    steps = np.diff(seconds, prepend=seconds[0])
    within, between = np.quantile(steps[1:], [0.5 * (channels - 1) / channels, 1.0 - 0.5 / channels])
    return np.asarray(steps > 0.5 * (within + between)) if between > 2.0 * within else None
