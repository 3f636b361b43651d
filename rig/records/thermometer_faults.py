"""Find the rows in which a thermometer lies: it stands at a fault value, or stands still while film or plate move.

The readings are cut into runs of equal ones: a run is one reading, however many rows repeat it. No model is fitted.
The film's resistance and the current are witnesses of the temperature.

- Where the temperature jumps by far more than in the steps around it (`SUDDEN`), and no witness jumps with it, the few
  runs beside the jump are false without which the readings go on as usual: a fault value is left again by a jump, and a
  thermometer that stood still catches up by one.
- Of a thermometer whose readings flicker wherever it is read, many equal ones are no readings where a witness moves
  meanwhile: chance makes so many in less than one record in a thousand (`CHANCE`).
- Where the last readings of a record are equal, and the film goes meanwhile to where it is else seen only at
  temperatures far from theirs (`FAR_OFF`), they are false, however coarse the last digit is.

A thermometer that rounds, or that is slower than the rows, repeats readings by nature; but then its other steps are as
large, and its other runs as long.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import KELVIN, Array

Rows = NDArray[np.int64]
AROUND: Final = 8  # steps on either side of a jump that say how far the temperature goes from reading to reading
SKIPPED: Final = 3  # the largest of them on either side: two fault values that follow each other make three jumps
SUDDEN: Final = 4.0  # usual steps: a corner, an overshoot, a last digit's flicker make up to two
BESIDE: Final = 4  # rows on either side of a jump in which a witness shows it
WITNESSED: Final = 3.0  # times what a current changes in as many rows at most times, or a film in the rows about
BENDS: Final = 1.5  # times what a witness moved before: it jumps or turns, too, or follows late
LEAST_SHOWN: Final = 0.02  # share of its range that a film shows of a jump by the range of the temperature at the least
UNWITNESSED_K: Final = 40.0  # where there is no witness: no plate moves by as much in a row
LONGER: Final = 1.5  # times the runs of the record but for a few: no rounding, and no slow thermometer
ASIDE: Final = 6  # runs at most that a fault consists of: several fault values may follow each other
CHANCE: Final = 1e-3  # in how many records without a fault one reading is taken for one
FLICKERS: Final = 0.3  # chance of two equal readings, above which a thermometer may well stand still at rest
BLOCKS: Final = 12  # parts of a record; the noise of a thermometer is that of the second quietest
FEWEST: Final = 16  # readings that tell how a thermometer reads
OFTEN: Final = 3  # a thermometer that stands still in more places does so by nature
MOVES: Final = 8.0  # standard deviations of a witness's own noise
FAR_OFF: Final = 0.35  # of the record's range: a film that lags or drifts stays nearer while the temperature stands
FAR_DIGITS: Final = 10.0  # last digits by which a false value is off at the least: converters lose a few bits at times
ENDS_WITH: Final = 3  # rows that say where the film is at last
ON_RANGE: Final = 0.02  # of the witness's range: the film is where it was
ROWS_TOLD: Final = 5  # stretches of rows in a sentence
COLD = "absolute zero (0 K) or below is no temperature"
FAULT = "a fault value: the temperature jumps there and back, and neither film nor current does"
EDGE = "a fault value: one jump parts them from all other readings, and neither film nor current jumps"
STILL = "the thermometer stands still while the film or the current moves"


@dataclass(frozen=True)
class FalseReadings:
    """Rows first..last (from 0, both included) in which a thermometer reads degC and is not believed, and why."""

    first: int
    last: int
    degC: float
    why: str

    def document(self, time_s: Array) -> dict[str, Any]:
        """Return the same for the JSON; rows from 1."""
        when = {"from_s": float(time_s[self.first]), "to_s": float(time_s[self.last])}
        what = {"column": "temperature_degC", "rows": [self.first + 1, self.last + 1], **when}
        return {**what, "reads_degC": self.degC, "rule": self.why}


def false_readings(columns: Mapping[str, Array]) -> list[FalseReadings]:
    """Find the rows of a record in which the thermometer lies, in the order of time.

    columns: `time_s`, `temperature_degC` (nan: no reading) and, as far as they are there, `resistance_ohm` and
    `current_A`, each of shape (rows,).
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
        found += _Runs(rows, columns).false()
    return sorted(found, key=lambda one: one.first)


def false_lines(false: Sequence[FalseReadings], time_s: Array) -> list[str]:
    """Return a sentence for each value that a thermometer falsely reads, with its rows, for people."""
    alike: dict[tuple[float, str], list[FalseReadings]] = {}
    for one in false:
        alike.setdefault((one.degC, one.why), []).append(one)
    lines = []
    for (degC, why), several in alike.items():
        first, last = several[0].first, several[-1].last
        rows = [f"{a.first + 1}" + (f" to {a.last + 1}" if a.last > a.first else "") for a in several]
        more = f" and {len(rows) - ROWS_TOLD} more" if len(rows) > ROWS_TOLD else ""
        word, reads = ("row", "reads") if first == last else ("rows", "read")
        when = f"{time_s[first]:.12g}" + (f" to {time_s[last]:.12g}" if last > first else "")
        where = f"{word} {', '.join(rows[:ROWS_TOLD])}{more} ({when} s)"
        lines.append(f"temperature_degC: {where} {reads} {degC:.6g} degC: {why}; left out")
    return lines


def without(degC: Array, false: Iterable[FalseReadings]) -> Array:
    """Return readings with nan in the rows that are false."""
    believed = degC.copy()
    for one in false:
        believed[one.first : one.last + 1] = np.nan
    return believed


class _Runs:
    """The runs of equal readings: `value` (degC), `length` (readings), `first` and `last` row; shape (runs,) each."""

    def __init__(self, rows: Rows, columns: Mapping[str, Array]) -> None:
        degC, self.time = columns["temperature_degC"][rows], columns["time_s"]
        self.witnesses = _witnesses(columns)
        begin = np.flatnonzero(np.concatenate(([True], np.diff(degC) != 0.0)))
        self.length = np.diff(np.append(begin, rows.size))
        self.value, self.first, self.last = degC[begin], rows[begin], rows[begin + self.length - 1]
        self.second = rows[np.minimum(begin + 1, rows.size - 1)]
        self.steps = np.abs(np.diff(self.value))
        self.digit = float(np.min(self.steps))
        self.usual = np.maximum(_usual(self.steps), self.digit)
        self.most = float(np.quantile(self.steps, 0.9))
        self.slow = math.ceil(np.quantile(self.length, 0.95))  # rows of a reading, where it is slower than the rows
        few = np.sort(self.length)[-OFTEN - 1 :][0]  # what stands still more often does so by nature
        self.long = LONGER * max(self.slow, int(few))
        self.span = max(_span(degC), self.digit)
        self.why: dict[int, str] = {}  # of each run that is false

    def false(self) -> list[FalseReadings]:
        for _ in range(2):  # once more, for a value that is known to be false by then
            for jump in self._jumps():
                if jump not in self.why and jump + 1 not in self.why:
                    self._blame(jump)
        self._too_many_alike()
        self._film_elsewhere()
        found = []
        for run, why in sorted(self.why.items()):
            read = why == STILL and run > 0 and self.length[run] > 1  # it was read once, and then repeated
            first = self.second[run] if read else self.first[run]
            found.append(FalseReadings(int(first), int(self.last[run]), float(self.value[run]), why))
        return found

    def _jumps(self) -> list[int]:
        """Return the runs after which the temperature jumps, and no witness does."""
        waited = self.time[self.first[1:]] - self.time[self.last[:-1]]
        usual = self.usual * np.maximum(waited / float(np.median(np.diff(self.time))), 1.0)
        stands = (self.length > self.slow) | np.isin(self.value, [self.value[run] for run in self.why])
        near = np.convolve(stands, np.ones(2 * ASIDE))[ASIDE:][: self.steps.size] > 0.0
        sudden = (self.steps > SUDDEN * usual) & (near | (self.steps > SUDDEN * self.most))
        return [int(run) for run in np.flatnonzero(sudden) if self._alone(int(run))]

    def _alone(self, run: int) -> bool:
        """Whether the temperature jumps after a run, and no witness does."""
        told = [self._shown(witness, run) for witness in self.witnesses]
        return True not in told and (False in told or bool(self.steps[run] > UNWITNESSED_K))

    def _shown(self, witness: _Witness, run: int) -> bool | None:
        """Whether a witness shows the jump after a run: in the rows beside it or, as a thermometer that is slower than
        the rows shows in one of them what came before, in those that are readings of it; None: it has none there."""
        rows = int(self.last[run]), int(self.first[run + 1])
        share = float(self.value[run + 1] - self.value[run]) / self.span
        told = [witness.jumps(*rows, share, every) for every in {1, self.slow}]
        return True if True in told else False if False in told else None

    def _blame(self, jump: int) -> None:
        """Find the fewest runs beside a jump without which the readings go on, if there are any."""
        end = self.value.size - 1
        found: list[tuple[range, str]] = []
        ahead = (range(jump + 1, last + 1) for last in range(jump + 1, min(jump + ASIDE, end - 1) + 1))
        behind = (range(first, jump + 1) for first in range(jump, max(jump - ASIDE, 0), -1))
        for blocks in (ahead, behind):
            found += [(block, FAULT) for block in blocks if self._aside(block) and not self._followed(block)][:1]
        if jump > 0 and self._moves(jump) and self.length[jump] > self.long:
            found.append((range(jump, jump + 1), STILL))
        ends = [run for run, edge in ((jump, 0), (jump + 1, end)) if run == edge]
        found += [
            (range(run, run + 1), EDGE) for run in ends if self.length[run] > self.long or not self._moves(run, (True,))
        ]
        found = [(block, why) for block, why in found if self._stands(block, why, float(self.steps[jump]))]
        if found:
            block, why = min(found, key=lambda one: (len(one[0]), one[1] == STILL))
            self.why.update(dict.fromkeys(block, why))

    def _stands(self, block: range, why: str, jump_K: float) -> bool:
        """Whether a run among some repeats its reading, in more rows than others do if the jump is no large one, or has
        the value of a run known to be false."""
        apart = jump_K > SUDDEN * self.most
        longest = int(np.max(self.length[block]))
        if why == EDGE:
            return apart and longest > 1
        false = [self.value[run] for run in self.why]
        return longest > self.slow or (apart and longest > 1) or bool(np.any(np.isin(self.value[block], false)))

    def _followed(self, block: range) -> bool:
        """Whether the film jumps at either end of some runs. A current that does may be a controller's answer."""
        films = [witness for witness in self.witnesses if witness.is_film]
        return any(self._shown(film, run) for film in films for run in (block[0] - 1, block[-1]))

    def _aside(self, block: range) -> bool:
        """Whether the readings on either side of some runs go on without them, and these lie off both."""
        ends = self.value[[block[0] - 1, block[-1] + 1]]
        off = np.maximum(np.min(ends) - self.value[block], self.value[block] - np.max(ends))
        far = max(SUDDEN * self.usual[block[0] - 1], FAR_DIGITS * self.digit)
        apart = np.abs(np.diff(self.value[block]))  # several fault values are far from each other, too
        return bool(np.all(off > far) and np.all(apart > far)) and self._goes_on(block[0] - 1, block[-1] + 1)

    def _goes_on(self, before: int, after: int) -> bool:
        """Whether a reading may follow another one, at the pace of those around."""
        around = self.time[self.first[max(before - AROUND, 0) : after + AROUND + 1]]
        pace = self.usual[before] / float(np.median(np.diff(around)))
        passed_s = float(self.time[self.first[after]] - self.time[self.last[before]])
        allowed = SUDDEN * self.usual[before] + pace * passed_s
        return bool(abs(self.value[after] - self.value[before]) <= allowed)

    def _moves(self, run: int, of: tuple[bool, ...] = (True, False)) -> bool:
        """Whether a witness moves during a run. of: which, films (True) or currents."""
        rows = int(self.first[run]), int(self.last[run])
        return any(witness.moves(*rows) for witness in self.witnesses if witness.is_film in of)

    def _too_many_alike(self) -> None:
        """Find runs that are longer than chance makes them, of a thermometer that flickers."""
        rest = ~np.isin(np.arange(self.value.size), list(self.why))
        noise = _noise(self.time[self.first[rest]], self.value[rest])
        chance = self.digit / (noise * math.sqrt(2.0 * math.pi)) if noise > 0.0 else 1.0
        if chance > FLICKERS:
            return
        longest = self.slow * (1.0 + math.log(self.value.size / CHANCE) / -math.log(chance))
        long = np.flatnonzero(rest & (self.length > max(longest, self.long))).tolist()
        self.why.update({run: STILL for run in long if self._moves(run)})

    def _film_elsewhere(self) -> None:
        """Find whether the film goes in the last run to where it is else seen only far from its temperature."""
        end = self.value.size - 1
        film = next((witness for witness in self.witnesses if witness.is_film), None)
        if film is None or end in self.why or self.length[end] < FEWEST or not self._moves(end, (True,)):
            return
        there = film.values[self.first[end] : self.last[end] + 1]
        goes_to = float(np.median(there[np.isfinite(there)][-ENDS_WITH:]))
        close = np.abs(film.values - goes_to) <= max(4.0 * film.noise, ON_RANGE * film.span)
        runs = [run for run in range(end) if run not in self.why]
        same = [run for run in runs if np.any(close[self.first[run] : self.last[run] + 1])]
        off = np.abs(self.value[same] - self.value[end])
        if off.size and np.min(off) > max(FAR_OFF * self.span, FAR_DIGITS * self.digit):
            self.why[end] = STILL


@dataclass(frozen=True, eq=False)
class _Witness:
    """What else shows a change of the temperature: log10 of the film's resistance, or the current.

    values: (rows,), nan where there is none; noise: their standard deviation from row to row; usual: how far they
    go in `BESIDE` rows at most times; span: nearly their range. A film shows a change when it comes or soon after, a
    current before.
    """

    values: Array
    noise: float
    usual: float
    span: float
    is_film: bool

    def jumps(self, before: int, after: int, share: float, every: int) -> bool | None:
        """Whether it shows a jump of the temperature, by a share of the range, between two rows; None if it has no
        values there. every: one in so many rows is looked at."""
        on = before + every * np.arange(-BESIDE, 1)
        earlier = self.values[on[on >= 0]]
        if not self.is_film:
            earlier = earlier[np.isfinite(earlier)]
            if earlier.size and on[0] < 0 and earlier[0] * share > 0.0:  # it comes on in the first row
                earlier = np.append(0.0, earlier)
            return bool(np.ptp(earlier) > WITNESSED * every * self.usual) if earlier.size else None
        least = LEAST_SHOWN * abs(share) * self.span
        on = np.append(before, after + every * np.arange(BESIDE - 1))
        later = self.values[on[on < self.values.size]]
        earlier, later = earlier[:-1][np.isfinite(earlier[:-1])], later[np.isfinite(later)]
        if earlier.size < 2 or later.size < 2:
            return None
        about = self.values[max(before - every, 0) : after + BESIDE]
        steps = np.sort(
            np.abs(np.diff(about[np.isfinite(about)]))
        )  # a slow thermometer shows an abrupt film's jump late
        if steps.size > BESIDE and steps[-1] > max(WITNESSED * steps[-3] + 6.0 * self.noise, least):
            return True
        goes = (earlier[-1] - earlier[0]) / (earlier.size - 1)
        bend = np.max(np.abs(later - earlier[-1] - goes * np.arange(1, later.size + 1)))
        return bool(bend > max(BENDS * np.ptp(earlier) + 4.0 * self.noise, least))

    def moves(self, first: int, last: int) -> bool:
        """Whether it moves in rows first..last by more than its noise."""
        seen = self.values[first : last + 1]
        seen = seen[np.isfinite(seen)]
        return seen.size > 1 and float(np.ptp(seen)) > MOVES * self.noise


def _witnesses(columns: Mapping[str, Array]) -> list[_Witness]:
    found = []
    for name in ("resistance_ohm", "current_A"):
        values = columns.get(name)
        if values is None or np.sum(np.isfinite(values)) < FEWEST:
            continue
        film = name == "resistance_ohm"
        good = np.isfinite(values) & ((values > 0.0) if film else True)
        shown = np.full(values.size, np.nan)
        shown[good] = np.log10(values[good]) if film else values[good]
        seen = shown[good]
        noise = 1.4826 * float(np.median(np.abs(np.diff(seen, 2)))) / math.sqrt(6.0) if seen.size > 2 else 0.0
        usual = float(np.quantile(np.abs(seen[BESIDE:] - seen[:-BESIDE]), 0.75))
        found.append(_Witness(shown, max(noise, 1e-9), usual, _span(seen), film))
    return found


def _span(values: Array) -> float:
    """Return how far nearly all values are apart."""
    return float(np.subtract(*np.quantile(values, [0.95, 0.05])))


def _usual(steps: Array) -> Array:
    """Return how far the temperature goes in the steps around each: the third largest of eight before it or after it,
    whichever is more."""
    padded = np.concatenate((np.zeros(AROUND), steps, np.zeros(AROUND)))
    sides = np.lib.stride_tricks.sliding_window_view(padded, AROUND)
    place = AROUND - 1 - SKIPPED
    third = np.concatenate(
        [np.partition(sides[k : k + 100_000], place, axis=1)[:, place] for k in range(0, len(sides), 100_000)]
    )
    return np.asarray(np.maximum(third[: steps.size], third[AROUND + 1 : AROUND + 1 + steps.size]), dtype=np.float64)


def _noise(time_s: Array, degC: Array) -> float:
    """Return the standard deviation (K) of a thermometer's noise where it is least: from how the deviations from a
    straight line between neighbours change, which a smooth course leaves small."""
    weight = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    off = degC[1:-1] - (degC[:-2] + weight * (degC[2:] - degC[:-2]))
    changes = np.abs(np.diff(off))
    if changes.size < FEWEST:
        return 0.0
    parts = np.array_split(changes, min(BLOCKS, changes.size // FEWEST))
    least = sorted(1.4826 * float(np.median(part)) / math.sqrt(5.0) for part in parts)
    return least[min(1, len(least) - 1)]
