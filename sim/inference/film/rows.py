"""Records of a film made ready for a fit: checked, with the path that drives the film, and one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.checked_columns import checked_columns
from sim.inference.readings.temperature_path import TemperaturePath, temperature_path, turning_points
from sim.inference.record.joined import joined
from sim.inference.record.quantity import Quantity
from sim.inference.record.record import Record, read_columns
from sim.model.gaps import long_gaps, longest_of, rows_after_gaps
from sim.model.operator_outputs import Integers

FEWEST: Final = 12  # readings below which nothing is fitted
OUTPUT: Final = "output"  # the column


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
    """A checked record: its rows with a temperature, which stand in `rows` of the record as given. path: what drives
    the film; gaps: rows after each gap, with `unseen`, those after one that the film's memory is not known through."""

    name: str
    given_s: Array
    rows: Integers
    path: TemperaturePath
    output: Array
    taken_s: Array
    gaps: Integers
    unseen: Integers

    @property
    def time_s(self) -> Array:
        return self.given_s[self.rows]

    @property
    def inputs(self) -> Array:
        return self.path.temperature_degC

    @property
    def gap_s(self) -> Array:
        """How long each of the gaps lasted."""
        return np.asarray(self.time_s[self.gaps] - self.time_s[self.gaps - 1])

    @property
    def longest_unseen(self) -> Integers:
        """The rows after the longest of the gaps that the film's memory is not known through."""
        return longest_of(self.unseen, self.time_s[self.unseen] - self.time_s[self.unseen - 1])

    @property
    def readings(self) -> int:
        return int(np.sum(np.isfinite(self.output)))


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
    given, known = found["time_s"], np.isfinite(found["temperature_degC"])
    if not np.any(known):
        raise ValueError(f"{name}: temperature_degC: no finite number in {given.size} rows, expected degC")
    rows = np.flatnonzero(known)
    time, temperature, output = given[rows], found["temperature_degC"][rows], found["output"][rows]
    readings = int(np.sum(np.isfinite(output)))
    if readings == 0:
        raise ValueError(f"{name}: output: no finite reading in {given.size} rows, expected at least {FEWEST}")
    if readings < FEWEST:
        raise ValueError(f"{name}: output: {readings} finite readings, expected at least {FEWEST}")
    path = temperature_path(time, temperature, noise_K=noise_K)
    if record.course_degC is not None and path.noise_K > 0.0:
        course = np.asarray(record.course_degC, dtype=np.float64)[rows]
        course = np.where(np.isfinite(course), course, path.temperature_degC)
        path = replace(path, temperature_degC=course, turning=turning_points(course, 0.0))
    check_moves(name, path, "a sweep through the transition")
    gaps = rows_after_gaps(time)
    unseen = long_gaps(time, gaps)
    taken = found.get("output_time_s", given)[rows]
    # a reading stamped inside a long gap counts at its end: the film has been wherever it was before that
    edges = [0, *unseen.tolist(), time.size]
    low, high = (np.repeat(time[ends], np.diff(edges)) for ends in (edges[:-1], np.array(edges[1:]) - 1))
    taken = np.clip(np.where(np.isfinite(taken), taken, time), low, high)
    return Prepared(name, given, rows, path, output, taken, gaps, unseen)


def as_record(records: Sequence[Prepared], centre: float, size: float) -> Record:
    """Return the records one after the other. centre, size: as of `Quantity`."""
    columns, begins = joined(
        [
            {"time_s": r.time_s, "temperature_degC": r.inputs, OUTPUT: r.output, "resistance_time_s": r.taken_s}
            for r in records
        ]
    )
    quantity = Quantity(OUTPUT, centre, size)
    found = read_columns(columns, held_out=False, quantity=quantity, fewest=FEWEST, joined=begins)
    return replace(found, course_degC=np.concatenate([r.inputs for r in records]))


def held_out_blocks(record: Record, blocks: int = 90) -> NDArray[np.bool_]:
    """Return rows to hold out: every third of short blocks of readings of each record, so that each stretch of a sweep
    is covered."""
    held = np.zeros(record.rows, dtype=np.bool_)
    for part in record.parts:
        rows = part.start + np.flatnonzero(record.output_used[part])
        length = max(1, round(rows.size / blocks))
        held[rows[(np.arange(rows.size) // length) % 3 == 1]] = True
    return held
