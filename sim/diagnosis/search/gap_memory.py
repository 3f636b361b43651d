"""Fits of the last links with another memory of what the film went through while rows are missing.

What it went through in a gap was found with the effects that were known then, and a wrong effect bends it: of a film
2.9 s behind its plate, that went through a gap of 25 s, one with its lag left 119 times the noise's variance with the
memory that was found without the lag, one with a lag of the ohmmeter 40. With memories of their own they leave 0.5 and
39.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from sim.diagnosis.fit.film_memory import remembered
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.resistance_search import ResistanceSearch

ENOUGH: Final = 1.5  # mean square residual over noise, below which a memory is not what is wrong
ROUNDS: Final = 3  # of memory and envelopes: each makes the other clearer, and the second is the last that gains


def has_gaps(search: ResistanceSearch) -> bool:
    """Whether rows are missing in which the film may have turned round."""
    return search.channel.record.first_rows.size > 1


def through_gaps(search: ResistanceSearch, fit: ResistanceFit) -> ResistanceFit:
    """The fit, or a better one with another memory; kept."""
    p = fit.plain or fit.parameters
    start = remembered(search.channel, p)
    return fit if start == p.start else search.keep(search.whole(replace(p, start=start)))


def plain_through_gaps(search: ResistanceSearch, fit: ResistanceFit) -> ResistanceFit:
    """A fit without relays that leaves much, or a better one with another memory."""
    for _ in range(ROUNDS):
        if search.channel.mean_square(fit) < ENOUGH or search.budget.over():
            break
        start = remembered(search.channel, fit.parameters)
        other = search.plain(replace(fit.parameters, start=start))
        if start == fit.parameters.start or not other.score > fit.score:
            break
        fit = other
    return fit
