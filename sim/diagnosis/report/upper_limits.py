"""Upper limits: of every effect that is not named, the largest size that the record still allows (95 %).

Along one effect the log-likelihood of the fitted rows falls by

    fall(u) = d(u)^2 / 2 - a(u),     d^2 = delta' delta,  a = delta' residual,

where u is the effect's strength, residual what the fit leaves over the noise, and delta(u) what the effect changes in
the fitted rows over the noise, once plate, film and everything that was fitted may follow. From nothing to u the change
is taken to grow as the strength does, d = k u and a = b u; the strength that fits best is then b / k^2 (0 if b < 0),
and the likelihood has fallen from there by 1.645^2 / 2 at

    u95 = (max(b, 0) + 1.645 k) / k^2,

which is the one-sided limit of the profile likelihood (G. Cowan, K. Cranmer, E. Gross, O. Vitells, Eur. Phys. J. C 71
(2011) 1554, section 3.7), never below the one of a record that speaks neither for nor against the effect: noise that
happens to speak against an effect makes no instrument better than it is (power constraint, arXiv:1105.3166). Where the
residual hangs together from row to row, or is larger than the noise, the deviation 1/k is widened as parameters'
intervals are (`sim.inference.covariance`).

What plate and film do instead is linear in delta. Where another film does most of what an effect does at the terminals
(`sim.diagnosis.report.detectability`), it does more than that: there a limit is no smaller than the size that would
have shown, and none is given where no usual size would have. Nor is one given of what acts on the film or at the
ohmmeter where the film is not described: beside one that switches in steps a lag of 4 s was hidden, and 2.6 s excluded;
beside phases that mix in another way a skew of 0.08 s, and 0.06 s excluded. And none where the film's flank has too few
rows: the model's own hysteresis takes up any lag there, and would exclude it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.starting_sizes import thresholds_inside
from sim.diagnosis.search.views import FirstView, View
from sim.effects.effect import Effect, Parameter, Switched, switched
from sim.inference.covariance import block_sandwich

NORMAL_95_ONE_SIDED: Final = 1.645  # standard deviations on one side hold 95 % of a normal distribution
SMALLER: Final = 1000.0  # times smaller than the smallest size met: a hundred thousand rows show no less
LARGER: Final = 10.0  # times larger than the largest size met: the end of the fits (`sim.diagnosis.fit.unknowns`)
ROUNDS: Final = 20
SAME: Final = 0.03  # relative change of the strength from which another round is not needed: far below its own meaning
LONGEST_STEP: Final = 10.0  # factor of one round: what is linear about one strength says little of another
TOO_MUCH_LEFT: Final = 1.5  # mean square residual over noise: a film that is described leaves 0.9 to 1.2
Left = Callable[[Switched], Array]


@dataclass(frozen=True)
class UpperLimit:
    """name; parameter: of the size; limit: in its unit, None where the record allows any size that was looked at;
    from_below: whether the record excludes what is smaller (a leakage's resistance) instead of what is larger; met: the
    smallest and largest size met, None where these are in a unit that the record does not have."""

    name: str
    parameter: str
    limit: float | None
    from_below: bool
    met: tuple[float, float] | None

    @property
    def allows_all_met(self) -> bool:
        """Whether an effect of any size met may be there, unseen."""
        if self.limit is None or self.met is None:
            return self.limit is None
        smallest, largest = self.met
        return self.limit <= smallest if self.from_below else self.limit >= largest

    @property
    def excludes_all_met(self) -> bool:
        """Whether an effect of every size met would have shown."""
        if self.limit is None or self.met is None:
            return False
        smallest, largest = self.met
        return self.limit >= largest if self.from_below else self.limit <= smallest

    def document(self) -> dict[str, Any]:
        """In `peltier-diagnosis/1`."""
        return {"name": self.name, "parameter": self.parameter, "limit95": self.limit}


def upper_limits(chain: Chain, names: frozenset[str], hidden: Mapping[str, tuple[str, float]]) -> list[UpperLimit]:
    """Of every effect that the record could show and that is not among the names, along the chain. hidden: those that
    the film's own shape hides, with the weakest size that would have shown, nan where none would."""
    a, b = chain.fits(names)
    found = []
    if a is not None and chain.first is not None:
        first = FirstView(chain.first.channel, a)
        for name, effect in chain.first.effects.items():
            if name not in names:
                found.append(_limit(effect, first.left_of, first.residual, ()))
    if chain.sparse is not None or film_not_described(chain, names):
        found += [
            _none(effect) for name, effect in chain.last(chain.split(names)[0]).effects.items() if name not in names
        ]
    elif b is not None:
        channel, search = chain.film_channel(names), chain.last(chain.split(names)[0])
        last = View(channel, b)
        for name, effect in search.effects.items():
            if name not in names:
                thresholds = [t for p in effect.parameters if p.choices for t in thresholds_inside(p, channel)]
                limit = _limit(effect, last.left_of, last.residual, tuple(thresholds))
                found.append(_beside_the_film(limit, hidden.get(name)))
    return found


def film_not_described(chain: Chain, names: frozenset[str]) -> bool:
    """Whether so much is left of the film's readings, with these effects, that it is no noise."""
    b = chain.fits(names)[1]
    return b is not None and 2.0 * b.minus_log > TOO_MUCH_LEFT * chain.film_channel(names).rows.size


def _place_of_size(effect: Effect) -> int:
    """Which of its parameters is the size: the first that is no choice."""
    return next(k for k, p in enumerate(effect.parameters) if not p.choices)


def _none(effect: Effect) -> UpperLimit:
    """That no limit is given."""
    place = _place_of_size(effect)
    size = effect.parameters[place]
    return UpperLimit(effect.name, size.name, None, effect.inverse and place == 0, (size.smallest, size.largest))


def _beside_the_film(limit: UpperLimit, hidden: tuple[str, float] | None) -> UpperLimit:
    """The limit, or the weakest size that would have shown in spite of the film, if that is stronger."""
    if hidden is None or limit.limit is None:
        return limit
    parameter, shows = hidden
    if math.isnan(shows):
        return replace(limit, limit=None)
    if parameter != limit.parameter:  # a threshold
        return limit
    return replace(limit, limit=min(limit.limit, shows) if limit.from_below else max(limit.limit, shows))


def _limit(effect: Effect, left_of: Left, residual: Array, thresholds: tuple[float, ...]) -> UpperLimit:
    """The largest over what the effect has besides its size, and over both signs."""
    none, place = _none(effect), _place_of_size(effect)
    size, from_below = effect.parameters[place], none.from_below
    found: list[float | None] = []
    for others in _others(effect, place, thresholds):
        for sign in (1.0, -1.0) if size.signed else (1.0,):

            def at(strength: float, others: tuple[float, ...] = others, sign: float = sign) -> Array:
                value = sign * (1.0 / strength if from_below else strength)
                return left_of(switched(effect, [*others[:place], value, *others[place:]]))

            found.append(_allowed(at, residual, size, from_below))
    if not found or None in found:
        return none
    strength = max(value for value in found if value is not None)
    return replace(none, limit=1.0 / strength if from_below else strength)


def _others(effect: Effect, place: int, thresholds: tuple[float, ...]) -> Iterator[tuple[float, ...]]:
    """Values of the parameters beside the size: the thresholds that the record can show, the sizes met."""
    axes = []
    for k, p in enumerate(effect.parameters):
        if k != place:
            axes.append(thresholds if p.choices else (p.smallest, math.sqrt(p.smallest * p.largest), p.largest))
    yield from product(*axes)


def _allowed(at: Callable[[float], Array], residual: Array, size: Parameter, from_below: bool) -> float | None:
    """The largest strength that the record allows; None: any that is looked at.

    Each strength that is looked at gives a limit of its own: it is allowed if it lies below that limit, else excluded.
    """
    low, high = size.smallest / SMALLER, size.largest * LARGER
    if from_below:
        low, high = 1.0 / (size.largest * SMALLER), LARGER / size.smallest
    allowed, excluded = low, math.inf
    strength = math.sqrt(size.smallest * size.largest)
    strength = 1.0 / strength if from_below else strength
    for _ in range(ROUNDS):
        change = at(strength)
        wanted = _linear_limit(change, residual, strength)
        if abs(wanted / strength - 1.0) < SAME:
            return strength
        if wanted > strength:
            allowed = max(allowed, strength)
            if strength >= high:
                return None
        else:
            excluded = min(excluded, strength)
            if strength <= low:
                return low if np.all(np.isfinite(change)) else None
        if excluded < (1.0 + SAME) * allowed:  # what a command's dead band changes jumps
            return excluded
        strength = min(max(wanted, strength / LONGEST_STEP, low), strength * LONGEST_STEP, high)
        if not allowed < strength < excluded:
            strength = math.sqrt(allowed * excluded) if excluded < math.inf else high
    return excluded if excluded < math.inf else None


def _linear_limit(delta: Array, residual: Array, strength: float) -> float:
    """u95 of the equations above, from what one strength changes; 0 where it cannot be computed, inf where it changes
    nothing."""
    if not np.all(np.isfinite(delta)):
        return 0.0
    k = float(np.linalg.norm(delta)) / strength
    if k <= 0.0:
        return math.inf
    b = float(delta @ residual) / strength
    return max(b, 0.0) / k**2 + NORMAL_95_ONE_SIDED * _widened(delta, residual) / k


def _widened(delta: Array, residual: Array) -> float:
    """By how much a deviation is larger than for a residual that is white and of the noise's size."""
    size = float(np.linalg.norm(delta))
    error = float(block_sandwich((delta / size)[:, None], residual).standard_errors[0])
    return max(error, 1.0) if math.isfinite(error) else 1.0
