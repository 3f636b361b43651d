"""What the rows of a record show by themselves: a saturated heat sink, gaps, uneven steps, impossible readings.

Several records that are diagnosed as one are checked one by one: own gaps, own rows, times of the own file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from sim.diagnosis.result import Caution
from sim.inference.readings.odd_readings import Column, odd_readings, of_output, rows_told
from sim.inference.record.record import ALONE, REPEATED, Record
from sim.model.gaps import gap_threshold

FEWEST_S: Final = 20.0  # of strong cooling: no sink warms up in less
LARGE: Final = 0.8  # of the largest current
LONGER: Final = 1.5  # times the median, from which a step is a long one
MANY: Final = 0.1  # of the steps: where more are long, sampling is uneven


def row_warnings(record: Record) -> list[Caution]:
    """Of each of the records that it is made of."""
    found = []
    for number, part in enumerate(record.parts, 1):
        of = number if record.joined.size else None
        for kind in (_saturated_sink, _gaps, _uneven, _outliers, _odd_readings, _repeated):
            found += [replace(caution, record=of) for caution in kind(record, part)]
    return found


def _saturated_sink(record: Record, part: slice) -> Iterator[Caution]:
    """Stretches in which the plate warms for long while the current cools at nearly its largest."""
    if record.current_A is None or np.min(record.current_A) >= 0.0:
        return
    time, degC = record.file_s[part], record.temperature_degC[part]
    cooling = record.current_A[part] < -LARGE * float(np.max(np.abs(record.current_A)))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], cooling.astype(np.int8), [0]))))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        last = min(int(end), time.size - 1)
        t, v = time[first:last], degC[first:last]
        if t.size < 8 or t[-1] - t[0] < FEWEST_S:  # fewer rows have no slope, as fewer readings below
            continue
        half = t.size // 3  # until then it may still be cooling
        tail = slice(half, None)
        good = np.isfinite(v[tail])
        if np.sum(good) < 5:
            continue
        slope = np.polyfit(t[tail][good] - t[half], v[tail][good], 1)[0]
        rise = slope * (t[-1] - t[half])
        if rise > max(0.3, 2.0 * record.step_K):  # less is the end of the plate's own transient
            text = (
                f"the current cools with {LARGE:.0%} of its largest or more, and the plate warms by {rise:.2g} K: "
                "the heat sink is saturated; more current cools less"
            )
            yield Caution("heat_sink_saturated", text, float(t[half]), float(t[-1]))


def _gaps(record: Record, part: slice) -> Iterator[Caution]:
    """Of missing rows, and of rows without a current: what was commanded there is not known."""
    after = record.gaps_in(part)
    if after.size:
        anew = int(np.sum((record.first_rows > part.start) & (record.first_rows < part.stop)))
        steps = record.file_s[after] - record.file_s[after - 1]
        missing = int(np.sum(steps > gap_threshold(np.diff(record.file_s[part]))))
        every = missing == after.size
        where = "the rows" if every else "the rows or in their currents" if missing else "the rows' currents"
        longest = "of" if after.size == 1 else "the longest of"
        text = f"{after.size} gap{'s' * (after.size > 1)} in {where}, {longest} {float(np.max(steps)):.3g} s"
        yield Caution("gaps", f"{text}{_begun_anew(after.size, anew)}")


def _begun_anew(gaps: int, anew: int) -> str:
    """After how many of the gaps the plate's temperature is begun anew; across the others it is simulated."""
    if not anew:
        return ", simulated across"
    after = "it" if gaps == 1 else "each" if anew == gaps else f"{anew} of them"
    return f": after {after} the temperature is fitted anew"


def _uneven(record: Record, part: slice) -> Iterator[Caution]:
    steps = np.diff(record.file_s[part])
    if steps.size and np.mean(steps > LONGER * np.median(steps)) > MANY:
        yield Caution("uneven_sampling", "more than a tenth of the steps are longer than 1.5 times the median")


def _outliers(record: Record, part: slice) -> Iterator[Caution]:
    for column in dict.fromkeys(out.column for out in record.left_out):
        if rows := _left_out(record, part, column):
            one = len(rows) == 1
            text = "1 reading was left out as an outlier" if one else f"{len(rows)} readings were left out as outliers"
            yield Caution("outliers", f"{column}: {text}, {rows_told(rows)}")


def _left_out(record: Record, part: slice, column: str) -> list[int]:
    """The rows of a column that were left out as outliers, counted from the part's first."""
    of = (out.row for out in record.left_out if out.column == column and out.rule == ALONE)
    return sorted({row - part.start for row in of if part.start <= row < part.stop})


def _odd_readings(record: Record, part: slice) -> Iterator[Caution]:
    """Of readings that cannot be what was measured: bad rows, a unit that changes."""
    time, degC = record.file_s[part], record.temperature_degC[part]
    degC = np.where(np.isfinite(degC), degC, np.nan)
    column, gone = Column("temperature_degC", time, degC, "degC"), _left_out(record, part, "temperature_degC")
    lines = odd_readings(column, left_out=gone)
    if record.output is not None and record.quantity.is_resistance:
        film = of_output(time, record.output[part], record.quantity.name)
        lines += odd_readings(film, degC, _left_out(record, part, film.name))
    yield from (Caution("odd_readings", line) for line in lines)


def _repeated(record: Record, part: slice) -> Iterator[Caution]:
    """Of a meter slower than the rows."""
    if repeated := sum(out.rule == REPEATED and part.start <= out.row < part.stop for out in record.left_out):
        text = f"{repeated} rows repeat the meter's reading before, which counts once, where it comes first: the meter "
        text += "is slower than the rows, and averages over some of them, which looks like a lag; ask it less often"
        yield Caution("repeated_readings", f"{record.quantity.column}: {text}")
