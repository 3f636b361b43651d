"""Records of a film made ready for a fit: checked, freed of outliers, with a path for the operators.

A film's memory belongs to its record (`FilmStart`). Rate independence makes the path cheap: besides the rows with
readings only its turning points count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.checked_columns import checked_columns
from sim.inference.readings.outliers import lone_outliers
from sim.inference.readings.repeated import repeated_rows
from sim.inference.readings.temperature_path import TemperaturePath, temperature_path, turning_points
from sim.model.gaps import long_gaps, longest_of, rows_after_gaps
from sim.model.operator_outputs import Integers, Sides
from sim.model.record_own import FilmStart

FEWEST: Final = 12  # readings below which nothing is fitted


@dataclass(frozen=True, eq=False)
class FilmRecord:
    """One record: `time_s` increasing, `temperature_degC`, `output` (nan: no reading), each of shape (samples,);
    `output_time_s`: when each output was read, where that is known to differ from the row's time (nan: it does not);
    `course_degC`: the film's temperature where it is known better than by smoothing the readings (nan: it is not)."""

    time_s: ArrayLike
    temperature_degC: ArrayLike
    output: ArrayLike
    name: str = "record"
    output_time_s: ArrayLike | None = None
    course_degC: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A checked record. `path`: what drives the operators; `used`: rows with a trusted reading; `outliers`: rows of
    the record as given; `gaps`: rows after each gap, with `unseen`, those after one that the film's memory is not known
    through, and `gap_s`, how long each of the gaps lasted; `repeated`: rows of the record as given that repeat the
    reading before; `origin`: of each row here the row there (-1: none), None if they are the same."""

    name: str
    time_s: Array
    path: TemperaturePath
    output: Array
    used: NDArray[np.bool_]
    outliers: Integers
    gaps: Integers
    unseen: Integers
    gap_s: Array
    repeated: Integers
    origin: Integers | None = None

    @property
    def inputs(self) -> Array:
        return self.path.temperature_degC

    @property
    def longest_unseen(self) -> Integers:
        """The rows after the longest of the gaps that the film's memory is not known through."""
        return longest_of(self.unseen, self.gap_s[np.searchsorted(self.gaps, self.unseen)])


@dataclass(frozen=True, eq=False)
class Path:
    """Rows of all records in sequence: inputs (degC), sides as `operator_outputs` takes them, and which of them
    carry readings: `rows`, with `output`, `record` and `sample` (row in the record), each of shape (readings,)."""

    inputs: Array
    side: Sides
    rows: Integers
    output: Array
    record: Integers
    sample: Integers


def check_moves(name: str, path: TemperaturePath, expected: str) -> None:
    """Raises ValueError with one line for a record (name) whose temperature stands still. expected: what it lacks."""
    degC = path.temperature_degC
    if np.ptp(degC) < max(1e-3, 3.0 * path.noise_K):
        raise ValueError(f"{name}: temperature_degC: constant at {np.median(degC):.6g}, expected {expected}")


def prepare(record: FilmRecord, *, noise_K: float | None = None) -> Prepared:
    """Check one record and find its path; `ValueError` with one line where it cannot be used."""
    name = record.name
    columns = {"time_s": record.time_s, "temperature_degC": record.temperature_degC, "output": record.output}
    if record.output_time_s is not None:
        columns["output_time_s"] = record.output_time_s
    found = checked_columns(columns, name)
    time, temperature, output = found["time_s"], found["temperature_degC"], found["output"]
    known = np.isfinite(temperature)
    if not np.any(known):
        raise ValueError(f"{name}: temperature_degC: no finite number in {time.size} rows, expected degC")
    finite = np.isfinite(output) & known
    if not np.any(finite):
        raise ValueError(f"{name}: output: no finite reading in {time.size} rows, expected at least {FEWEST}")
    if np.sum(finite) < FEWEST:
        raise ValueError(f"{name}: output: {int(np.sum(finite))} finite readings, expected at least {FEWEST}")
    path = temperature_path(time, temperature, noise_K=noise_K)
    if record.course_degC is not None and path.noise_K > 0.0:
        course = np.asarray(record.course_degC, dtype=np.float64)
        course = np.where(np.isfinite(course), course, path.temperature_degC)
        path = replace(path, temperature_degC=course, turning=turning_points(course, 0.0))
    check_moves(name, path, "a sweep through the transition")
    repeated = repeated_rows(output, FEWEST)
    finite[repeated] = False
    outliers = lone_outliers(output, finite)
    finite[outliers] = False
    unseen = _without_temperature(time, known)
    gaps = _gaps(time, known, unseen)
    before = _last_known(known, gaps)
    whole = Prepared(name, time, path, output, finite, outliers, gaps, unseen, time[gaps] - time[before], repeated)
    return whole if record.output_time_s is None else _at_reading_times(whole, before, found["output_time_s"])


def _without_temperature(time: Array, known: NDArray[np.bool_]) -> Integers:
    """Return the rows after gaps that the film's memory is not known through: between two readings of the thermometer,
    whether there are rows or not."""
    rows = np.flatnonzero(known)
    return np.asarray(rows[long_gaps(time[rows], rows_after_gaps(time[rows]))], dtype=np.int64)


def _gaps(time: Array, known: NDArray[np.bool_], unseen: Integers) -> Integers:
    """Return the row after each gap in time, and after those without a temperature: rows between belong to one gap."""
    rows, after = np.flatnonzero(known), rows_after_gaps(time)
    then = rows[np.minimum(np.searchsorted(rows, after), rows.size - 1)]
    return np.union1d(after[~np.isin(then, unseen)], unseen).astype(np.int64)


def _last_known(known: NDArray[np.bool_], gaps: Integers) -> Integers:
    """Return the last row before each gap, with a temperature where there is any."""
    rows = np.flatnonzero(known)
    return np.asarray(np.where(gaps > rows[0], rows[np.searchsorted(rows, gaps) - 1], gaps - 1), dtype=np.int64)


def _at_reading_times(record: Prepared, before: Integers, read_s: Array) -> Prepared:
    """Return the record with a row of its own for each output that was read between two rows. before: the rows before
    gaps."""
    read = np.clip(np.where(np.isfinite(read_s), read_s, record.time_s), record.time_s[0], record.time_s[-1])
    apart = np.flatnonzero(record.used & (read != record.time_s))
    if not apart.size:
        return record
    count = record.time_s.size
    time = np.concatenate((record.time_s, read[apart]))
    output = np.concatenate((record.output, record.output[apart]))
    used = np.concatenate((record.used, np.ones(apart.size, dtype=np.bool_)))
    used[apart] = False
    origin = np.concatenate((np.arange(count), apart))
    order = np.argsort(time, kind="stable")
    used, origin = used[order], origin[order]
    inputs = np.interp(time[order], record.time_s, record.inputs)
    path = replace(record.path, temperature_degC=inputs, turning=turning_points(inputs, 0.0))
    place = np.argsort(order)  # here, of each row there
    ends = [(int(place[last]), int(place[row]), int(row)) for last, row in zip(before, record.gaps, strict=True)]
    gaps = np.array([_first_after(*one, origin, used) for one in ends], dtype=np.int64)
    unseen = gaps[np.searchsorted(record.gaps, record.unseen)]
    rows = time[order], path, output[order], used
    return Prepared(record.name, *rows, record.outliers, gaps, unseen, record.gap_s, record.repeated, origin)


def _first_after(last: int, end: int, row: int, origin: Integers, used: NDArray[np.bool_]) -> int:
    """Return where what follows a gap begins, between the rows at its ends: at its end, which is that row of the
    record, or at the first reading of this or a later row that is from within the gap: whatever the film went through
    in it, it went through before. origin, used: of rows and readings in sequence."""
    within = np.arange(last + 1, end)
    early = within[used[within] & (origin[within] >= row)]
    return int(early[0]) if early.size else end


def build_path(
    records: Sequence[Prepared], starts: Sequence[FilmStart], chosen: Sequence[NDArray[np.bool_]] | None = None
) -> Path:
    """Return one path through all records, with the chosen rows' readings (default: all used rows')."""
    inputs, sides, rows, outputs, owners, samples = [], [], [], [], [], []
    length = 0
    for number, (record, start) in enumerate(zip(records, starts, strict=True)):
        keep = record.used if chosen is None else record.used & chosen[number]
        needed = keep.copy()
        needed[record.path.turning] = True
        needed[0] = True
        after, passed_degC = start.turned_in_gaps(record.time_s)
        needed[after] = needed[after - 1] = True
        index = np.flatnonzero(needed)
        places = np.searchsorted(index, after)
        v = np.insert(record.inputs[index], places, passed_degC)
        position = np.flatnonzero(keep[index])
        position = position + np.searchsorted(places, position, side="right")
        v, position = np.concatenate((start.turned_degC, v)), position + len(start.turned_degC)
        side = np.empty(v.size, dtype=np.int8)
        side[0] = -2 if start.initial == "cooled" else 2
        side[1:] = np.sign(np.diff(v))
        inputs.append(v)
        sides.append(side)
        rows.append(position + length)
        readings = np.flatnonzero(keep)
        outputs.append(record.output[readings])
        owners.append(np.full(readings.size, number))
        samples.append(readings)
        length += v.size
    return Path(
        np.concatenate(inputs),
        np.concatenate(sides).astype(np.int8),
        np.concatenate(rows).astype(np.int64),
        np.concatenate(outputs),
        np.concatenate(owners).astype(np.int64),
        np.concatenate(samples).astype(np.int64),
    )


def held_out_blocks(record: Prepared, blocks: int = 90) -> NDArray[np.bool_]:
    """Return rows to hold out: every third of short blocks of readings, so that each stretch of a sweep is covered."""
    rows = np.flatnonzero(record.used)
    length = max(1, round(rows.size / blocks))
    held = np.zeros(record.used.size, dtype=np.bool_)
    held[rows[(np.arange(rows.size) // length) % 3 == 1]] = True
    return held


def thinned(record: Prepared, chosen: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Return at most about `most` of the chosen rows, evenly in sequence."""
    rows = np.flatnonzero(record.used & chosen)
    keep = np.zeros(record.used.size, dtype=np.bool_)
    if rows.size:
        keep[rows[np.unique(np.linspace(0, rows.size - 1, min(most, rows.size)).round().astype(np.int64))]] = True
    return keep
