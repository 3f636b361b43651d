"""A film's memory where a record does not show it: at the first row, and after gaps in which it may have turned round.

At the first row a film was saturated at one end, and turned round at most once since. In a gap the temperature may have
gone beyond both of the gap's ends and come back; of such a course only the last turning point and one on the other side
before it count for most of what follows; far enough out they are saturation. Another memory than the one at hand has to
bring a gain of log-likelihood, for each of its temperatures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from compensator.hysteresis.functions import Array
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart, longest_gaps
from sim.model.recorded import Recorded

SEVERAL: Final = 12  # turning points before the first row that are tried, on either side
MARGIN: Final = 0.25  # of the range of temperatures: so far beyond them may a film have turned round
PASSES: Final = 2  # over the gaps: the turning points in one change the memory after the next
TRIED: Final = 8  # temperatures on either side of a gap's ends
NEAREST_K: Final = 0.1  # of them, beyond the ends: less is within a thermometer's error
CLOSE_K: Final = 0.01  # to which a temperature is looked for
Cost = Callable[[FilmStart], float]
Gap = tuple[float, Array]  # the time (s) of the row after it, the temperatures (degC) of the rows at its ends


def beginnings(first_degC: float, seen_degC: Array, start: FilmStart) -> list[FilmStart]:
    """Return the memories that a film may have at the first row, with the gaps' of `start`. seen_degC: all temperatures
    of the record."""
    low, high = float(np.min(seen_degC)), float(np.max(seen_degC))
    margin = MARGIN * (high - low)
    heated = replace(start, initial="heated", previous_degC=None)
    cooled = replace(heated, initial="cooled")
    below = np.linspace(low - margin, first_degC, SEVERAL + 1)[:-1].tolist()
    above = np.linspace(first_degC, high + margin, SEVERAL + 1)[1:].tolist()
    return [
        heated,
        cooled,
        *(replace(cooled, previous_degC=t) for t in below),
        *(replace(heated, previous_degC=t) for t in above),
    ]


def likeliest(starts: Iterable[FilmStart], known: FilmStart, cost: Cost, worth: float) -> FilmStart:
    """Return the memory of the least cost (minus log-likelihood), the known one if none brings what it has to."""
    costs = {start: cost(start) for start in starts}
    best = min(costs, key=costs.__getitem__)
    return best if costs[best] + worth < cost(known) else known


def closer(start: FilmStart, first_degC: float, step_K: float, cost: Cost) -> FilmStart:
    """Return the memory with the turning point before the first row at its best, within a step of where it is."""
    at = start.previous_degC
    if at is None:
        return start
    cooled = start.initial == "cooled"
    bounds = (at - step_K, min(at + step_K, first_degC)) if cooled else (max(at - step_K, first_degC), at + step_K)
    return replace(start, previous_degC=_least(lambda t: cost(replace(start, previous_degC=t)), bounds))


def gaps_of(record: Recorded, path: PlatePath) -> list[Gap]:
    """Return the gaps of a record that a film's memory is not known through. path: of the plate."""
    time = record.time_s
    return [(float(time[row]), path.at(time[[row - 1, row]])) for row in longest_gaps(record)]


def through_gaps(start: FilmStart, gaps: Sequence[Gap], seen_degC: Array, cost: Cost, worth: float) -> FilmStart:
    """Return the memory with what the film went through in each gap, straight from one end to the other where nothing
    is clearly better. seen_degC: all temperatures of the record; worth: log-likelihood that each temperature brings."""
    for _ in range(PASSES if gaps else 0):
        before = start
        for gap in gaps:
            start = _through(start, gap, seen_degC, cost, worth)
        if start == before:
            break
    return start


def _through(start: FilmStart, gap: Gap, seen_degC: Array, cost: Cost, worth: float) -> FilmStart:
    end_s, ends = gap
    lower, higher = _beyond_ends(ends, seen_degC)
    best = start.turning(end_s, ())
    least = cost(best)
    known = dict(start.passed_degC).get(end_s, ())
    for tried in ([(degC,) for degC in (*lower, *higher)], _there_and_back(lower, higher)):
        again = [known] if len(known) == len(tried[0]) else []
        costs = {two: cost(start.turning(end_s, two)) for two in [*tried, *again]}
        passed = min(costs, key=costs.__getitem__)
        if costs[passed] >= least:
            continue
        for place in reversed(range(len(passed))):
            side = [float(np.min(ends)), *lower] if passed[place] < np.min(ends) else [float(np.max(ends)), *higher]
            near = sorted(side, key=lambda degC, at=passed[place]: abs(degC - at))[1:3]  # type: ignore[misc]

            def moved(degC: float, place: int = place, passed: tuple[float, ...] = passed) -> FilmStart:
                return start.turning(end_s, (*passed[:place], degC, *passed[place + 1 :]))

            bounds = min(*near, passed[place]), max(*near, passed[place])
            at = _least(lambda t, moved=moved: cost(moved(t)), bounds)  # type: ignore[misc]
            if cost(moved(at)) < cost(moved(passed[place])):
                passed = (*passed[:place], at, *passed[place + 1 :])
        other = start.turning(end_s, passed)
        value, more = cost(other), len(passed) - len(dict(best.passed_degC).get(end_s, ()))
        if value + worth * more < least:
            best, least = other, value
    return best


def _beyond_ends(ends_degC: Array, seen_degC: Array) -> tuple[list[float], list[float]]:
    """Return where a film may have turned round in a gap, below and above the temperatures at its ends, the nearest
    first. seen_degC: all temperatures of the record."""
    below, above = float(np.min(ends_degC)), float(np.max(ends_degC))
    low, high = float(np.min(seen_degC)), float(np.max(seen_degC))
    beyond = MARGIN * (high - low)
    lower = below - np.geomspace(NEAREST_K, max(below - low + beyond, 2.0 * NEAREST_K), TRIED)
    higher = above + np.geomspace(NEAREST_K, max(high - above + beyond, 2.0 * NEAREST_K), TRIED)
    return lower.tolist(), higher.tolist()


def _there_and_back(lower: list[float], higher: list[float]) -> list[tuple[float, float]]:
    """Return pairs of temperatures on both sides of a gap, every other one of `_beyond_ends`, in either order."""
    return [*product(lower[::2], higher[::2]), *product(higher[::2], lower[::2])]


def _least(cost: Callable[[float], float], bounds: tuple[float, float]) -> float:
    """Return where a function of a temperature is least between bounds, degC."""
    found = minimize_scalar(lambda t: cost(float(t)), bounds=bounds, method="bounded", options={"xatol": CLOSE_K})
    return float(found.x)
