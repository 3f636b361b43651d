"""A record as the diagnosis takes it: columns checked, times from the first row, gaps, outliers, held-out rows.

What is said to people has the time as the record's file has it (`file_s`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect
from sim.inference.noise import rough_noise
from sim.inference.nuisance import LEAST_NOISE_DEC, LEAST_NOISE_K, Told
from sim.inference.readings.checked_columns import checked_columns
from sim.inference.readings.odd_readings import lone_outliers, repeated_rows
from sim.inference.record.lattice import lattice_step
from sim.inference.record.quantity import RESISTANCE, Quantity
from sim.inference.record.stretches import first_rows, gaps, undriven, with_readings
from sim.inference.record.unlogged_current import acted_before
from sim.model.inputs import NOTHING, Inputs, constant_inputs, logged_inputs
from sim.model.links import delays_s, stamps_off_s
from sim.model.meter_power import since_the_row_before
from sim.model.record_own import long_gaps

Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]
FEWEST_FOR_NOISE = 20  # readings; fewer do not tell an instrument's noise
FEWEST = 40  # readings of a channel below which nothing can be said about it
BLOCKS = 60  # contiguous blocks of rows, every fourth of them held out
HELD_OUT = 4
FIRST_SHARE = 0.1  # of the rows, never held out: in them first temperatures and memory show
MOST_OF_AN_END = 0.01  # of the record that is left out at either end of what is known for time stamps that may be off
ALONE = "apart from its neighbours"
REPEATED = "repeats the reading before: the meter is slower than the rows"
UNDRIVEN = "before the first temperature or after the last one"
MOST_IN_A_GAP = 1000  # commands
MOST_AFTER_GAPS = 0.2  # of the record that is left out after gaps for commands that may be late


class LeftOut(NamedTuple):
    """A reading that does not count, and the rule by which."""

    row: int
    column: str
    rule: str


@dataclass(frozen=True, eq=False)
class Record:
    """One record; arrays of shape (rows,).

    time_s: from the first row; file_s: the same times as the record's own file has them, of several records as each of
    them has. temperature_degC; temperature_used: readings that count. step_K: of the lattice that the
    readings lie on, 0 where there is none. current_A: None where the record has none. output: -log10(R / 1 ohm), or
    another quantity of the film in the fit's decades, None where there is none; output_used; taken_s: when it was read;
    commanded_s: when the row's current began to act. test_current_A: of the ohmmeter, 0 where it is not known;
    test_on_s: since when it had been on.
    after_gaps: the row after each gap; first_rows: where a stretch begins (the first row, and after each gap through
    which the plate is not known). held_out: rows that no fit sees. left_out: readings that do not count though they are
    there, each with its row, column and the rule by which. quantity: what the output is. early: the share of a change
    of the current that acts before its row (`between_rows`). joined: where further records of the same rig begin.
    course_degC: of the film, where it is known better than by the thermometer.
    inputs: what else heats the plate; constant_inputs: what would, if it changed, with its least and largest reading.
    """

    time_s: Array
    file_s: Array
    temperature_degC: Array
    temperature_used: Mask
    step_K: float
    current_A: Array | None
    output: Array | None
    output_used: Mask
    taken_s: Array
    commanded_s: Array
    test_current_A: Array | None
    test_on_s: Array
    after_gaps: Rows
    first_rows: Rows
    held_out: Mask
    left_out: tuple[LeftOut, ...]
    quantity: Quantity = RESISTANCE
    early: float = 0.0
    joined: Rows = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    inputs: Inputs = NOTHING
    course_degC: Array | None = None
    constant_inputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        return int(self.time_s.size)

    @property
    def parts(self) -> list[slice]:
        """The rows of each of the records that it is made of, one after the other; of a single one all rows."""
        edges = [0, *self.joined.tolist(), self.rows]
        return [slice(first, last) for first, last in itertools.pairwise(edges)]

    def number_of(self, row: int) -> int:
        """Which of these records a row belongs to, from 1 on."""
        return int(np.searchsorted(self.joined, row, side="right")) + 1

    def gaps_in(self, part: slice) -> Rows:
        """The rows after the gaps within one of them: between two records nothing is missing."""
        first, last = np.searchsorted(self.after_gaps, [part.start + 1, part.stop])
        return self.after_gaps[first:last]

    @property
    def judging(self) -> Mask:
        """Of the rows that no fit sees, those on which the reported gain is measured: every other block."""
        block = np.arange(self.rows) * BLOCKS // max(self.rows, 1)
        return np.asarray(self.held_out & (block // HELD_OUT % 2 == 1))

    @property
    def deciding(self) -> Mask:
        """Of the rows that no fit sees, those that speak for or against a name: the other blocks."""
        return np.asarray(self.held_out & ~self.judging)

    def leaving_out(self, outputs: Mask, rule: str) -> Record:
        """The same without some readings of the output, and the rule by which."""
        return self._using(self.temperature_used, self.output_used & ~outputs, rule)

    def _using(self, temperature_used: Mask, output_used: Mask, rule: str) -> Record:
        """The same with fewer readings, and the rule by which."""
        left_out = [
            LeftOut(int(row), column, rule)
            for column, before, now in (
                ("temperature_degC", self.temperature_used, temperature_used),
                (self.quantity.column, self.output_used, output_used),
            )
            for row in np.flatnonzero(before & ~now)
        ]
        return replace(
            self,
            temperature_used=temperature_used,
            output_used=output_used,
            left_out=(*self.left_out, *left_out),
        )

    def read_while_it_ran(self, effects: Iterable[Effect]) -> Record:
        """The same without the resistances that were read before or after it, or in a long gap, if its time stamps are
        as far off as one of the effects may have them: nothing is known of the temperature there."""
        off = [float(np.max(np.abs(stamps_off_s(e, _largest(e), self.time_s)))) for e in effects]
        margin = min(max(off, default=0.0), MOST_OF_AN_END * float(self.time_s[-1]))
        within = np.zeros(self.rows, dtype=np.bool_)
        for first, last in itertools.pairwise([0, *long_gaps(self).tolist(), self.rows]):
            taken = self.taken_s[first:last]
            within[first:last] = (taken >= self.time_s[first] + margin) & (taken <= self.time_s[last - 1] - margin)
        return self._using(self.temperature_used, self.output_used & within, "stamped where the plate is not known")

    @cached_property
    def commands(self) -> tuple[Array, Array]:
        """When a current was commanded, and which: of the rows, and in a gap on a straight line, at the usual pace or
        a thousand times. Where it changes between the rows, its mean there."""
        assert self.current_A is not None
        time = []
        change = np.diff(self.current_A, append=self.current_A[-1])
        change[np.union1d(self.after_gaps, self.joined) - 1] = 0.0
        for k in self.after_gaps:
            begin, end = self.time_s[k - 1], self.time_s[k]
            steps = min(max(round((end - begin) / self.interval_s), 1), MOST_IN_A_GAP)
            time.append(np.linspace(begin, end, steps + 1)[1:-1])
        between = np.concatenate(time) if time else np.empty(0)
        every = np.concatenate((self.commanded_s, between))
        order = np.argsort(every, kind="stable")
        mean_A = self.current_A + self.early * change
        current = np.concatenate((mean_A, np.interp(between, self.time_s, self.current_A)))
        return every[order], current[order]

    def commanded_in_sight(self, effects: Iterable[Effect]) -> Record:
        """The same without the readings after a gap that a command sent in it may still change, if commands act as
        late as one of the effects may have them."""
        if self.current_A is None:
            return self
        time, current = self.time_s, self.current_A
        late = [float(np.max(delays_s(e, _largest(e), time, current))) for e in effects]
        latest = max(0.0, *late)
        begin = self.first_rows[np.searchsorted(self.first_rows, np.arange(self.rows), side="right") - 1]
        since = np.where(begin > 0, time - time[begin], np.inf)
        if np.mean(since < latest) > MOST_AFTER_GAPS:
            latest = float(np.quantile(since, MOST_AFTER_GAPS))
        seen = since >= latest
        used = self.temperature_used & seen
        fewer = self._using(used, self.output_used & seen, "a command of the gap before may still act")
        return replace(fewer, first_rows=with_readings(self.first_rows, used, time, latest))

    @property
    def interval_s(self) -> float:
        """The median step."""
        return float(np.median(np.diff(self.time_s)))

    def interval_of(self, part: slice) -> float:
        """That of one of the records that it is made of, s; 0 of a single row."""
        steps = np.diff(self.time_s[part])
        return float(np.median(steps)) if steps.size else 0.0


def _largest(effect: Effect) -> Array:
    """Its parameters, as large as any that one meets."""
    return np.array([p.largest for p in effect.parameters])


def held_out_rows(rows: int, first_rows: Sequence[int] | Rows = ()) -> Mask:
    """Every fourth block of rows, after the first tenth: no other part of a record may have been where that was.

    first_rows: where stretches begin; what a stretch began with can only be seen in the rows after that.
    """
    row = np.arange(rows)
    block = row * BLOCKS // max(rows, 1)
    held = np.asarray((block % HELD_OUT == 1) & (row >= FIRST_SHARE * rows))
    for first in first_rows:
        held[first : first + max(rows // BLOCKS, 1)] = False
    return held


def read_columns(
    columns: Mapping[str, ArrayLike],
    *,
    held_out: bool = True,
    quantity: Quantity = RESISTANCE,
    fewest: int = FEWEST,
    joined: Rows | None = None,
) -> Record:
    """A record from its columns (names and units of a record file), with the film's output as `quantity` says. fewest:
    readings of a channel that it needs at least; joined: where further records begin. Raises ValueError, a line a
    fault."""
    data = _checked(columns)
    time, temperature = data["time_s"], data["temperature_degC"]
    used = np.isfinite(temperature)
    if np.sum(used) < fewest:
        raise ValueError(f"temperature_degC: {int(np.sum(used))} finite readings; expected at least {fewest}")
    step = lattice_step(temperature[used])
    outliers = lone_outliers(temperature, used) if step == 0.0 else np.empty(0, dtype=np.int64)
    used[outliers] = False
    current = data.get("current_A")
    if current is not None and not np.any(np.abs(np.nan_to_num(current)) > 0.0):
        current = None
    left_out = [LeftOut(int(row), "temperature_degC", ALONE) for row in outliers]
    output, output_used, out = _output(quantity.of(data), undriven(used, current), fewest)
    left_out += [LeftOut(int(row), quantity.column, rule) for rule, rows in out.items() for row in rows]
    taken = data.get("resistance_time_s", np.full(time.size, np.nan))
    taken = np.where(np.isfinite(taken), taken, time) - time[0]
    told = np.ones(time.size, dtype=np.bool_) if current is None else np.isfinite(current)
    after = gaps(time, told, _none(joined).tolist(), data.get("current_time_s"))
    if current is not None:
        current = np.interp(time, time[told], current[told])
    test = data.get("meter_current_A")
    begins = first_rows(time, np.interp(time, time[used], temperature[used]), current, told, after)
    early = 0.0
    if current is not None and "current_time_s" not in data:
        readings = np.where(used, temperature, np.nan)
        early = acted_before(time, readings, np.where(told, current, np.nan), np.union1d(after, _none(joined)))
    return Record(
        time - time[0],
        time,
        temperature,
        used,
        step,
        current,
        output,
        output_used,
        taken,
        _commanded_s(data, time),
        None if test is None or not np.any(np.isfinite(test)) else np.nan_to_num(test),
        _test_on_s(data, time, taken),
        after,
        begins,
        held_out_rows(time.size, begins) if held_out else np.zeros(time.size, dtype=np.bool_),
        tuple(left_out),
        quantity,
        early,
        _none(joined),
        logged_inputs(data, [0, *_none(joined)]) if current is not None else NOTHING,
        constant_inputs=constant_inputs(data, [0, *_none(joined)]) if current is not None else {},
    )


def _none(rows: Rows | None) -> Rows:
    return rows if rows is not None else np.empty(0, dtype=np.int64)


def _output(readings: Array | None, lost: Mask, fewest: int) -> tuple[Array | None, Mask, dict[str, Rows]]:
    """The film's output, which of its readings count, and by rule those that do not; none where they are too few."""
    rows = lost.size
    good = np.zeros(rows, dtype=np.bool_) if readings is None else np.isfinite(readings)
    if readings is None or np.sum(good) < fewest:
        return None, np.zeros(rows, dtype=np.bool_), {}
    repeated = repeated_rows(readings, fewest)
    good[repeated] = False
    alone = lone_outliers(readings, good)
    good[alone] = False
    left = np.flatnonzero(good & lost)
    good[left] = False
    return readings, good, {REPEATED: repeated, ALONE: alone, UNDRIVEN: left}


def _commanded_s(data: Mapping[str, Array], time: Array) -> Array:
    """When each row's current began to act: with the row, or before the next one where the record says so."""
    acts = data.get("current_time_s", np.full(time.size, np.nan))
    latest = np.append(time[1:], np.inf)
    acts = np.where(np.isfinite(acts), np.clip(acts, time, latest), time)
    return np.asarray(acts - time[0], dtype=np.float64)


def _test_on_s(data: Mapping[str, Array], time: Array, taken: Array) -> Array:
    """Since when each row's test current had been on: since the row before, or later where the record says so."""
    before, latest = since_the_row_before(time), np.minimum(time, taken + time[0])
    told = data.get("meter_current_time_s", np.full(time.size, np.nan))
    on = np.where(np.isfinite(told), np.clip(told, before, np.maximum(latest, before)), before)
    return np.asarray(on - time[0], dtype=np.float64)


def _checked(columns: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """The columns that are numbers, of one length, with times that increase. Raises ValueError, a line a fault."""
    lines = [f"{name}: missing; expected a column" for name in ("time_s", "temperature_degC") if name not in columns]
    if lines:
        raise ValueError("\n".join(lines))
    return checked_columns({name: v for name, v in columns.items() if np.asarray(v).dtype.kind in "fiub"})


def told_of(record: Record) -> Told:
    """The readings of a record that count, with the noise that they show by themselves: what belongs to a record is
    fitted alike whatever model it is fitted with."""
    output = np.where(record.output_used, record.output, np.nan) if record.output is not None else None
    temperature = np.where(record.temperature_used, record.temperature_degC, np.nan)
    sigma_K = max(LEAST_NOISE_K, 0.3 * record.step_K, own_noise(temperature))
    return Told(
        temperature, output, sigma_K, LEAST_NOISE_DEC if output is None else max(LEAST_NOISE_DEC, own_noise(output))
    )


def own_noise(readings: Array) -> float:
    """Of readings, nan where there is none, from row to row; 0 where they are too few to tell."""
    finite = readings[np.isfinite(readings)]
    return rough_noise(finite) if finite.size >= FEWEST_FOR_NOISE else 0.0
