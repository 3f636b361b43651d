"""What a film went through while rows were missing, as the readings after each gap tell.

While rows are missing the temperature is unknown: it may have gone beyond both of the gap's ends and come back, and the
film remembers it. Of such a course only the last turning point and one on the other side before it count for most of
what follows; far enough out they are saturation. Where none makes the readings after a gap much likelier the
temperature is taken to have gone straight through it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from compensator.hysteresis.functions import Array
from sim.inference.film.multistart import mean_square
from sim.inference.film.rows import Prepared, Start
from sim.inference.film.variable_projection import Problem
from sim.model.gaps import beyond_ends, there_and_back

MARGIN: Final = 0.25  # of the record's range: so far beyond it may a film have gone unseen
GAIN: Final = 0.03  # of the mean square, and ...
WORTH: Final = 6.0  # ... log-likelihood that an excursion has to bring, for each of its temperatures
PASSES: Final = 2  # over the gaps: what the film went through in one changes what it remembers after the next
CLOSE_K: Final = 0.01  # to which a temperature is looked for
_NOWHERE: Final[tuple[float, ...]] = ()  # straight from one row to the next


def through_gaps(
    records: Sequence[Prepared],
    chosen: Sequence[NDArray[np.bool_]],
    starts: Sequence[Start],
    fit: Problem,
    theta: Array,
) -> list[Start]:
    """The starts with what the film went through in each long gap, so that it fits best at theta."""
    best = list(starts)
    for _ in range(PASSES):
        before = list(best)
        for number, record in enumerate(records):
            for row in record.longest_unseen:
                best = _OneGap(records, chosen, best, fit, theta, number, int(row)).best()
        if best == before:
            break
    return best


class _OneGap:
    """One gap of one record, all else as it is."""

    def __init__(
        self,
        records: Sequence[Prepared],
        chosen: Sequence[NDArray[np.bool_]],
        starts: list[Start],
        fit: Problem,
        theta: Array,
        number: int,
        row: int,
    ) -> None:
        self._given = records, chosen, fit, theta
        self._starts, self._number, self._row = starts, number, row
        self._readings = sum(int(np.sum(c & r.used)) for c, r in zip(chosen, records, strict=True))
        record = records[number]
        ends = record.inputs[row - 1 : row + 1]
        self._time_s = float(record.time_s[row])
        self._below, self._above = float(np.min(ends)), float(np.max(ends))
        self._lower, self._higher = beyond_ends(ends, record.inputs, MARGIN)

    def best(self) -> list[Start]:
        """All starts, that of the gap's record with the excursion that is worth the most."""
        known = dict(self._starts[self._number].passed_degC).get(self._time_s, _NOWHERE)
        singles = [(degC,) for degC in (*self._lower, *self._higher)]
        found, square = _NOWHERE, self._square(_NOWHERE)
        for tried in (singles, there_and_back(self._lower, self._higher)):
            likely = min([*tried, *([known] if len(known) == len(tried[0]) else [])], key=self._square)
            closer = self._closer(likely)
            less, more = self._square(closer), len(closer) - len(found)
            gained = 0.5 * self._readings * math.log(max(square, 1e-300) / max(less, 1e-300))
            if less < (1.0 - GAIN) * square and gained > WORTH * more:
                found, square = closer, less
        return self._with(found)

    def _closer(self, passed: tuple[float, ...]) -> tuple[float, ...]:
        """Each of the temperatures at its best, between those tried beside it, the last one first."""
        for place in reversed(range(len(passed))):
            side = [self._below, *self._lower] if passed[place] < self._below else [self._above, *self._higher]
            far = sorted(side, key=lambda degC, at=passed[place]: abs(degC - at))[1:3]  # type: ignore[misc]
            low, high = min(far[0], far[1], passed[place]), max(far[0], far[1], passed[place])

            def square(degC: float, place: int = place, passed: tuple[float, ...] = passed) -> float:
                return self._square((*passed[:place], degC, *passed[place + 1 :]))

            at = minimize_scalar(square, bounds=(low, high), method="bounded", options={"xatol": CLOSE_K})
            if at.fun < self._square(passed):
                passed = (*passed[:place], float(at.x), *passed[place + 1 :])
        return passed

    def _square(self, passed: tuple[float, ...]) -> float:
        records, chosen, fit, theta = self._given
        return mean_square(records, chosen, self._with(passed), fit, theta)

    def _with(self, passed: tuple[float, ...]) -> list[Start]:
        start = self._starts[self._number]
        others = {time_s: degC for time_s, degC in start.passed_degC if time_s != self._time_s}
        if passed:
            others[self._time_s] = passed
        start = replace(start, passed_degC=tuple(sorted(others.items())))
        return [*self._starts[: self._number], start, *self._starts[self._number + 1 :]]


def gap_notes(record: Prepared, start: Start) -> list[str]:
    """A line on a record's gaps, if it has any: how long, and what was made of the film's memory in them."""
    if not record.gaps.size:
        return []
    count, longest_s = record.gaps.size, float(np.max(record.gap_s))
    seen = f"{record.name}: {count} gap{'s' * (count > 1)} in time, the longest of {longest_s:.3g} s: "
    if not record.unseen.size:
        return [f"{seen}too short for the temperature to have turned round; in between it is taken as monotone."]
    looked = record.longest_unseen.size
    after = "it" if count == 1 else "each" if looked == count else f"the {looked} longest" if looked > 1 else "that one"
    made = f"{seen}the temperature in between is unknown, so the film's memory after {after} is estimated anew"
    if not start.passed_degC:
        return [f"{made}: no excursion shows in the readings that follow."]
    shown = [f"{' and '.join(f'{t:.1f}' for t in degC)} degC before {at:g} s" for at, degC in start.passed_degC]
    return [f"{made}, as if the temperature had gone to {'; to '.join(shown)}."]
