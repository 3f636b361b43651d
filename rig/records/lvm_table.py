"""A table in LabVIEW's measurement file (.lvm): segments of channels, each below a header of its own.

National Instruments' specification of the format, and files that LabVIEW wrote, leave open more than one would think: a
column Comment is named and has no field in the rows; the column of times may be empty (X_Columns No), there once, or
there for each channel (Multi); a further segment may come with a header of its own and times that begin again, which
the header's date goes with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.column_names import meaning_of
from rig.records.numbers import Signs, number_of, tidied
from rig.records.table import Column, Table

FIRST_LINE = "LabVIEW Measurement"
END, START_SPECIAL, END_SPECIAL = "***End_of_Header***", "***Start_Special***", "***End_Special***"
SEPARATORS = {"tab": "\t", "comma": ","}
SEGMENT_TAGS = frozenset(
    ("Channels", "Samples", "Date", "Time", "Notes", "Y_Unit_Label", "X_Dimension", "X0", "Delta_X", "Test_Name")
)
SAME_S = 1e-9  # of the interval between rows: times that differ by less are the same


@dataclass
class Segment:
    """tags: the header's lines by their first word; names: of the columns, with Comment; rows, with their lines."""

    tags: dict[str, list[str]]
    names: list[str] = field(default_factory=list)
    place: int = 0
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def is_lvm(text: str) -> bool:
    """Whether a text says in its first line that it is one."""
    return text.startswith(FIRST_LINE)


def lvm_table(text: str, path: Path) -> Table:
    """The table in a text. Raises Faults."""
    lines = text.splitlines()
    end = next((k for k, line in enumerate(lines) if line.startswith(END)), None)
    if end is None:
        raise fault(path, f"line {len(lines)}", f"a LabVIEW file without {END}; expected a whole file")
    header = {line.replace(",", "\t", 1).split("\t")[0]: line for line in lines[:end]}
    said = header.get("Separator", "Separator\tTab").replace(",", "\t", 1).split("\t")
    separator = SEPARATORS.get(said[1].strip().lower(), "\t") if len(said) > 1 else "\t"
    decimal = (header.get("Decimal_Separator", "").partition(separator)[2] + ".")[0]
    columns = (header.get("X_Columns", "").partition(separator)[2].strip() or "One").capitalize()
    segments = [one for one in _segments(lines, end + 1, separator) if one.rows]
    if not segments:
        raise fault(path, f"line {len(lines)}", "names, and no row of numbers below them; expected rows")
    first = segments[0]
    same = [one for one in segments if one.names == first.names]
    table = _Joined(path, decimal, columns == "Multi", columns == "No", first).table(same)
    if len(same) < len(segments):
        table.said.append(f"{len(segments) - len(same)} segments with other channels left out")
    return table


def _segments(lines: Sequence[str], start: int, separator: str) -> list[Segment]:
    """Headers, names and rows, one after the other; special blocks are left out."""
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
class _Joined:
    """Segments of the same channels, one after the other. multi: times stand before each channel; none: nowhere."""

    path: Path
    decimal: str
    multi: bool
    none: bool
    first: Segment

    def table(self, segments: Sequence[Segment]) -> Table:
        """Raises Faults."""
        names = list(self.first.names)
        while names and names[-1] in ("Comment", ""):
            names.pop()
        step = 2 if self.multi else 1
        channels = range(1, len(names), step)
        units = self._of_channels(self.first, "Y_Unit_Label", len(channels))
        timed = any("Time" in text for text in self.first.tags.get("X_Dimension", ["Time"]))
        rows = [row + [""] * (len(names) - len(row)) for segment in segments for row in segment.rows]
        lines = [line for segment in segments for line in segment.lines]
        said = ["LabVIEW measurement file" + (f" of {len(segments)} segments" if len(segments) > 1 else "")]
        columns = [Column(names[k], [row[k] for row in rows], unit) for k, unit in zip(channels, units, strict=True)]
        times = [self._times(segments, k) for k in (range(0, len(names), 2) if self.multi else [0])]
        ours = [meaning_of(column.name, column.unit).ours for column in columns]
        main = ours.index("temperature_degC") if self.multi and "temperature_degC" in ours else 0
        columns.insert(0, Column("Time (s)" if timed else "X_Value", times[main]))
        for k, own in enumerate(times if self.multi else []):
            off = float(np.nanmax(np.abs(own - times[main]), initial=0.0))
            if off > SAME_S and ours[k] == "resistance_ohm":
                columns.append(Column("resistance_time_s", own))
            elif off > SAME_S:
                said.append(f"{columns[k + 1].name!r} at the times of {columns[main + 1].name!r}, {off:.3g} s off")
        comments = [" ".join(row[len(names) :]).strip() for row in rows]
        if any(comments):
            columns.append(Column("Comment", comments))
        place = f"line {self.first.place}"
        return Table(str(self.path), place, columns, lines, signs=Signs(self.decimal, False, True), said=said)

    def _of_channels(self, segment: Segment, tag: str, channels: int) -> list[str]:
        """What a header's line says of each channel; with times before each it may stand in every second field."""
        fields = segment.tags.get(tag, [tag])[1:]
        filled = [text for text in fields if text]
        if len(filled) != channels:
            filled = (fields[::2] if self.multi else fields)[:channels]
        return filled + [""] * (channels - len(filled))

    def _number(self, text: str, line: int, what: str) -> float:
        try:
            return number_of(tidied(text), self.decimal)
        except ValueError:
            raise fault(self.path, f"line {line}", f"{what}: {text[:40]!r}: expected a number") from None

    def _times(self, segments: Sequence[Segment], k: int) -> Array:
        """Seconds of every row, from the first segment's begin. Raises Faults: a segment that begins too early."""
        found: list[Array] = []
        began = self._began(segments[0])
        for number, segment in enumerate(segments):
            own = self._own_times(segment, k)
            if number:
                last, begins = float(found[-1][-1]), self._began(segment)
                later = (begins - began).total_seconds() if begins is not None and began is not None else 0.0
                if not own[0] > last:  # they begin again, as the header's date says
                    own = own + later
                if not own[0] > last:
                    text = f"segment {number + 1} begins at {own[0]:g} s, and the one before ends at {last:g} s"
                    raise fault(self.path, f"line {segment.lines[0]}", f"{text}: expected each as a file of its own")
            found.append(own)
        return np.concatenate(found)

    def _own_times(self, segment: Segment, k: int) -> Array:
        """Seconds as the rows say them, or as the header does, where those are empty."""
        count = len(segment.rows)
        if not self.none and any(len(row) > k and row[k] for row in segment.rows):
            pairs = zip(segment.rows, segment.lines, strict=True)
            texts = [(row[k] if len(row) > k else "", line) for row, line in pairs]
            return np.array([self._number(text, line, "X_Value") if text else np.nan for text, line in texts])
        line = max(segment.place - 1, 1)
        channels = max(1, sum(map(bool, segment.tags.get("Delta_X", ["", "1"])[1:])))
        steps = {self._number(t, line, "Delta_X") for t in self._of_channels(segment, "Delta_X", channels) if t}
        if len(steps) != 1:
            told = " and ".join(f"{step:g} s" for step in sorted(steps)) or "none"
            text = f"Delta_X: {told}, and no times in the rows; expected one interval, or X_Columns One"
            raise Faults([f"{self.path}: line {line}: {text}"])
        zero = self._of_channels(segment, "X0", channels)[0]
        start = self._number(zero, line, "X0") if zero else 0.0
        return start + steps.pop() * np.arange(count, dtype=np.float64)

    def _began(self, segment: Segment) -> datetime | None:
        """When a segment began, as its header says."""
        day, clock = ([text for text in segment.tags.get(tag, [])[1:] if text][:1] for tag in ("Date", "Time"))
        if not day or not clock:
            return None
        seconds, _, fraction = clock[0].replace(",", ".").partition(".")
        try:
            return datetime.fromisoformat(f"{day[0].replace('/', '-')} {seconds}.{(fraction + '000000')[:6]}")
        except ValueError:
            return None
