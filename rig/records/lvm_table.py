"""A table in LabVIEW's measurement file (.lvm): segments of channels, each below a header of its own.

National Instruments' specification, and files that LabVIEW wrote: a column Comment has a name and no field in the rows;
times are in one column (X_Columns One), before each channel (Multi), or given by X0 and Delta_X alone (No); the times
of a further segment may begin again, at the date in its header.
"""

from __future__ import annotations

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
SEPARATORS = {"tab": "\t", "comma": ","}
SEGMENT_TAGS = frozenset(
    ("Channels", "Samples", "Date", "Time", "Notes", "Y_Unit_Label", "X_Dimension", "X0", "Delta_X", "Test_Name")
)
SAME_S = 1e-9  # times that differ by less are the same


@dataclass
class Segment:
    """A segment: the lines of its header by their first word, names with Comment, rows and their lines."""

    tags: dict[str, list[str]]
    names: list[str] = field(default_factory=list)
    place: int = 0
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def is_lvm(text: str) -> bool:
    """Return True if the first line says that a text is such a file."""
    return text.startswith(FIRST_LINE)


def lvm_table(text: str, path: Path) -> Table:
    """Return the table in a text: the segments with the channels of the first. Raises Faults."""
    lines = text.splitlines()
    end = next((k for k, line in enumerate(lines) if line.startswith(END)), None)
    if end is None:
        raise fault(path, f"line {len(lines)}", f"a LabVIEW file without {END}; expected a whole file")
    header = {line.replace(",", "\t", 1).split("\t")[0]: line for line in lines[:end]}
    written = header.get("Separator", "Separator\tTab").replace(",", "\t", 1).split("\t")
    separator = SEPARATORS.get(written[1].strip().lower(), "\t") if len(written) > 1 else "\t"
    decimal = (header.get("Decimal_Separator", "").partition(separator)[2] + ".")[0]
    x_columns = (header.get("X_Columns", "").partition(separator)[2].strip() or "One").capitalize()
    segments = [one for one in _segments(lines, end + 1, separator) if one.rows]
    if not segments:
        raise fault(path, f"line {len(lines)}", "names, and no row of numbers below them; expected rows")
    same = [one for one in segments if one.names == segments[0].names]
    table = _Reader(path, decimal, x_columns).join(same)
    if len(same) < len(segments):
        table.notes.append(f"{len(segments) - len(same)} segments with other channels left out")
    return table


def _segments(lines: Sequence[str], start: int, separator: str) -> list[Segment]:
    """Return the segments without LabVIEW's special blocks."""
    found: list[Segment] = []
    tags: dict[str, list[str]] = {}
    special, named = False, False
    for k in range(start, len(lines)):
        fields = [text.strip() for text in lines[k].split(separator)]
        word = fields[0]
        if special or word == START_SPECIAL or not any(fields):
            special = (special or word == START_SPECIAL) and word != END_SPECIAL
        elif word == END:
            found.append(Segment(tags))
            tags, named = {}, False
        elif word in SEGMENT_TAGS or not found:
            tags[word] = fields
        elif not named:
            found[-1].names, found[-1].place, named = fields, k + 1, True
        else:
            found[-1].rows.append(fields)
            found[-1].lines.append(k + 1)
    return found


@dataclass
class _Reader:
    """A file's decimal sign, and where its times stand: "One", "Multi" or "No" column."""

    path: Path
    decimal: str
    x_columns: str

    def join(self, segments: Sequence[Segment]) -> Table:
        """Return segments of the same channels below each other. Raises Faults."""
        first, multi = segments[0], self.x_columns == "Multi"
        names = list(first.names)
        while names and names[-1] in ("Comment", ""):
            names.pop()
        channels = range(1, len(names), 2 if multi else 1)
        units = self._of_channels(first, "Y_Unit_Label", len(channels))
        timed = any("Time" in text for text in first.tags.get("X_Dimension", ["Time"]))
        rows = [row + [""] * (len(names) - len(row)) for segment in segments for row in segment.rows]
        notes = ["LabVIEW measurement file" + (f" of {len(segments)} segments" if len(segments) > 1 else "")]
        columns = [Column(names[k], [row[k] for row in rows], unit) for k, unit in zip(channels, units, strict=True)]
        times = [self._times(segments, k) for k in (range(0, len(names), 2) if multi else [0])]
        ours = [column.meaning.ours for column in columns]
        main = ours.index("temperature_degC") if multi and "temperature_degC" in ours else 0
        columns.insert(0, Column("Time (s)" if timed else "X_Value", times[main]))
        for k, own in enumerate(times if multi else []):
            off_s = float(np.nanmax(np.abs(own - times[main]), initial=0.0))
            if off_s > SAME_S and ours[k] == "resistance_ohm":
                columns.append(Column("resistance_time_s", own))
            elif off_s > SAME_S:
                notes.append(f"{columns[k + 1].name!r} at the times of {columns[main + 1].name!r}, {off_s:.3g} s off")
        comments = [" ".join(row[len(names) :]).strip() for row in rows]
        if any(comments):
            columns.append(Column("Comment", comments))
        lines = [line for segment in segments for line in segment.lines]
        decimal = DecimalSign(self.decimal, False, True)
        return Table(str(self.path), f"line {first.place}", columns, lines, decimal=decimal, notes=notes)

    def _of_channels(self, segment: Segment, tag: str, channels: int) -> list[str]:
        """Return a header's field of each channel; with times before each it may stand in every second field."""
        fields = segment.tags.get(tag, [tag])[1:]
        filled = [text for text in fields if text]
        if len(filled) != channels:
            filled = (fields[::2] if self.x_columns == "Multi" else fields)[:channels]
        return filled + [""] * (channels - len(filled))

    def _number(self, text: str, line: int, what: str) -> float:
        try:
            return parse_number(tidy_number(text), self.decimal)
        except ValueError:
            raise fault(self.path, f"line {line}", f"{what}: {text[:40]!r}: expected a number") from None

    def _times(self, segments: Sequence[Segment], k: int) -> Array:
        """Return the times of all rows, s. Raises Faults if a segment begins before the end of the one before."""
        found: list[Array] = []
        began = _begin(segments[0])
        for number, segment in enumerate(segments):
            own = self._segment_times(segment, k)
            last = float(found[-1][-1]) if found else -np.inf
            begin = _begin(segment)
            if number and not own[0] > last and begin is not None and began is not None:
                own = own + (begin - began).total_seconds()  # they count from the header's date
            if number and not own[0] > last:
                text = f"segment {number + 1} begins at {own[0]:g} s, and the one before ends at {last:g} s"
                raise fault(self.path, f"line {segment.lines[0]}", f"{text}: expected each as a file of its own")
            found.append(own)
        return np.concatenate(found)

    def _segment_times(self, segment: Segment, k: int) -> Array:
        """Return the times of a segment's rows, or of its header if the rows have none."""
        if self.x_columns != "No" and any(len(row) > k and row[k] for row in segment.rows):
            pairs = zip(segment.rows, segment.lines, strict=True)
            texts = [(row[k] if len(row) > k else "", line) for row, line in pairs]
            return np.array([self._number(text, line, "X_Value") if text else np.nan for text, line in texts])
        line = max(segment.place - 1, 1)
        channels = max(1, sum(map(bool, segment.tags.get("Delta_X", ["", "1"])[1:])))
        steps = {self._number(t, line, "Delta_X") for t in self._of_channels(segment, "Delta_X", channels) if t}
        if len(steps) != 1:
            shown = " and ".join(f"{step:g} s" for step in sorted(steps)) or "none"
            text = f"Delta_X: {shown}, and no times in the rows; expected one interval, or X_Columns One"
            raise fault(self.path, f"line {line}", text)
        zero = self._of_channels(segment, "X0", channels)[0]
        start = self._number(zero, line, "X0") if zero else 0.0
        return start + steps.pop() * np.arange(len(segment.rows), dtype=np.float64)


def _begin(segment: Segment) -> datetime | None:
    """Return the date and time in a segment's header; None if there is none."""
    day, clock = ([text for text in segment.tags.get(tag, [])[1:] if text][:1] for tag in ("Date", "Time"))
    if not day or not clock:
        return None
    seconds, _, fraction = clock[0].replace(",", ".").partition(".")
    try:
        return datetime.fromisoformat(f"{day[0].replace('/', '-')} {seconds}.{(fraction + '000000')[:6]}")
    except ValueError:
        return None
