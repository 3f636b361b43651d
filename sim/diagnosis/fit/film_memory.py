"""What the film remembers at the first row, and what it went through while rows are missing.

Either shows in nothing but the resistance that follows: the memory that fits best is taken, envelopes and effects as
they are. Found with the wrong effects it may be wrong, so that it is looked for again once they are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters
from sim.inference.nuisance import beginnings
from sim.model.gaps import beyond_ends, there_and_back
from sim.model.record_own import FilmStart, longest_gaps

FAR = 1.0  # cost a row from which others have to be fitted to be seen
FAR_OFF = 15.0  # cost a row from which more is wrong than a memory
LIKELY = 3  # of them that are fitted
CLOSER_START = 3  # times that the place between the best turning point and its neighbours is looked at
WORTH_START = 3.0  # log-likelihood that another memory at the first row has to bring
BEYOND = 0.1  # of the temperatures seen in the record: so far may it have gone unseen
CLOSER = 7  # times that the place between the best and its neighbours is looked at
WORTH = 6.0  # log-likelihood that one more temperature in a gap has to bring


def remembered(channel: ResistanceChannel, p: FilmParameters) -> FilmStart:
    """The memory with which the film fits best."""
    start = begun(channel, p)
    if channel.record.first_rows.size > 1:
        start = _through_gaps(channel, replace(p, start=start))
    return start


def begun(channel: ResistanceChannel, p: FilmParameters) -> FilmStart:
    """What the film remembers at the first row, with which it fits best."""
    seen = Seen(channel, p)
    costs = {c: seen.cost(c) for c in beginnings(channel.path, float(channel.record.time_s[0]), p.start)}
    order = sorted(costs, key=lambda c: costs[c])
    likely = order[:LIKELY]
    best = order[0]
    if best.previous_degC is not None:
        turned = {
            c.previous_degC: v for c, v in costs.items() if c.initial == best.initial and c.previous_degC is not None
        }
        at = _closer(lambda t: seen.cost(replace(best, previous_degC=t)), turned, (), CLOSER_START)
        likely.append(replace(best, previous_degC=at))
    least, best = min(((_cost(channel, p, c), c) for c in likely), key=lambda found: found[0])
    return best if least < seen.point.cost - WORTH_START else p.start


def _closer(cost: Callable[[float], float], tried: dict[float, float], ends: tuple[float, ...], times: int) -> float:
    """The best of the temperatures tried, after looking half-way to its neighbours and the ends; all costs in tried."""
    near = min(tried, key=lambda t: tried[t])
    for _ in range(times):
        known = sorted([*tried, *ends])
        at = known.index(near)
        for other in known[max(at - 1, 0) : at + 2]:
            if other != near:
                t = 0.5 * (near + other)
                tried[t] = cost(t)
        near = min(tried, key=lambda t: tried[t])
    return near


class Seen:
    """Other memories as they are seen from one: the film keeps the coefficients, and follows to first order what the
    other memory changes. That is a tenth of the work of a fit, and good enough to choose which ones to fit, where the
    one that they are seen from is not far off."""

    def __init__(self, channel: ResistanceChannel, p: FilmParameters) -> None:
        self._channel, self._p = channel, p
        self.point = channel.point(p, p.x)
        self._shown = channel.predict(p, p.x, self.point)[channel.rows]
        self._residual = channel.over(channel.output[channel.rows] - self.point.shown[channel.rows])

    def cost(self, start: FilmStart) -> float:
        """Half the sum of squares of what another memory leaves."""
        if self.point.cost > FAR * self._residual.size:
            return _cost(self._channel, self._p, start)
        channel, p = self._channel, replace(self._p, start=start)
        changed = channel.over(channel.predict(p, p.x, self.point)[channel.rows] - self._shown)
        left = self._residual - self.point.off(changed[:, None])[:, 0]
        return 0.5 * float(left @ left)


def _cost(channel: ResistanceChannel, p: FilmParameters, start: FilmStart) -> float:
    there = replace(p, start=start)
    return channel.point(there, p.x).cost


def _through_gaps(channel: ResistanceChannel, p: FilmParameters) -> FilmStart:
    """The temperatures beyond each gap's ends: the last one that the film passed, and one before that; gap by gap."""
    record = channel.record
    first = record.first_rows[1:]
    passed = np.array(p.start.passed_degC or np.full((first.size, 2), np.nan)).reshape(-1, 2)
    for k in np.flatnonzero(np.isin(first, longest_gaps(record))):
        passed = _in_gap(channel, p, passed, int(k))
    return _started(p.start, passed)


def _in_gap(channel: ResistanceChannel, p: FilmParameters, passed: Array, k: int) -> Array:
    """`passed` with the best of gap k: first there and back on both sides of its ends, then each for itself."""
    row = channel.record.first_rows[1 + k]
    ends, plate = channel.path.at(channel.record.time_s[[row - 1, row]]), channel.path.plate_degC
    below, above = float(np.min(ends)), float(np.max(ends))
    lower, higher = beyond_ends(ends, plate, BEYOND)

    def through(before: float, last: float) -> FilmStart:
        other = passed.copy()
        other[k] = before, last
        return _started(p.start, other)

    before, last = (float(t) for t in passed[k])
    seen = Seen(channel, replace(p, start=through(before, last)))
    if seen.point.cost < FAR_OFF * channel.rows.size:
        two = min(there_and_back(lower, higher), key=lambda two: seen.cost(through(*two)))
        if _cost(channel, p, through(*two)) < seen.point.cost - WORTH:
            before, last = two
            seen = Seen(channel, replace(p, start=through(before, last)))
    for place in (1, 0, 1):
        alone = partial(_with_one, through, (before, last), place)
        cost = partial(_seen_cost, seen, alone)
        near = _closer(cost, {float(t): cost(float(t)) for t in (*lower, *higher)}, (below, above), CLOSER)
        if _cost(channel, p, alone(near)) >= _cost(channel, p, alone(np.nan)) - WORTH:
            near = np.nan
        if not np.array_equal((before, last)[place], near, equal_nan=True):  # seen from there, from now on
            before, last = (before, near) if place else (near, last)
            seen = Seen(channel, replace(p, start=through(before, last)))
    return np.asarray(through(before, last).passed_degC)


def _with_one(
    through: Callable[[float, float], FilmStart], both: tuple[float, float], place: int, value: float
) -> FilmStart:
    """With another of the two temperatures."""
    return through(both[0], value) if place else through(value, both[1])


def _seen_cost(seen: Seen, through: Callable[[float], FilmStart], value: float) -> float:
    return seen.cost(through(value))


def _started(start: FilmStart, passed: Array) -> FilmStart:
    return replace(start, passed_degC=tuple((float(a), float(b)) for a, b in passed))
