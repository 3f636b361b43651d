"""Upper limits: of every effect that is not named, the largest size that the record still allows (95 %).

Along one effect the log-likelihood falls by

    fall(u) = d(u)^2 / 2 - a(u),     d^2 = delta' delta,  a = delta' residual,

where u is the effect's strength and delta(u) what it changes in the readings, both whitened, once plate, film and
everything that was fitted may follow. From nothing to u the change is taken to grow as the strength does, d = k u and
a = b u; the strength that fits best is then b / k^2 (0 if b < 0), and the likelihood has fallen from there by
1.645^2 / 2 at

    u95 = (max(b, 0) + 1.645 k) / k^2,

the one-sided limit of the profile likelihood (G. Cowan, K. Cranmer, E. Gross, O. Vitells, Eur. Phys. J. C 71 (2011)
1554, section 3.7), never below the one of a record that speaks neither for nor against the effect: noise that happens
to speak against an effect makes no instrument better than it is (power constraint, arXiv:1105.3166).

Where a tenth of u95 tells of a much larger one, the change does not grow as the strength does: what follows is curved.
There everything is fitted again beside an effect of growing strength, until the likelihood has fallen.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.candidates import Directions, Start, possible
from sim.diagnosis.result import UpperLimit
from sim.diagnosis.search import Search
from sim.effects.effect import Effect, pinned
from sim.inference.joint.likelihood import BESIDE, Fit

ONE_SIDED_95: Final = 1.645  # standard deviations on one side hold 95 % of a normal distribution
SMALLER: Final = 1000.0  # times smaller than the smallest size met: a hundred thousand rows show no less
ROUNDS: Final = 12  # from any start to a strength that is its own limit
SAME: Final = 0.05  # relative change of the strength from which another round is not needed: far below its own meaning
SAME_AS_NOTHING: Final = 2.0  # times the smallest strength: nothing smaller is looked at
LONGEST_STEP: Final = 10.0  # factor of one round: what is linear about one strength says little of another
CURVED: Final = 1.5  # factor by which a tenth of the strength tells another limit where the change is not linear in it
ABSORBED: Final = 10.0  # times as much is changed by an effect alone as when all else has followed: that does the same
GROWTH: Final = 2.0  # of the strength from fit to fit: a limit is read to its first digit


def upper_limits(fit: Fit, search: Search) -> list[UpperLimit]:
    """Of every effect that the record could show and that the fit does not have, along the chain."""
    have = {e.name for e in fit.effects}
    directions = Directions(fit, fit.metric, fit.at)
    return [_limit(e, fit, directions) for e in possible(search.effects, fit.joint) if e.name not in have]


def _limit(effect: Effect, fit: Fit, directions: Directions) -> UpperLimit:
    """The largest over what the effect has besides its size, and over both signs."""
    place = next(k for k, p in enumerate(effect.parameters) if not p.choices)
    size, from_below = effect.parameters[place], effect.inverse and place == 0
    low, high = size.smallest / SMALLER, size.largest * BESIDE
    if from_below:
        low, high = 1.0 / (size.largest * SMALLER), BESIDE / size.smallest
    found: list[tuple[float, bool]] = []  # limits, and whether something else does the same as an effect of that size
    for made, others in _others(effect, place):
        for sign in (1.0, -1.0) if size.signed else (1.0,):

            def start(
                strength: float, made: Effect = made, others: tuple[float, ...] = others, sign: float = sign
            ) -> Start:
                value = sign * (1.0 / strength if from_below else strength)
                return Start(made, (*others[:place], value, *others[place:]))

            nothing = directions.change(start(low))  # the chain takes other steps with an effect than without
            if made is not effect and not np.any(directions.change(start(high)) - nothing):
                continue  # a threshold that this record does not reach

            def of(strength: float, at: Callable[[float], Start] = start, nothing: Array = nothing) -> float:
                square, along = directions.along([at(strength)], nothing)
                return _linear(float(square[0]), float(along[0]), strength)

            allowed = _allowed(of, low, high)
            if allowed < high and of(allowed / LONGEST_STEP) > CURVED * allowed:
                allowed = _fitted(fit, start, allowed, high)
            change = directions.change(start(min(allowed * (1.0 - SAME), high))) - nothing
            alone = np.linalg.norm(directions.joint.whitened(directions.at, directions.metric, change[:, None]))
            found.append((allowed, made is effect and bool(alone > ABSORBED * ONE_SIDED_95)))
    strength, absorbed = max(found, default=(math.inf, False))
    limit = None if strength == math.inf else 1.0 / strength if from_below else strength
    return UpperLimit(effect.name, size.name, limit, from_below, (size.smallest, size.largest), absorbed)


def _fitted(fit: Fit, start: Callable[[float], Start], strength: float, high: float) -> float:
    """The strength from which a fit of everything else beside the effect is unlikely; infinite: none is."""
    x, joint = fit.at.x, fit.joint
    while strength < high:
        tried = start(strength)
        values = dict(zip((p.name for p in tried.effect.parameters), tried.values, strict=True))
        beside = joint.having((*fit.effects, pinned(tried.effect, values)))
        x = beside.from_other(joint, x)
        if tried.effect.before_film:  # a film that is off by kelvins would keep the plate where it is
            alone, metric = beside.thermometer_alone(), replace(fit.metric, output=None)
            plate = alone.descend(alone.solve(alone.from_other(beside, x), metric), metric)
            x = beside.with_thermal(x, alone, plate.x)
        at = beside.descend(beside.solve(x, fit.metric, fit.at.known_own), fit.metric)
        if at.cost - fit.at.cost > 0.5 * ONE_SIDED_95**2:
            return strength
        x, joint, strength = at.x, beside, GROWTH * strength
    return math.inf


def _others(effect: Effect, place: int) -> Iterator[tuple[Effect, tuple[float, ...]]]:
    """The effect with its choices made, and values of the parameters beside the size."""
    rest = [p for k, p in enumerate(effect.parameters) if k != place]
    axes = [p.choices or (p.smallest, math.sqrt(p.smallest * p.largest), p.largest) for p in rest]
    for values in itertools.product(*axes):
        chosen = {p.name: v for p, v in zip(rest, values, strict=True) if p.choices}
        yield pinned(effect, chosen) if chosen else effect, values


def _linear(square: float, b: float, strength: float) -> float:
    """u95 of the equations above, from d^2 and a at one strength; 0 where it cannot be computed, inf where it changes
    nothing."""
    if not math.isfinite(square):
        return 0.0
    if square <= 0.0:
        return math.inf
    return strength * (max(b, 0.0) / square + ONE_SIDED_95 / math.sqrt(square))


def _allowed(limit_at: Callable[[float], float], low: float, high: float) -> float:
    """The largest strength between two that the record allows; infinite: any. limit_at: what one strength says of the
    limit: it is allowed if it lies below that, else excluded."""
    strength, allowed, excluded = math.sqrt(low * high), low, math.inf
    for _ in range(ROUNDS):
        wanted = limit_at(strength)
        if abs(wanted / strength - 1.0) < SAME:
            return strength
        if wanted > strength:
            if strength >= high:
                return math.inf
            allowed = max(allowed, strength)
        else:
            if strength <= SAME_AS_NOTHING * low:
                return strength
            excluded = min(excluded, strength)
        if excluded < (1.0 + SAME) * allowed:  # what a command's dead band changes jumps
            return excluded
        strength = min(max(wanted, strength / LONGEST_STEP, SAME_AS_NOTHING * low), strength * LONGEST_STEP, high)
        if not allowed < strength < excluded:
            strength = math.sqrt(allowed * excluded) if excluded < math.inf else high
    return excluded
