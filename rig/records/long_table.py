"""Tables with a row for each reading, as meters' buffers and databases are exported, as tables with a row a moment.

    Index,Reading,Unit,Channel,Relative Time
    1,26.98,Celsius,101,0.0
    2,305761,Ohm,102,0.4

Each channel becomes a column. A resistance that was read later than the temperature keeps its own time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.records.column_names import interpret_name
from rig.records.table import Column, Table
from rig.records.times import SECOND_FRACTIONS, is_time, read_times
from rig.records.units import UNITS, parse_unit

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
    found = [k for wanted in VALUE_NAMES for k, name in enumerate(names) if name == wanted]
    value = next((k for k in found if np.any(table.columns[k].filled())), None)
    unit = next((k for k, name in enumerate(names) if name in UNIT_NAMES and table.columns[k].texts is not None), None)
    keys = [k for k, name in enumerate(names) if name in CHANNEL_NAMES and np.any(table.columns[k].filled())]
    meanings = {column.meaning.ours for column in table.columns}
    if value is None or (unit is None and not keys) or {"temperature_degC", "resistance_ohm"} <= meanings:
        return table
    columns = list(table.columns)
    if "relative time" in names and unit is not None:  # Keithley's manuals: in seconds
        k = names.index("relative time")
        columns[k] = replace(columns[k], unit="s")
        table = replace(table, columns=columns)
    labels = _labels(table, [*keys, *([unit] if unit is not None else [])])
    channels = list(dict.fromkeys(labels))
    if len(channels) == 1:  # no other channel: its unit belongs to the column
        written = channels[0][-1] if unit is not None else ""
        if parse_unit(written) is None:
            return table
        columns[value] = replace(columns[value], unit=written)
        return replace(table, columns=columns)
    if len(channels) > MOST_CHANNELS or 2 * len(channels) > len(labels):
        return table
    return _pivot(table, value, unit, keys, labels, channels)


def _labels(table: Table, indices: Sequence[int]) -> list[Label]:
    """Return the channel of each row, with the unit last."""
    columns = [table.columns[k] for k in indices]
    texts = (c.texts if c.texts is not None else [f"{v:g}" for v in np.asarray(c.fields)] for c in columns)
    return list(zip(*texts, strict=True))


def _pivot(
    table: Table, value: int, unit: int | None, keys: Sequence[int], labels: Sequence[Label], channels: Sequence[Label]
) -> Table:
    others = [k for k in range(len(table.columns)) if k not in (value, unit, *keys)]
    clocks = [clock for k in others if (clock := _read_clock(table, k)) is not None]
    clocks.sort(key=lambda clock: len(set(clock.stamps)) == 1)  # a clock that stands still is the last choice
    clock = clocks[0] if clocks else None
    moments = _moments(labels, clock, channels)
    if moments is None:
        return table
    named = [(" ".join(c[:-1] if unit is not None else c).strip(), c[-1] if unit is not None else "") for c in channels]
    meanings = [interpret_name(name, below).ours for name, below in named]
    main = meanings.index("temperature_degC") if "temperature_degC" in meanings else 0
    rows = [[moment.get(channel, -1) for moment in moments] for channel in channels]
    row_of = [next(k for k in (row[main], *row) if k >= 0) for row in zip(*rows, strict=True)]
    columns = [table.columns[k].select(row_of) for k in others]
    for (name, below), own in zip(named, rows, strict=True):
        columns.append(replace(table.columns[value].select(own), name=name, unit=below))
    fractions = any(table.columns[k].name.strip().lower() in SECOND_FRACTIONS for k in others)
    if clock is not None and clock.in_seconds and meanings.count("resistance_ohm") == 1 and not fractions:
        read = np.asarray(rows[meanings.index("resistance_ohm")])
        seconds = np.where(read < 0, np.nan, clock.seconds[read])
        if np.any(np.abs(seconds - clock.seconds[row_of]) > 0.0):
            columns.append(Column("resistance_time_s", seconds - (clock.seconds[row_of[0]] if clock.dated else 0.0)))
    notes = [*table.notes, f"a row for each reading, of {', '.join(repr(name) for name, _ in named)}: taken as columns"]
    return replace(table, columns=columns, line_of=[table.line_of[k] for k in row_of], notes=notes)


@dataclass(frozen=True, eq=False)
class _Clock:
    """The times of the rows: as in the file (stamps), and in seconds (nan if unreadable).

    dated: dates or clock times, counted from the first row. in_seconds: the unit is known.
    """

    stamps: Sequence[str | float]
    seconds: Array
    dated: bool = False
    in_seconds: bool = True


def _read_clock(table: Table, k: int) -> _Clock | None:
    column = table.columns[k]
    meaning, texts = column.meaning, column.texts
    dated = texts is not None and is_time(next((text for text in texts if text.strip()), ""))
    if meaning.ours != "time_s" and meaning.unit != "s" and not dated:
        return None
    stamps: list[str | float] = [*texts] if texts is not None else np.asarray(column.fields).tolist()
    try:
        if texts is not None and dated:
            return _Clock(stamps, read_times(texts).seconds, True)
        seconds = UNITS["s"][meaning.unit or "s"](column.numbers(table.decimal).values)
        return _Clock(stamps, np.asarray(seconds, dtype=np.float64), in_seconds=meaning.unit is not None)
    except (ValueError, KeyError):
        return _Clock(stamps, np.full(len(stamps), np.nan))


def _moments(labels: Sequence[Label], clock: _Clock | None, channels: Sequence[Label]) -> list[dict[Label, int]] | None:
    """Return the rows of each moment by channel; None if no time tells them apart.

    A moment ends when a channel comes again or a row is much later than the one before. If each channel's rows stand
    together, rows with the same time belong together.
    """
    if sum(a != b for a, b in pairwise(labels)) == len(channels) - 1:
        if clock is None:
            return None
        together: dict[tuple[str | float, int], dict[Label, int]] = {}
        seen: Counter[tuple[str | float, Label]] = Counter()
        for k, (label, stamp) in enumerate(zip(labels, clock.stamps, strict=True)):
            together.setdefault((stamp, seen[stamp, label]), {})[label] = k
            seen[stamp, label] += 1
        found = list(together.values())
        return found if 2 * sum(len(one) == len(channels) for one in found) > len(found) else None
    late = _late_rows(clock, len(labels), len(channels))
    moments: list[dict[Label, int]] = [{}]
    for k, label in enumerate(labels):
        if label in moments[-1] or late[k]:
            moments.append({})
        moments[-1][label] = k
    return moments


def _late_rows(clock: _Clock | None, rows: int, channels: int) -> NDArray[np.bool_]:
    """Return the rows that come later after the one before than rows of one moment do: one step in `channels`."""
    late = np.zeros(rows, dtype=np.bool_)
    if clock is None or rows < 2 * channels or not np.all(np.isfinite(clock.seconds)):
        return late
    steps = np.abs(np.diff(clock.seconds))
    within, between = np.quantile(steps, [0.5 * (channels - 1) / channels, 1.0 - 0.5 / channels])
    if between > 2.0 * within:
        late[1:] = steps > 0.5 * (within + between)
    return late
