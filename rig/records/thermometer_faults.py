"""The rows in which a thermometer's readings are false: a fault value, or a value that stands still while the film or
the plate moves.

The readings are split into runs of equal ones: a run is one reading, however many rows repeat it. No model is fitted;
the film's resistance and the current are witnesses of the temperature.

- If the temperature jumps by far more than in the steps around (`JUMP`) and no witness jumps with it, the fewest runs
  beside the jump without which the readings go on as before are false: a fault value ends with another jump, and so
  does the standstill of a thermometer.
- If a thermometer's readings flicker wherever it is read, equal readings are a standstill if a witness moves meanwhile
  and chance makes so many in less than one record in a thousand (`CHANCE`).
- If the last readings of a record are equal, and the film meanwhile goes to a resistance that it has elsewhere only far
  from their temperature (`FAR_OFF`), they are false, however coarse the last digit is.

A thermometer that rounds, or is slower than the rows, repeats readings too; but then its other steps are as large, and
its other runs as long.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import KELVIN, Array

AROUND = 8  # steps on either side of a jump that give the usual step
SKIPPED = 3  # the largest of them on either side: two fault values in a row make three jumps
JUMP = 4.0  # usual steps: a corner, an overshoot, a flicker of the last digit reach two
WITNESS_ROWS = 5  # rows up to a jump, and from it on, in which a witness shows it
WITNESS_JUMP = 3.0  # times the usual change of a current, or the other changes of a film close by
WITNESS_BEND = 1.5  # times the change of a film before: it turns, or follows late
LEAST_FILM_SHARE = 0.02  # of its range, that a film changes by for a jump over the whole range of the temperature
UNWITNESSED_K = 40.0  # in a row: without a witness, more than any plate moves
LONG = 1.5  # times all runs but a few: no rounding, and no slow thermometer
MOST_RUNS = 6  # of one fault: several fault values may follow each other
CHANCE = 1e-3  # share of the records without a fault in which a reading is taken for one
FLICKER = 0.3  # chance of two equal readings, above which a thermometer may stand still at rest
BLOCKS = 12  # parts of a record; the thermometer's noise is that of the second quietest
FEWEST = 16  # readings that show how a thermometer reads
OFTEN = 3  # a thermometer that stands still in more places does so by nature
MOVES = 8.0  # standard deviations of a witness's own noise
FAR_OFF = 0.35  # of the temperature's range: a film that lags or drifts stays nearer
FAR_DIGITS = 10.0  # last digits; a converter that loses a few bits stays nearer
LAST_ROWS = 3  # rows that show where the film is at the end
SAME_SHARE = 0.02  # of a witness's range: the film is where it was
MOST_STRETCHES = 5  # of rows in a sentence
COLD = "absolute zero (0 K) or below is no temperature"
FAULT = "a fault value: the temperature jumps there and back, and neither film nor current does"
EDGE = "a fault value: one jump separates them from all other readings, and neither film nor current jumps"
STILL = "the thermometer stands still while the film or the current moves"


@dataclass(frozen=True)
class FalseReadings:
    """Rows first..last (from 0, both included) in which a thermometer reads degC and is wrong, and why."""

    first: int
    last: int
    degC: float
    why: str

    def document(self, time_s: Array) -> dict[str, Any]:
        """Return the readings for the JSON; rows from 1."""
        when = {"from_s": float(time_s[self.first]), "to_s": float(time_s[self.last])}
        what = {"column": "temperature_degC", "rows": [self.first + 1, self.last + 1], **when}
        return {**what, "reads_degC": self.degC, "rule": self.why}


def find_false_readings(columns: Mapping[str, Array]) -> list[FalseReadings]:
    """Return the false readings of a record's thermometer, in the order of time.

    columns: `time_s`, `temperature_degC` (nan: no reading) and, if there are any, `resistance_ohm` and `current_A`,
    each of shape (rows,).
    """
    degC = columns.get("temperature_degC")
    if degC is None:
        return []
    cold = np.flatnonzero(degC <= -KELVIN)
    found = [
        FalseReadings(int(rows[0]), int(rows[-1]), float(degC[rows[0]]), COLD)
        for rows in np.split(cold, np.flatnonzero(np.diff(cold) > 1) + 1)
        if rows.size
    ]
    rows = np.flatnonzero(np.isfinite(degC) & (degC > -KELVIN))
    if rows.size >= FEWEST and np.ptp(degC[rows]) > 0.0:
        found += _Runs(rows, columns).find_false()
    return sorted(found, key=lambda one: one.first)


def describe_false_readings(false: Sequence[FalseReadings], time_s: Array) -> list[str]:
    """Return a sentence for each value that a thermometer falsely reads, with its rows."""
    alike: dict[tuple[float, str], list[FalseReadings]] = {}
    for one in false:
        alike.setdefault((one.degC, one.why), []).append(one)
    lines = []
    for (degC, why), several in alike.items():
        first, last = several[0].first, several[-1].last
        rows = [f"{a.first + 1}" + (f" to {a.last + 1}" if a.last > a.first else "") for a in several]
        more = f" and {len(rows) - MOST_STRETCHES} more" if len(rows) > MOST_STRETCHES else ""
        word, reads = ("row", "reads") if first == last else ("rows", "read")
        when = f"{time_s[first]:.12g}" + (f" to {time_s[last]:.12g}" if last > first else "")
        where = f"{word} {', '.join(rows[:MOST_STRETCHES])}{more} ({when} s)"
        lines.append(f"temperature_degC: {where} {reads} {degC:.6g} degC: {why}; left out")
    return lines


def mask_readings(degC: Array, false: Iterable[FalseReadings]) -> Array:
    masked = degC.copy()
    for one in false:
        masked[one.first : one.last + 1] = np.nan
    return masked


class _Runs:
    """The runs of equal readings: `value` (degC), `length` (readings), `first` and `last` row; shape (runs,)."""

    def __init__(self, rows: NDArray[np.intp], columns: Mapping[str, Array]) -> None:
        degC, self.time = columns["temperature_degC"][rows], columns["time_s"]
        self.witnesses = _find_witnesses(columns)
        begin = np.flatnonzero(np.concatenate(([True], np.diff(degC) != 0.0)))
        self.length = np.diff(np.append(begin, rows.size))
        self.value, self.first, self.last = degC[begin], rows[begin], rows[begin + self.length - 1]
        self.second = rows[np.minimum(begin + 1, rows.size - 1)]
        self.steps = np.abs(np.diff(self.value))
        self.digit = float(np.min(self.steps))
        self.usual = np.maximum(_usual_steps(self.steps), self.digit)
        self.large = float(np.quantile(self.steps, 0.9))
        self.slow = math.ceil(np.quantile(self.length, 0.95))  # rows of a reading, if it is slower than the rows
        self.long = LONG * max(self.slow, int(np.sort(self.length)[-OFTEN - 1 :][0]))
        self.span = max(_span(degC), self.digit)
        self.why: dict[int, str] = {}  # by run

    def find_false(self) -> list[FalseReadings]:
        for _ in range(2):  # the second time the values of the first are known to be false
            for jump in self._unwitnessed_jumps():
                if jump not in self.why and jump + 1 not in self.why:
                    self._explain(jump)
        self._find_standstill()
        self._find_last_standstill()
        found = []
        for run, why in sorted(self.why.items()):
            repeated = why == STILL and run > 0 and self.length[run] > 1  # the first reading of a standstill is true
            first = self.second[run] if repeated else self.first[run]
            found.append(FalseReadings(int(first), int(self.last[run]), float(self.value[run]), why))
        return found

    def _unwitnessed_jumps(self) -> list[int]:
        """Return the runs after which the temperature jumps and no witness does."""
        waited = self.time[self.first[1:]] - self.time[self.last[:-1]]
        usual = self.usual * np.maximum(waited / float(np.median(np.diff(self.time))), 1.0)
        stands = (self.length > self.slow) | np.isin(self.value, [self.value[run] for run in self.why])
        near = np.convolve(stands, np.ones(2 * MOST_RUNS))[MOST_RUNS:][: self.steps.size] > 0.0
        jumps = np.flatnonzero((self.steps > JUMP * usual) & (near | (self.steps > JUMP * self.large)))
        return [run for run in jumps.tolist() if self._is_unwitnessed(run)]

    def _is_unwitnessed(self, run: int) -> bool:
        shown = [self._is_shown(witness, run) for witness in self.witnesses]
        return True not in shown and (False in shown or bool(self.steps[run] > UNWITNESSED_K))

    def _is_shown(self, witness: _Witness, run: int) -> bool | None:
        """Return True if a witness shows the jump after a run, at the pace of the rows or of the readings; None if it
        has no values there."""
        rows = int(self.last[run]), int(self.first[run + 1])
        share = float(self.value[run + 1] - self.value[run]) / self.span
        shown = [witness.jumps(*rows, share, every) for every in {1, self.slow}]
        return True if True in shown else False if False in shown else None

    def _explain(self, jump: int) -> None:
        """Mark the fewest runs beside a jump without which the readings go on, if there are any."""
        end = self.value.size - 1
        found: list[tuple[range, str]] = []
        ahead = (range(jump + 1, last + 1) for last in range(jump + 1, min(jump + MOST_RUNS, end - 1) + 1))
        behind = (range(first, jump + 1) for first in range(jump, max(jump - MOST_RUNS, 0), -1))
        for blocks in (ahead, behind):
            found += [(block, FAULT) for block in blocks if self._is_aside(block) and not self._film_follows(block)][:1]
        if jump > 0 and self._moves(jump) and self.length[jump] > self.long:
            found.append((range(jump, jump + 1), STILL))
        for run in (run for run, edge in ((jump, 0), (jump + 1, end)) if run == edge):
            if self.length[run] > self.long or not self._moves(run, films_only=True):
                found.append((range(run, run + 1), EDGE))
        found = [(block, why) for block, why in found if self._repeats(block, why, float(self.steps[jump]))]
        if found:
            block, why = min(found, key=lambda one: (len(one[0]), one[1] == STILL))
            self.why.update(dict.fromkeys(block, why))

    def _repeats(self, block: range, why: str, jump_K: float) -> bool:
        """Return True if one of some runs is longer than usual (longer than one reading after a large jump), or has the
        value of a false run."""
        large = jump_K > JUMP * self.large
        longest = int(np.max(self.length[block]))
        if why == EDGE:
            return large and longest > 1
        false = [self.value[run] for run in self.why]
        return longest > self.slow or (large and longest > 1) or bool(np.any(np.isin(self.value[block], false)))

    def _film_follows(self, block: range) -> bool:
        """Return True if the film jumps at either end of some runs. A current may jump as a controller's answer."""
        films = [witness for witness in self.witnesses if witness.is_film]
        return any(self._is_shown(film, run) for film in films for run in (block[0] - 1, block[-1]))

    def _is_aside(self, block: range) -> bool:
        """Return True if the readings go on without some runs, and these are far from the readings on both sides."""
        before, after = block[0] - 1, block[-1] + 1
        ends = self.value[[before, after]]
        off = np.maximum(np.min(ends) - self.value[block], self.value[block] - np.max(ends))
        far = max(JUMP * self.usual[before], FAR_DIGITS * self.digit)
        apart = np.abs(np.diff(self.value[block]))  # several fault values are far from each other, too
        if not (np.all(off > far) and np.all(apart > far)):
            return False
        around = self.time[self.first[max(before - AROUND, 0) : after + AROUND + 1]]
        pace = self.usual[before] / float(np.median(np.diff(around)))
        passed_s = float(self.time[self.first[after]] - self.time[self.last[before]])
        return bool(abs(ends[1] - ends[0]) <= JUMP * self.usual[before] + pace * passed_s)

    def _moves(self, run: int, films_only: bool = False) -> bool:
        rows = int(self.first[run]), int(self.last[run])
        return any(witness.moves(*rows) for witness in self.witnesses if witness.is_film or not films_only)

    def _find_standstill(self) -> None:
        """Mark runs that are longer than chance makes them, of a thermometer that flickers."""
        rest = ~np.isin(np.arange(self.value.size), list(self.why))
        noise = _noise(self.time[self.first[rest]], self.value[rest])
        chance = self.digit / (noise * math.sqrt(2.0 * math.pi)) if noise > 0.0 else 1.0
        if chance > FLICKER:
            return
        longest = self.slow * (1.0 + math.log(self.value.size / CHANCE) / -math.log(chance))
        long = np.flatnonzero(rest & (self.length > max(longest, self.long))).tolist()
        self.why.update({run: STILL for run in long if self._moves(run)})

    def _find_last_standstill(self) -> None:
        """Mark the last run if the film goes meanwhile to where it is elsewhere only far from its temperature."""
        end = self.value.size - 1
        film = next((witness for witness in self.witnesses if witness.is_film), None)
        if film is None or end in self.why or self.length[end] < FEWEST or not self._moves(end, films_only=True):
            return
        there = film.values[self.first[end] : self.last[end] + 1]
        goes_to = float(np.median(there[np.isfinite(there)][-LAST_ROWS:]))
        close = np.abs(film.values - goes_to) <= max(4.0 * film.noise, SAME_SHARE * film.span)
        runs = [run for run in range(end) if run not in self.why]
        same = [run for run in runs if np.any(close[self.first[run] : self.last[run] + 1])]
        off = np.abs(self.value[same] - self.value[end])
        if off.size and np.min(off) > max(FAR_OFF * self.span, FAR_DIGITS * self.digit):
            self.why[end] = STILL


@dataclass(frozen=True, eq=False)
class _Witness:
    """Another quantity that shows a change of the temperature: log10 of the film's resistance, or the current.

    values: of shape (rows,), nan for none. noise: standard deviation from row to row. usual: change over four rows that
    three quarters do not reach. span: range without the extremes. A film shows a change when it comes or soon after, a
    current before.
    """

    values: Array
    noise: float
    usual: float
    span: float
    is_film: bool

    def jumps(self, before: int, after: int, share: float, every: int) -> bool | None:
        """Return True if the witness shows a jump of the temperature, by a share of its range, between two rows; None
        if it has no values there. every: the rows between readings."""
        on = before + every * np.arange(1 - WITNESS_ROWS, 1)
        earlier = self.values[on[on >= 0]]
        if not self.is_film:
            earlier = earlier[np.isfinite(earlier)]
            if earlier.size and on[0] < 0 and earlier[0] * share > 0.0:  # it is switched on in the first row
                earlier = np.append(0.0, earlier)
            return bool(np.ptp(earlier) > WITNESS_JUMP * every * self.usual) if earlier.size else None
        least = LEAST_FILM_SHARE * abs(share) * self.span
        on = np.append(before, after + every * np.arange(WITNESS_ROWS - 2))
        later = self.values[on[on < self.values.size]]
        earlier, later = earlier[:-1][np.isfinite(earlier[:-1])], later[np.isfinite(later)]
        if earlier.size < 2 or later.size < 2:
            return None
        about = self.values[max(before - every, 0) : after + WITNESS_ROWS - 1]
        steps = np.sort(np.abs(np.diff(about[np.isfinite(about)])))
        # A slow thermometer shows the jump of an abrupt film late.
        if steps.size >= WITNESS_ROWS and steps[-1] > max(WITNESS_JUMP * steps[-3] + 6.0 * self.noise, least):
            return True
        slope = (earlier[-1] - earlier[0]) / (earlier.size - 1)
        bend = np.max(np.abs(later - earlier[-1] - slope * np.arange(1, later.size + 1)))
        return bool(bend > max(WITNESS_BEND * np.ptp(earlier) + 4.0 * self.noise, least))

    def moves(self, first: int, last: int) -> bool:
        """Return True if the witness moves in rows first..last by more than its noise."""
        seen = self.values[first : last + 1]
        seen = seen[np.isfinite(seen)]
        return seen.size > 1 and float(np.ptp(seen)) > MOVES * self.noise


def _find_witnesses(columns: Mapping[str, Array]) -> list[_Witness]:
    found = []
    for name in ("resistance_ohm", "current_A"):
        values = columns.get(name, np.empty(0))
        if np.sum(np.isfinite(values)) < FEWEST:
            continue
        film = name == "resistance_ohm"
        good = np.isfinite(values) & ((values > 0.0) if film else True)
        shown = np.full(values.size, np.nan)
        seen = shown[good] = np.log10(values[good]) if film else values[good]
        noise = 1.4826 * float(np.median(np.abs(np.diff(seen, 2)))) / math.sqrt(6.0) if seen.size > 2 else 0.0
        apart = WITNESS_ROWS - 1
        usual = float(np.quantile(np.abs(seen[apart:] - seen[:-apart]), 0.75))
        found.append(_Witness(shown, max(noise, 1e-9), usual, _span(seen), film))
    return found


def _span(values: Array) -> float:
    return float(np.subtract(*np.quantile(values, [0.95, 0.05])))


def _usual_steps(steps: Array) -> Array:
    """Return the usual step around each: the fourth largest of eight before it or after it, whichever is more."""
    padded = np.concatenate((np.zeros(AROUND), steps, np.zeros(AROUND)))
    sides = np.lib.stride_tricks.sliding_window_view(padded, AROUND)
    place = AROUND - 1 - SKIPPED
    blocks = (sides[k : k + 100_000] for k in range(0, len(sides), 100_000))  # a sorted copy of all would be large
    usual = np.concatenate([np.partition(block, place, axis=1)[:, place] for block in blocks])
    return np.asarray(np.maximum(usual[: steps.size], usual[AROUND + 1 : AROUND + 1 + steps.size]), dtype=np.float64)


def _noise(time_s: Array, degC: Array) -> float:
    """Return the standard deviation (K) of a thermometer's noise in a quiet part: from the changes of the deviation
    from a straight line between neighbours, which a smooth course leaves small."""
    weight = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    changes = np.abs(np.diff(degC[1:-1] - (degC[:-2] + weight * (degC[2:] - degC[:-2]))))
    if changes.size < FEWEST:
        return 0.0
    parts = np.array_split(changes, min(BLOCKS, changes.size // FEWEST))
    quiet = sorted(1.4826 * float(np.median(part)) / math.sqrt(5.0) for part in parts)
    return quiet[min(1, len(quiet) - 1)]
