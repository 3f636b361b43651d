"""Whether a film's phases mix otherwise than in their logarithms.

A resistance in series or in parallel bends the output, too: where one of them does as well, it is the simpler reason.
An effect that is missing looks like a mixing: none is tried where an effect shows better, nor while much is left, until
all effects have been. By then those at the terminals may have stood in for it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.search.fit_steps import RELAY_STEPS, WHOLE_STEPS
from sim.diagnosis.search.views import View
from sim.effects.effect import at_the_terminals

if TYPE_CHECKING:
    from sim.diagnosis.search.resistance_search import ResistanceSearch

WORTH: Final = 8.0  # log-likelihood that another mixing of a film's phases has to bring: noise brings it in 1 of 3000
MUCH_LEFT: Final = 1.5  # mean square residual over noise above which an effect that is missing looks like a mixing
# exponent and percolation: logarithms, means up to conductances and resistances, media of two and of three dimensions
BEGUN: Final = ((0.0, 0.0), (-0.5, 0.0), (0.5, 0.0), (-1.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0 / 3.0, 1.0))
BEGUN_ANEW: Final = 3  # descents, at the most: the first gains most
NEARLY_NOTHING: Final = 1.1  # the same, of what a mixing leaves that is all that was missing
FAR_FROM_NOISE: Final = 30.0  # the same, beyond which it is no mixing that is missing


def mixed(search: ResistanceSearch, fit: ResistanceFit) -> ResistanceFit:
    """A fit with relays, or a better one with another mixing, while little is left; where much is, and no effect is
    there yet, one with a mixing that leaves next to nothing: a film that percolates, and no effect, does that. Beside
    two effects at the terminals none is tried, as they bend the output both ways; nor where an effect that is not there
    shows better: a film's own mixing shows best of all."""
    left, bent = search.channel.mean_square(fit), sum(at_the_terminals(e.effect) for e in fit.effects)
    if fit.parameters.is_mixed or bent > 1 or (left > MUCH_LEFT and (fit.effects or left > FAR_FROM_NOISE)):
        return fit
    gain = View(search.channel, fit).gain_of_mixing()
    if gain < WORTH or _effect_shows_better(search, fit, gain):
        return fit
    return _otherwise(search, fit, NEARLY_NOTHING if left > MUCH_LEFT else np.inf) or fit


def _effect_shows_better(search: ResistanceSearch, fit: ResistanceFit, gain: float) -> bool:
    """Whether one more effect may bring more than another mixing, whose gain this is, by their score tests."""
    others = search.effects.keys() - {e.name for e in fit.effects}
    return any(search.score_test(fit, name).gain > gain + WORTH for name in sorted(others))


def mixed_at_last(search: ResistanceSearch, names: frozenset[str]) -> frozenset[str] | None:
    """The effects to go on with where the best fit with these leaves much, and little with another mixing, which is
    kept then; else None. To be asked when all effects have been tried."""
    fit = search.fit(names)
    p = fit.parameters
    if p.is_mixed or not p.has_relays or not MUCH_LEFT < search.channel.mean_square(fit) < FAR_FROM_NOISE:
        return None
    if View(search.channel, fit).gain_of_mixing() < WORTH:
        return None
    other = _otherwise(search, fit, MUCH_LEFT)
    if other is None:
        return None
    other = search.keep(other)
    stood_in = frozenset(n for n in names if at_the_terminals(search.effects[n])) - search.assumed
    for name in sorted(stood_in):
        other = search.without(other, name)
    return names - stood_in


def _otherwise(search: ResistanceSearch, fit: ResistanceFit, most_left: float) -> ResistanceFit | None:
    """The fit with another mixing, where that is worth it and no effect at the terminals does as well. most_left: mean
    square residual over noise that it may leave."""
    begun = [_with(fit.parameters, *mixing) for mixing in BEGUN]
    best = max(begun, key=lambda p: search.channel.point(p, p.x).evidence)
    other = search.channel.descend(best, WHOLE_STEPS)
    if other.score < fit.score + WORTH or search.channel.mean_square(other) > most_left:
        return None
    if other.score < _bent(search, fit) + WORTH:
        return None
    other = _to_its_end(search, other)
    return replace(other, plain=replace(fit.without_relays, mixes=True))  # with relays again, it mixes again


def _to_its_end(search: ResistanceSearch, fit: ResistanceFit) -> ResistanceFit:
    """The fit, descended from anew as long as that gains: the coefficients that a descent takes along with it can hold
    it 60 of log-likelihood below its minimum, and a new one looks for them from the beginning."""
    for _ in range(BEGUN_ANEW):
        further = search.channel.descend(fit.parameters, WHOLE_STEPS)
        if further.score < fit.score + WORTH:
            break
        fit = further
    return fit


def _with(p: FilmParameters, exponent: float, percolation: float) -> FilmParameters:
    """The same film with its phases mixed so."""
    x = p.x.copy()
    x[ENVELOPES + 1 : SHAPE] = exponent, percolation
    return replace(p, x=x, mixes=True)


def _bent(search: ResistanceSearch, fit: ResistanceFit) -> float:
    """Score of the best fit with one more effect at the ohmmeter's terminals, the film's phases as they are."""
    best, names = -np.inf, {e.name for e in fit.effects}
    for name, effect in search.effects.items():
        start = search.absorbed(fit, effect, np.inf) if at_the_terminals(effect) and name not in names else None
        if start is not None:
            trial = search.channel.extended(fit.parameters, [*fit.effects, start])
            best = max(best, search.channel.descend(trial, RELAY_STEPS).score)
    return best
