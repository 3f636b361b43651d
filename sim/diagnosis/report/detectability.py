"""What would not have shown: effects of a size that one meets, which the film's own shape hides in this record.

An effect at the terminals is a function of the resistance, a drift one of time: much of what it does, another film does
too. How much of it is left once the film may follow is what a fit could have seen (the expected log-likelihood ratio).
"""

from __future__ import annotations

import numpy as np

from sim.diagnosis.judge.verdict import least_evidence
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.starting_sizes import starts_of
from sim.diagnosis.search.views import View
from sim.effects.effect import Switched, at_the_terminals, switched

SIZES = 9  # that are tried, from the least to the largest that is met
HALVINGS = 5  # of the way between two of them, in logarithms: to a thirtieth of it


def hidden_by_the_film(chain: Chain, names: frozenset[str]) -> dict[str, tuple[str, float]]:
    """By effect of the ohmmeter that is not among the names, and that would not show at the middle of the sizes met:
    its first parameter's name, and the weakest of these sizes that would (nan: none)."""
    _, b = chain.fits(names)
    if b is None:
        return {}
    channel = chain.film_channel(names)
    view, found = View(channel, b), {}
    for name, effect in chain.effects.items():
        if name in names or not at_the_terminals(effect):
            continue
        needed = least_evidence(chain, names, name)
        sizes = starts_of(effect, channel, SIZES)
        from_weak = sizes[::-1] if effect.inverse else sizes
        shows = [size for size in from_weak if view.expected(size) > needed]
        place = from_weak.index(shows[0]) if shows else len(from_weak)
        if place > SIZES // 2:
            weakest = float("nan")
            if shows:
                weakest = float(_least(view, needed, from_weak[place - 1], shows[0]).par[0])
            found[name] = effect.parameters[0].name, weakest
    return found


def _least(view: View, needed: float, weak: Switched, strong: Switched) -> Switched:
    """The weakest size that would show, between one that would not and one that would; what is chosen among a few
    values has none between."""
    for _ in range(0 if any(p.choices for p in strong.effect.parameters) else HALVINGS):
        between = switched(strong.effect, np.sign(strong.par) * np.sqrt(np.abs(weak.par * strong.par)))
        if view.expected(between) > needed:
            strong = between
        else:
            weak = between
    return strong
