"""Whether a reading is bent as an effect at the terminals bends it, or as a film bends itself.

Relays alone have congruent minor loops: of one shape between two temperatures, wherever the film is (I. Mayergoyz,
Mathematical Models of Hysteresis, 1991, ch. 1). A film whose loops are not looks like one behind a resistance in series
or in parallel, for its output seems to be bent. But what a film does of its own need not have the shape of a sum of
resistances or of conductances: so the same bend is tried softer and sharper,

    shown^p = R^p + series_ohm^p        (p = 1: the effect; alike for any other),

and no name is said where one of them does better. (Of films by interpolation between reversal curves with nothing
hidden, whose evidence for a resistance was 18 to 53, all three were better with the softer bend, by 7 to 20.) Nor is it
where the film leaves something that is not understood, which may bend the reading, too, be it in rows that no fit has
seen: their mean square over the noise's was 0.96 to 0.99 for films with such an effect, 1.65 for a moving Preisach one.
"""

from __future__ import annotations

import numpy as np

from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.effects.effect import Effect, at_the_terminals
from sim.model.sharpness import of_sharpness

SHARPNESS = (0.4, 2.5)  # p
BETTER = 4.0  # log-likelihood by which another sharpness has to be the better one


def is_output_nonlinearity(effect: Effect) -> bool:
    """Whether all it does is to bend the reading smoothly, as a film may bend itself."""
    return at_the_terminals(effect) and not any(p.signed or p.choices for p in effect.parameters)


def no_other_sharpness_is_better(
    search: ResistanceSearch, fit: ResistanceFit, without: ResistanceFit, name: str
) -> bool:
    """Whether neither a softer nor a sharper shape is better than the effect's own. fit, without: with relays, followed
    to their ends. True for what does not bend the reading."""
    effect = search.effects[name]
    if not is_output_nonlinearity(effect):
        return True
    for power in SHARPNESS:
        other = of_sharpness(effect, power)
        names = frozenset(e.name for e in without.effects) | {other.name}
        start = search.absorbed(without, other, np.inf) if names not in search.fits else None
        if start is not None:
            search.ended(search.beside(without, start))
        if names in search.fits and search.fits[names].score > fit.score + BETTER:
            return False
    return True
