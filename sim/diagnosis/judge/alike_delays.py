"""Of delays that a record cannot tell apart, the one that is said is always the same.

A lag of the film, one of the ohmmeter and a skew of the time stamps show the same on a steady ramp. Their likelihoods
then differ by what the descents stop at, and which is the largest hangs on the last digit of the readings: five of 21
such records were given another name when every reading was moved by 1e-12 of itself. What is said is the simplest: a
skew, which only shifts; then what rounds the output, too, and last what acts through the film's memory. The others are
told beside it, as indistinguishable.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from sim.diagnosis.judge.verdict import Verdict, judge
from sim.diagnosis.search.budget import JUDGING
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.delays import of_delays

SIMPLEST_FIRST: Final = ("timestamp_skew", "meter_lag", "film_lag")
ALIKE: Final = 3.0  # log-likelihood, 20 to 1: less does not decide between two delays, and descents stop within 1


def simplest_of_alike(chain: Chain, judged: Verdict) -> Verdict:
    """With the simplest of the delays that fit as well, in the place of each that would be said."""
    for name in sorted(judged.names):
        if name in SIMPLEST_FIRST and name not in judged.by_records and not chain.budget.over(JUDGING):
            simplest = _simplest(chain, judged.fitted, name)
            if simplest != judged.fitted and (other := judge(chain, simplest)).fitted == simplest:
                judged = replace(other, refused={**judged.refused, **other.refused}, by_records=judged.by_records)
    return judged


def _simplest(chain: Chain, names: frozenset[str], name: str) -> frozenset[str]:
    """The same effects, or those with a simpler delay that fits as well. Beside a film of another kind the same: two
    fits of it differ by more for how they were come by."""
    search = chain.last(chain.split(names)[0])
    simpler = SIMPLEST_FIRST[: SIMPLEST_FIRST.index(name)]
    sets = [names - {name} | {n} for n in simpler if n in search.effects and n not in names]
    for each in sets:
        chain.followed(each, chain.instead(names, name, *(each - names)))
    sets.append(names)
    fits = [fit for fit in (chain.fits(each)[1] for each in sets) if fit is not None]
    if all(fit.parameters.has_relays for fit in fits):
        return names
    costs = of_delays(fits)
    return next(each for each, cost in zip(sets, costs, strict=True) if cost <= costs[-1] + ALIKE)
