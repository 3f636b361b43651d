"""Tables with a row for each reading, as buffers of meters and databases are exported: a row for each moment instead.

    Index,Reading,Unit,Channel,Relative Time
    1,26.98,Celsius,101,0.0
    2,305761,Ohm,102,0.4

Of such a table the columns are the channels. What was read later than the temperature keeps its own time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from rig.files.column_meaning import meaning_of
from rig.files.field_numbers import read_numbers
from rig.files.field_times import time_like
from rig.files.table import Column, Table
from rig.files.units import spelled

VALUE = ("reading", "value", "_value", "readings", "measurement", "measured value", "wert", "messwert")
UNIT = ("unit", "units", "reading unit", "einheit")
CHANNEL = (
    "channel", "ch", "chan", "ch label", "channel label", "channel number", "channel name", "kanal", "label", "name",
    "sensor", "parameter", "variable", "field", "_field", "signal", "metric", "tag", "quantity", "series", "item",
)  # fmt: skip
MOST_CHANNELS = 100  # of more labels none is a channel's


def one_row_each_moment(table: Table) -> Table:
    """The table with a column for each channel; the same where it has no row for each reading."""
    names = [column.name.strip().lower() for column in table.columns]
    values = [k for wanted in VALUE for k, name in enumerate(names) if name == wanted]
    value = next((k for k in values if np.any(table.columns[k].filled())), None)
    unit = next((k for k, name in enumerate(names) if name in UNIT and table.columns[k].texts is not None), None)
    keys = [k for k, name in enumerate(names) if name in CHANNEL and np.any(table.columns[k].filled())]
    meanings = {meaning_of(column.name, column.unit).ours for column in table.columns}
    if value is None or (unit is None and not keys) or {"temperature_degC", "resistance_ohm"} <= meanings:
        return table
    if "relative time" in names and unit is not None:  # Keithley's manuals: in seconds
        k = names.index("relative time")
        seconds = replace(table.columns[k], unit="s")
        table = replace(table, columns=[*table.columns[:k], seconds, *table.columns[k + 1 :]])
    labels = _labels(table, [*keys, *([unit] if unit is not None else [])])
    channels = list(dict.fromkeys(labels))
    if len(channels) == 1:
        said = channels[0][-1] if unit is not None else ""
        if spelled(said) is None:
            return table
        columns = list(table.columns)
        columns[value] = replace(columns[value], unit=said)
        return replace(table, columns=columns)
    if len(channels) > MOST_CHANNELS or 2 * len(channels) > len(labels):
        return table
    return _turned_to_columns(table, value, unit, keys, labels, channels)


def _labels(table: Table, indices: Sequence[int]) -> list[tuple[str, ...]]:
    """Of each row, what its reading is of; the unit last."""
    fields = []
    for k in indices:
        column = table.columns[k]
        fields.append(column.texts if column.texts is not None else [f"{v:g}" for v in np.asarray(column.fields)])
    return list(zip(*fields, strict=True))


def _turned_to_columns(
    table: Table,
    value: int,
    unit: int | None,
    keys: Sequence[int],
    labels: Sequence[tuple[str, ...]],
    channels: Sequence[tuple[str, ...]],
) -> Table:
    others = [k for k in range(len(table.columns)) if k not in (value, unit, *keys)]
    moments = _moments(labels, _stamps(table, others), channels)
    if moments is None:
        return table
    named = [
        (" ".join(one[:-1] if unit is not None else one).strip(), one[-1] if unit is not None else "")
        for one in channels
    ]
    meanings = [meaning_of(name, below).ours for name, below in named]
    main = meanings.index("temperature_degC") if "temperature_degC" in meanings else 0
    rows = [[moment.get(channel, -1) for moment in moments] for channel in channels]
    moment_of = [next(k for k in (row[main], *row) if k >= 0) for row in zip(*rows, strict=True)]
    columns = [table.columns[k].of(moment_of) for k in others]
    for (name, below), own in zip(named, rows, strict=True):
        columns.append(replace(table.columns[value].of(own), name=name, unit=below))
    said = [*table.said, f"a row for each reading, of {', '.join(repr(name) for name, _ in named)}: taken as columns"]
    clock = next((k for k in others if meaning_of(table.columns[k].name, table.columns[k].unit).unit == "s"), None)
    if clock is not None and meanings.count("resistance_ohm") == 1:
        column = table.columns[clock]
        try:
            seconds = read_numbers(column.texts, table.signs).values if column.texts is not None else column.fields
        except ValueError:
            seconds = None
        if seconds is not None:
            times = Column("resistance_time_s", np.asarray(seconds))
            columns.append(times.of(rows[meanings.index("resistance_ohm")]))
    lines = [table.line_of[k] for k in moment_of]
    return replace(table, columns=columns, line_of=lines, said=said)


def _stamps(table: Table, indices: Sequence[int]) -> list[str] | None:
    """The column of times, as text."""
    for k in indices:
        column = table.columns[k]
        if column.texts and (meaning_of(column.name, column.unit).ours == "time_s" or time_like(column.texts[0])):
            return column.texts
    return None


def _moments(
    labels: Sequence[tuple[str, ...]], stamps: Sequence[str] | None, channels: Sequence[tuple[str, ...]]
) -> list[dict[tuple[str, ...], int]] | None:
    """The rows that belong together, by channel: until one of them comes again; where each channel's rows stand
    together, those with the same time. None where there is no telling."""
    changes = sum(a != b for a, b in pairwise(labels))
    if changes == len(channels) - 1:
        if stamps is None:
            return None
        together: dict[str, dict[tuple[str, ...], int]] = {}
        for k, (label, stamp) in enumerate(zip(labels, stamps, strict=True)):
            together.setdefault(stamp, {})[label] = k
        found = list(together.values())
        return found if 2 * sum(len(one) == len(channels) for one in found) > len(found) else None
    moments: list[dict[tuple[str, ...], int]] = [{}]
    for k, label in enumerate(labels):
        if label in moments[-1]:
            moments.append({})
        moments[-1][label] = k
    return moments
