"""A table in LabVIEW's measurement file (.lvm): segments of channels, each below a header of its own.

National Instruments' specification, and files that LabVIEW wrote: a column Comment has a name and no field in the rows;
times are in one column (X_Columns One), before each channel (Multi), or given by X0 and Delta_X alone (No); the times
of a further segment may begin again, at the date in its header.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.numbers import DecimalSign, parse_number, tidy_number
from rig.records.table import Column, Table

FIRST_LINE = "LabVIEW Measurement"
END, START_SPECIAL, END_SPECIAL = "***End_of_Header***", "***Start_Special***", "***End_Special***"
SEGMENT_TAGS = frozenset(
    ("Channels", "Samples", "Date", "Time", "Notes", "Y_Unit_Label", "X_Dimension", "X0", "Delta_X", "Test_Name")
)
SAME_S = 1e-9  # times that differ by less are the same


@dataclass
class Segment:
    """A segment: the fields of its header by their first word, names with Comment, rows and their lines."""

    tags: dict[str, list[str]]
    names: list[str] = field(default_factory=list)
    place: int = 0
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    def of_channels(self, tag: str, channels: int, every: int) -> list[str]:
        """Return a header's field of each channel; with times before each it may stand in every second field."""
        fields = self.tags.get(tag, [])
        filled = [text for text in fields if text]
        found = filled if len(filled) == channels else fields[::every][:channels]
        return found + [""] * (channels - len(found))

    def began(self) -> datetime | None:
        """Return the date and time in the header; None if there is none."""
        day, clock = (next(filter(None, self.tags.get(tag, [])), "") for tag in ("Date", "Time"))
        seconds, _, fraction = clock.replace(",", ".").partition(".")
        try:
            return datetime.fromisoformat(f"{day.replace('/', '-')} {seconds}.{(fraction + '000000')[:6]}")
        except ValueError:
            return None


def is_lvm(text: str) -> bool:
    """Return True if the first line says that a text is such a file."""
    return text.startswith(FIRST_LINE)


def lvm_table(text: str, path: Path) -> Table:
    """Return the table in a text: the segments with the channels of the first. Raises Faults."""
    lines = text.splitlines()
    end = next((k for k, line in enumerate(lines) if line.startswith(END)), None)
    if end is None:
        raise fault(path, f"line {len(lines)}", f"a LabVIEW file without {END}; expected a whole file")
    header = {
        line.replace(",", "\t", 1).split("\t")[0]: re.split("[\t,]", line, maxsplit=1)[-1] for line in lines[:end]
    }
    separator = "," if header.get("Separator", "").lower().startswith("comma") else "\t"
    decimal = (header.get("Decimal_Separator", "") + ".")[0]
    x_columns = header.get("X_Columns", "One").strip().capitalize()
    segments = [one for one in _segments(lines, end + 1, separator) if one.rows]
    if not segments:
        raise fault(path, f"line {len(lines)}", "names, and no row of numbers below them; expected rows")
    same = [one for one in segments if one.names == segments[0].names]
    table = _joined(same, path, decimal, x_columns)
    if len(same) < len(segments):
        table.notes.append(f"{len(segments) - len(same)} segments with other channels left out")
    return table


def _segments(lines: Sequence[str], start: int, separator: str) -> list[Segment]:
    """Return the segments without LabVIEW's special blocks."""
    found: list[Segment] = []
    tags: dict[str, list[str]] = {}
    special, named = False, False
    for k in range(start, len(lines)):
        word, *fields = [text.strip() for text in lines[k].split(separator)]
        if special or word == START_SPECIAL or not (word or any(fields)):
            special = (special or word == START_SPECIAL) and word != END_SPECIAL
        elif word == END:
            found.append(Segment(tags))
            tags, named = {}, False
        elif word in SEGMENT_TAGS or not found:
            tags[word] = fields
        elif not named:
            found[-1].names, found[-1].place, named = [word, *fields], k + 1, True
        else:
            found[-1].rows.append([word, *fields])
            found[-1].lines.append(k + 1)
    return found


def _joined(segments: Sequence[Segment], path: Path, decimal: str, x_columns: str) -> Table:
    """Return segments of the same channels below each other. Raises Faults."""
    first, every = segments[0], 2 if x_columns == "Multi" else 1
    names = list(first.names)
    while names and names[-1] in ("Comment", ""):
        names.pop()
    channels = range(1, len(names), every)
    units = first.of_channels("Y_Unit_Label", len(channels), every)
    rows = [row + [""] * (len(names) - len(row)) for segment in segments for row in segment.rows]
    notes = ["LabVIEW measurement file" + (f" of {len(segments)} segments" if len(segments) > 1 else "")]
    columns = [Column(names[k], [row[k] for row in rows], unit) for k, unit in zip(channels, units, strict=True)]
    placed = range(0, len(names), 2) if every == 2 else [0]
    times = [_times(segments, None if x_columns == "No" else k, every, decimal, path) for k in placed]
    ours = [column.meaning.ours for column in columns]
    main = ours.index("temperature_degC") if every == 2 and "temperature_degC" in ours else 0
    timed = any("Time" in text for text in first.tags.get("X_Dimension", ["Time"]))
    columns.insert(0, Column("Time (s)" if timed else "X_Value", times[main]))
    for k, own in enumerate(times if every == 2 else []):
        off_s = float(np.nanmax(np.abs(own - times[main]), initial=0.0))
        if off_s > SAME_S and ours[k] == "resistance_ohm":
            columns.append(Column("resistance_time_s", own))
        elif off_s > SAME_S:
            notes.append(f"{columns[k + 1].name!r} at the times of {columns[main + 1].name!r}, {off_s:.3g} s off")
    comments = [" ".join(row[len(names) :]).strip() for row in rows]
    if any(comments):
        columns.append(Column("Comment", comments))
    lines = [line for segment in segments for line in segment.lines]
    return Table(
        str(path), f"line {first.place}", columns, lines, decimal=DecimalSign(decimal, False, True), notes=notes
    )


def _times(segments: Sequence[Segment], k: int | None, every: int, decimal: str, path: Path) -> Array:
    """Return the times of all rows, s, from column k, or from the headers. Raises Faults if a segment begins before the
    end of the one before."""
    found: list[Array] = []
    began = segments[0].began()
    for number, segment in enumerate(segments):
        own = _segment_times(segment, k, every, decimal, path)
        last, begin = (float(found[-1][-1]) if found else -np.inf), segment.began()
        if number and not own[0] > last and begin is not None and began is not None:
            own = own + (begin - began).total_seconds()  # they count from the header's date
        if number and not own[0] > last:
            text = f"segment {number + 1} begins at {own[0]:g} s, and the one before ends at {last:g} s"
            raise fault(path, f"line {segment.lines[0]}", f"{text}: expected each as a file of its own")
        found.append(own)
    return np.concatenate(found)


def _segment_times(segment: Segment, k: int | None, every: int, decimal: str, path: Path) -> Array:
    """Return the times of a segment's rows, or of its header if the rows have none."""

    def number(text: str, line: int, what: str) -> float:
        try:
            return parse_number(tidy_number(text), decimal)
        except ValueError:
            raise fault(path, f"line {line}", f"{what}: {text[:40]!r}: expected a number") from None

    texts = [row[k] if k is not None and len(row) > k else "" for row in segment.rows]
    if any(texts):
        pairs = zip(texts, segment.lines, strict=True)
        return np.array([number(text, line, "X_Value") if text else np.nan for text, line in pairs])
    line = max(segment.place - 1, 1)
    steps = {number(text, line, "Delta_X") for text in segment.tags.get("Delta_X", ["1"]) if text}
    if len(steps) != 1:
        shown = " and ".join(f"{step:g} s" for step in sorted(steps)) or "none"
        text = f"Delta_X: {shown}, and no times in the rows; expected one interval, or X_Columns One"
        raise fault(path, f"line {line}", text)
    zero = segment.of_channels("X0", 1, every)[0]
    start = number(zero, line, "X0") if zero else 0.0
    return start + steps.pop() * np.arange(len(segment.rows), dtype=np.float64)
