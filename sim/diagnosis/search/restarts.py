"""A fit with relays, begun again from other envelopes near its own.

The operators' radii move with the envelopes. A film that shows nothing until a reversal has gone some way tells as well
as its ohmmeter reads where that ends, and as its operators pass by there, the cost rises and falls: a descent ends in
the nearest of many minima. With an ohmmeter of 1e-4 decades the best was 50 to 500 of log-likelihood better, beside
which a film's lag of 1.5 s was taken for the ohmmeter's, with the exact temperature, too.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.search.budget import SEARCHING

if TYPE_CHECKING:
    from sim.diagnosis.search.resistance_search import ResistanceSearch

LOOKED_AT: Final = 30  # envelopes whose cost is computed in a round, each some hundredths of a descent
BEGUN: Final = 3  # descents from the best of them
WITHIN: Final = 15.0  # log-likelihood below the fit's own, from which one begins: from 18 on none gained over 5
STEPS: Final = (4, 8)  # of each, and of the best one from there on: which it is shows early
ROUNDS: Final = 3  # at most: the first two bring nearly all
GAINS: Final = 5.0  # log-likelihood, from which another round follows
APART: Final = 0.14  # how far they are spread: steepness (its logarithm), centre (over the flank's width)
LITTLE_LEFT: Final = 1.5  # mean square residual over noise; beyond it an effect that is missing would be fitted


def restarted(search: ResistanceSearch, fit: ResistanceFit) -> ResistanceFit:
    """The fit, or a better one of the same effects; kept. Each set of effects once."""
    names, p = frozenset(e.name for e in fit.effects), fit.parameters
    if names in search.restarted or not p.has_relays or p.prior.is_of_relays:
        return fit
    if search.channel.mean_square(fit) > LITTLE_LEFT:
        return fit
    search.restarted.add(names)
    random = np.random.default_rng(0)
    for _ in range(ROUNDS):
        if search.budget.over(SEARCHING):
            break
        near = _near(search.channel, fit, random)
        likely = sorted((one for one in near if one[0] > fit.score - WITHIN), key=lambda one: -one[0])[:BEGUN]
        ends = [search.channel.descend(begin, STEPS[0]) for _, begin in likely]
        best = max(ends, key=lambda f: f.score, default=fit)
        best = search.channel.descend(best.parameters, STEPS[1]) if ends else fit
        if not best.score > fit.score + GAINS:
            break
        fit = search.ended(replace(best, plain=fit.plain))
    return fit


def _near(
    channel: ResistanceChannel, fit: ResistanceFit, random: np.random.Generator
) -> list[tuple[float, FilmParameters]]:
    """Log-likelihoods with other envelopes, all else as the fit has it."""
    p, found = fit.parameters, []
    low, high, _ = channel.bounds(p)
    width = np.array([[1.0, math.exp(-p.x[k])] for k in range(0, ENVELOPES, 2)]).ravel()
    coefficients = channel.following(fit)
    for _ in range(LOOKED_AT):
        x = p.x.copy()
        x[:ENVELOPES] += APART * width * random.standard_normal(ENVELOPES)
        begin = replace(p, x=np.clip(x, low, high))
        found.append((channel.point(begin, begin.x, coefficients(begin.x - p.x)).evidence, begin))
    return found
