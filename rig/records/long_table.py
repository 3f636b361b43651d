"""Tables with a row for each reading, as buffers of meters and databases are exported: a row for each moment instead.

    Index,Reading,Unit,Channel,Relative Time
    1,26.98,Celsius,101,0.0
    2,305761,Ohm,102,0.4

Of such a table the columns are the channels. What was read later than the temperature keeps its own time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.records.column_names import meaning_of
from rig.records.numbers import read_numbers
from rig.records.table import Column, Table
from rig.records.times import PARTS, read_times, time_like
from rig.records.units import UNITS, spelled

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
    clocks = [clock for k in others if (clock := _clock(table, k)) is not None]
    clocks.sort(key=lambda clock: len(set(clock.stamps)) == 1)  # one that stands still says nothing
    clock = clocks[0] if clocks else None
    moments = _moments(labels, clock, channels)
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
    parted = any(table.columns[k].name.strip().lower() in PARTS for k in others)
    if clock is not None and clock.known and meanings.count("resistance_ohm") == 1 and not parted:
        read = np.asarray(rows[meanings.index("resistance_ohm")])
        seconds = np.where(read < 0, np.nan, clock.seconds[read])
        begin = clock.seconds[moment_of[0]] if clock.dated else 0.0
        if np.any(np.abs(seconds - clock.seconds[moment_of]) > 0.0):
            columns.append(Column("resistance_time_s", seconds - begin))
    lines = [table.line_of[k] for k in moment_of]
    return replace(table, columns=columns, line_of=lines, said=said)


@dataclass(frozen=True, eq=False)
class _Clock:
    """When each row was read. stamps: as the file has it; seconds: nan where these cannot be read; dated: as dates or a
    clock's times, which are counted from the first row; known: so that seconds are seconds."""

    stamps: Sequence[str | float]
    seconds: Array
    dated: bool = False
    known: bool = True


def _clock(table: Table, k: int) -> _Clock | None:
    """A column's times; None where it has none."""
    column = table.columns[k]
    meaning, texts = meaning_of(column.name, column.unit), column.texts
    dated = texts is not None and time_like(next((text for text in texts if text.strip()), ""))
    if meaning.ours != "time_s" and meaning.unit != "s" and not dated:
        return None
    stamps: list[str | float] = [*texts] if texts is not None else np.asarray(column.fields).tolist()
    try:
        if texts is not None and dated:
            return _Clock(stamps, read_times(texts).seconds, True)
        values = read_numbers(texts, table.signs).values if texts is not None else np.asarray(column.fields)
        return _Clock(
            stamps,
            np.asarray(UNITS["s"][meaning.unit or "s"](values), dtype=np.float64),
            known=meaning.unit is not None,
        )
    except (ValueError, KeyError):
        return _Clock(stamps, np.full(len(stamps), np.nan))


def _moments(
    labels: Sequence[tuple[str, ...]], clock: _Clock | None, channels: Sequence[tuple[str, ...]]
) -> list[dict[tuple[str, ...], int]] | None:
    """The rows that belong together, by channel: until one of them comes again, or the next is read much later than
    those of one moment are; where each channel's rows stand together, those with the same time, of several in the order
    in which they stand. None where there is no telling."""
    changes = sum(a != b for a, b in pairwise(labels))
    if changes == len(channels) - 1:
        if clock is None:
            return None
        together: dict[tuple[str | float, int], dict[tuple[str, ...], int]] = {}
        seen: Counter[tuple[str | float, tuple[str, ...]]] = Counter()
        for k, (label, stamp) in enumerate(zip(labels, clock.stamps, strict=True)):
            together.setdefault((stamp, seen[stamp, label]), {})[label] = k
            seen[stamp, label] += 1
        found = list(together.values())
        return found if 2 * sum(len(one) == len(channels) for one in found) > len(found) else None
    begins = _begins(clock, len(labels), len(channels))
    moments: list[dict[tuple[str, ...], int]] = [{}]
    for k, label in enumerate(labels):
        if label in moments[-1] or begins[k]:
            moments.append({})
        moments[-1][label] = k
    return moments


def _begins(clock: _Clock | None, rows: int, channels: int) -> NDArray[np.bool_]:
    """The rows that stand further from the one before than those of one moment do: of `channels` steps one leads to the
    next moment. None where all are alike."""
    begins = np.zeros(rows, dtype=np.bool_)
    if clock is None or rows < 2 * channels or not np.all(np.isfinite(clock.seconds)):
        return begins
    steps = np.abs(np.diff(clock.seconds))
    within, between = np.quantile(steps, [0.5 * (channels - 1) / channels, 1.0 - 0.5 / channels])
    if between > 2.0 * within:
        begins[1:] = steps > 0.5 * (within + between)
    return begins
