"""Which of the effects that delay what is read of a film it is: a lag of the film, one of the ohmmeter, a skew.

They show nearly the same, and a fit with relays ends somewhere else for how it was come by: each is begun from the
others' fits, twice round. Then it is the penalized cost that decides, not the marginal likelihood: the film and its
prior are the same, but a lag behind the film flattens the relays' columns, and their coefficients leave less room,
whatever was read. That was worth 30 to 60 of log-likelihood to the ohmmeter's lag where the film's was there, 1.5 s at
rows 2 s apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.search.meaning import has_meaning
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.diagnosis.search.restarts import restarted
from sim.effects.effect import Switched, switched

TIMING: Final = frozenset({"film_lag", "meter_lag", "timestamp_skew"})
MUCH_LEFT: Final = 5.0  # mean square residual over noise beside a lag from which the lag may be another
PATH: Final = 100.0  # cost that fits with relays differ by for how they were come by
ROUNDS: Final = 2  # of beginning each from the others: in a third next to none gains
FOR_ONE_MORE: Final = 20.0  # cost that a second delay has to bring, as any effect beside a film of another kind
GAINS: Final = 1.0  # of log-likelihood or cost, by which a fit is better than another


def best_timed(search: ResistanceSearch, names: frozenset[str]) -> frozenset[str]:
    """The effects with another delay in the place of one that fits worse, the film as it is there, relays and all: what
    alike effects were fitted to may differ by more than they do."""
    names = _one_for_several(search, names)
    for name in sorted((names & TIMING) - search.assumed):
        best, found = _swapped(search, names, name)
        if found and best.parameters.has_relays:
            begin = {other: _delay(fit, other) for other, fit in found.items()}
            best = _least_cost(search, best, {name: _delay(search.fit(names), name), **begin})
        names = frozenset(e.name for e in best.effects)
    return names


def likely_timed(search: ResistanceSearch, names: frozenset[str]) -> frozenset[str]:
    """The same by the score of one fit of each, which is a tenth of the work: for what the noise is weighed beside, and
    all begins anew."""
    for name in sorted((names & TIMING) - search.assumed):
        names = frozenset(e.name for e in _swapped(search, names, name)[0].effects)
    return names


def _swapped(
    search: ResistanceSearch, names: frozenset[str], name: str
) -> tuple[ResistanceFit, dict[str, ResistanceFit]]:
    """The best fit with another delay in the place of one, or with that; those with each of the others."""
    best = search.ended(search.fit(names))
    others = sorted((TIMING & search.effects.keys()) - names)
    anew = search.channel.mean_square(best) > MUCH_LEFT
    found = {other: search.instead(best, name, other, anew) for other in search.budget.in_time(others)}
    better = max((f for f in found.values() if has_meaning(search, f)), key=lambda f: f.score, default=best)
    return search.finish(better) if better.score > best.score + GAINS else best, found


def _one_for_several(search: ResistanceSearch, names: frozenset[str]) -> frozenset[str]:
    """The effects with one delay in the place of several, where that costs little more beside a film of another kind: a
    lag of the film is nearly a skew and a lag of the ohmmeter, of half its size each."""
    several, fit = (names & TIMING) - search.assumed, search.fit(names)
    if len(several) < 2 or not fit.parameters.has_relays:
        return names
    whole = sum(abs(float(_delay(fit, name).par[0])) for name in several)
    others = search.budget.in_time(sorted((TIMING & search.effects.keys()) - search.assumed))
    begun = [search.beside(fit, switched(search.effects[name], [whole]), *several) for name in others]
    sound = [one for one in begun if has_meaning(search, one)]
    best = min(sound, key=lambda one: one.cost, default=fit)
    if best.cost < fit.cost + PATH:
        best = restarted(search, search.ended(best))
    return frozenset(e.name for e in best.effects) if best.cost < fit.cost + FOR_ONE_MORE else names


def of_delays(fits: Sequence[ResistanceFit]) -> list[float]:
    """What the likeliest of several fits of a film has the least of, that differ in which delay they have."""
    of_another_kind = all(fit.parameters.has_relays for fit in fits)
    return [fit.cost if of_another_kind else -fit.score for fit in fits]


def _least_cost(search: ResistanceSearch, best: ResistanceFit, sizes: dict[str, Switched]) -> ResistanceFit:
    """The fit, or one with another of these delays in its place. sizes: of each, to begin from."""
    own = next(e.name for e in best.effects if e.name in sizes)
    fits = {own: best}
    for _ in range(ROUNDS):
        gained = False
        for name, size in sizes.items():
            near = [(other, fit) for other, fit in fits.items() if other != name]
            if not near or search.budget.over():
                continue
            other, fit = min(near, key=lambda pair: pair[1].cost)
            found = search.beside(fit, _delay(fits[name], name) if name in fits else size, other)
            if found.cost < min(f.cost for f in fits.values()) + PATH:
                found = restarted(search, search.ended(found))
            if name not in fits or found.cost < fits[name].cost - GAINS:
                fits[name], gained = found, True
        if not gained:
            break
    sound = [f for f in fits.values() if has_meaning(search, f)]
    least = min(sound, key=lambda f: f.cost, default=best)
    return least if least.cost < fits[own].cost - GAINS else fits[own]


def _delay(fit: ResistanceFit, name: str) -> Switched:
    return next(e for e in fit.effects if e.name == name)
