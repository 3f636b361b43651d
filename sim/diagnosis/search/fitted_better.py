"""Sets of effects that were fitted on the way and tell the fitted rows better than those that may be said."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.stepwise import ENTRY

LOOKED_AT: Final = 8  # sets, the best in the fitted rows first: what is asked of each costs seconds


def fitted_better(chain: Chain, own: frozenset[str], refused: Iterable[str]) -> list[frozenset[str]]:
    """The best of them first. own: the effects that may be said; refused: those that the search had selected beside
    them. What would need a new search of the film behind another plate is left out, and so are bends of no catalogue,
    with which one that is was compared."""
    upstream, downstream = chain.split(own)
    sets: set[frozenset[str]] = {own | frozenset(refused)}
    if chain.first is not None:
        sets |= {s | downstream for s in chain.first.fits}
    if chain.record.output is not None:
        sets |= {upstream | s for s in chain.last(upstream).fits}
        sets = {s for s in sets if s <= chain.effects.keys() and chain.split(s)[0] in chain.found.searches}
    better = {s: chain.score(s) - chain.score(own) for s in sets if s != own and chain.assumed <= s}
    return sorted((s for s in better if better[s] > ENTRY), key=lambda s: -better[s])[:LOOKED_AT]
