"""A film's memory where a record does not show it: before the first row, and through gaps in which it may have turned.

What a film went through counts only by its turning points, and of them only by those that no later one has gone beyond
(E. Madelung, Ann. Phys. 17 (1905) 861). They are found one at a time, outwards or inwards of those at hand, all moved
together; each has to bring a gain of log-likelihood. Far enough out they are saturation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
from scipy.optimize import minimize

from compensator.hysteresis.film import Initial
from compensator.hysteresis.functions import Array
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart, longest_gaps
from sim.model.recorded import Recorded

MOST_TURNS: Final = 4  # in one place: the innermost ones of more are soon gone beyond
TRIED: Final = 8  # temperatures on either side
NEAREST_K: Final = 0.1  # of them, beyond where the film is: less is within a thermometer's error
BEYOND: Final = 0.25  # of the range of temperatures: so far out of it may a film have turned round
PASSES: Final = 2  # over the gaps: the turning points in one change the memory after the next
CLOSE_K: Final = 0.02  # to which a temperature is looked for
SHARE: Final = 0.3  # of a turning point's distance, by which it is moved first: half of the way to the next one tried
FLAT: Final = 1e-2  # of a log-likelihood
STEPS_EACH: Final = 40  # evaluations for each of several turning points
FIRST_EACH: Final = 10  # of them, to see which of several starts is the best
SAYS: Final = 0.25  # of its worth, that the best of the temperatures tried has to bring before others are looked for
Turns = tuple[float, ...]
Gap = tuple[float, Array]  # the time (s) of the row after it, the temperatures (degC) of the rows at its ends


def begun(
    known: FilmStart, first_degC: float, seen_degC: Array, cost: Callable[[FilmStart], float], worth: float
) -> FilmStart:
    """Return the likeliest memory at the first row, the known one if no other brings what it has to. cost: minus the
    log-likelihood; seen_degC: all temperatures of the record; worth: what each turning point has to bring."""

    def value(start: FilmStart) -> float:
        return cost(start) + worth * len(start.turned_degC)

    other: Initial = "cooled" if known.initial == "heated" else "heated"
    starts = [known] if known.turned_degC else [known, replace(known, initial=other)]
    ends, found = np.array([first_degC]), [known]
    for start in starts:
        turns = turning_points(_of_turns(start, cost), ends, seen_degC, worth, start.turned_degC)
        found.append(replace(start, turned_degC=turns))
    best = min(found, key=value)
    return best if value(best) + worth < value(known) else known


def closer(known: FilmStart, cost: Callable[[FilmStart], float]) -> FilmStart:
    """Return the memory with its turning points before the first row at their best."""
    return replace(known, turned_degC=_closer(known.turned_degC, _of_turns(known, cost)))


def _of_turns(start: FilmStart, cost: Callable[[FilmStart], float]) -> Callable[[Turns], float]:
    return lambda turns: cost(replace(start, turned_degC=turns))


def gaps_of(record: Recorded, path: PlatePath) -> list[Gap]:
    """Return the gaps of a record that a film's memory is not known through. path: of the plate."""
    time = record.time_s
    return [(float(time[row]), path.at(time[[row - 1, row]])) for row in longest_gaps(record)]


def through_gaps(
    start: FilmStart, gaps: Sequence[Gap], seen_degC: Array, cost: Callable[[FilmStart], float], worth: float
) -> FilmStart:
    """Return the memory with what the film went through in each gap, straight from one end to the other where nothing
    is clearly better. cost, seen_degC, worth: as in `begun`."""
    for _ in range(min(PASSES, len(gaps))):
        before = start
        for end_s, ends in gaps:

            def of(turns: Turns, start: FilmStart = start, end_s: float = end_s) -> float:
                return cost(start.turning(end_s, turns))

            known = dict(start.passed_degC).get(end_s, ())
            start = start.turning(end_s, turning_points(of, ends, seen_degC, worth, known))
        if start == before:
            break
    return start


def turning_points(
    cost: Callable[[Turns], float], ends_degC: Array, seen_degC: Array, worth: float, known: Turns = ()
) -> Turns:
    """Return where a film turned round where nobody looked. ends_degC: where it was next to that; cost, seen_degC,
    worth: as in `begun`; known: what was found before."""
    below, above = float(np.min(ends_degC)), float(np.max(ends_degC))
    low, high = float(np.min(seen_degC)), float(np.max(seen_degC))
    margin = BEYOND * (high - low)
    lower = below - np.geomspace(NEAREST_K, max(below - low + margin, 2.0 * NEAREST_K), TRIED)
    higher = above + np.geomspace(NEAREST_K, max(high - above + margin, 2.0 * NEAREST_K), TRIED)
    cost = cache(cost)
    either = [below, above, *lower.tolist(), *higher.tolist()]

    def longer(turns: Turns) -> Turns:
        """The same with one more, before or after all of them."""
        tried = {(*turns, degC) for degC in either} | {(degC, *turns) for degC in either}
        first = min(sorted(tried), key=cost)
        if not turns and cost(turns) - cost(first) < SAYS * worth:
            return first
        # those at hand were the best alone: with one at an end besides, they may lie elsewhere
        starts = {first, *((*turns, degC) for degC in ends_degC.tolist() if turns)}
        near = [_closer(start, cost, (below, above), FIRST_EACH) for start in sorted(starts)]
        return _closer(min(near, key=cost), cost, (below, above))

    def value(turns: Turns) -> float:
        return cost(turns) + worth * len(turns)

    best = min((), longer(()), _closer(known, cost, (below, above)), key=value)
    while 0 < len(best) < MOST_TURNS:
        more = longer(best)
        if value(more) >= value(best):
            break
        best = more
    return best


def _closer(
    turns: Turns,
    cost: Callable[[Turns], float],
    ends_degC: tuple[float, float] | None = None,
    steps_each: int = STEPS_EACH,
) -> Turns:
    """Return turning points nearby at which the cost is least. ends_degC: between which none lies."""
    if not turns:
        return turns
    here = np.array(turns)
    below, above = ends_degC or (float(np.min(here)) + 1.0, float(np.max(here)) - 1.0)
    steps = SHARE * np.maximum(np.maximum(below - here, here - above), NEAREST_K) * np.where(here < below, -1.0, 1.0)

    def at(degC: Array) -> float:
        return cost(tuple(degC.tolist()))

    found = minimize(
        at,
        here,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack((here, here + np.diag(steps))),
            "xatol": CLOSE_K,
            "fatol": FLAT,
            "maxfev": steps_each * here.size,
        },
    )
    return tuple(found.x.tolist()) if found.fun < cost(turns) else turns
