"""From all effects to those that the whole record needs: each end of the chain for itself, then over both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.search.budget import SEARCHING
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.delays import TIMING
from sim.diagnosis.search.film_mixing import mixed_at_last
from sim.diagnosis.search.joint_fit import widened
from sim.diagnosis.search.learned import first_renoised, last_renoised, with_film
from sim.diagnosis.search.meaning import has_meaning
from sim.diagnosis.search.stepwise import (
    ENTRY,
    FAR_FROM_NOISE,
    LEAVES_LESS,
    MOST_EFFECTS,
    ROUGH,
    TRIED,
    Progress,
    select_first_links,
    select_last_links,
)
from sim.diagnosis.search.temperature_search import TELLS, TemperatureSearch, beside_misfit
from sim.effects.effect import Switched, jumps

HINT = 2.0  # log-likelihood in the first channel that makes an effect a confounder of one in the last
NEAR = 40.0  # sets this close in score are looked at on the other channel too


def select(chain: Chain, say: Progress) -> tuple[Chain, frozenset[str]]:
    """The effects that the whole record asks for; and the chain with what was learned and found on the way. The one
    given stays as it was."""
    chain, upstream = chain.apart(), frozenset[str]()
    if chain.first is not None:
        chain, upstream = _selected_first(chain, chain.first, say)
    if chain.record.output is None:
        return chain, upstream
    chain, downstream = _film_asked(chain, upstream, _selected_last(chain, upstream, say), say)
    return _over_both(chain, upstream | downstream, say)


def _film_asked(
    chain: Chain, upstream: frozenset[str], found: tuple[Chain, frozenset[str]], say: Progress
) -> tuple[Chain, frozenset[str]]:
    """What was found of the last links, or of the same behind a plate and a thermometer with their time constants
    exchanged: where the thermometer does not tell which is which, the film does, which follows the plate."""
    first = chain.first
    if first is None or found[0].sparse is not None or _left(found, upstream)[1] < ROUGH:
        return found
    fit = first.fit(upstream)
    for effect in chain.budget.in_time(fit.effects):
        other = first.exchanged(fit, effect)
        if other is not None and has_meaning(first, other) and other.minus_log - fit.minus_log < TELLS:
            say("a plate that is faster than its thermometer")
            turned = replace(chain, first=replace(first, fits={**first.fits, upstream: other})).apart()
            trial = _selected_last(turned, upstream, say)
            found = trial if _left(trial, upstream)[0] < LEAVES_LESS * _left(found, upstream)[0] else found
    return found


def _left(found: tuple[Chain, frozenset[str]], upstream: frozenset[str]) -> tuple[float, float]:
    """Root mean square of what is left of the film's output, and its mean square over the noise."""
    search = found[0].last(upstream)
    fit, channel = search.fit(found[1]), search.channel
    return float(np.sqrt(np.mean((channel.output - fit.shown)[channel.rows] ** 2))), channel.mean_square(fit)


def select_anew(chain: Chain, names: frozenset[str], say: Progress) -> tuple[Chain, frozenset[str]]:
    """The same from these effects on, for a chain whose film's noise is another one now."""
    upstream, downstream = chain.split(names)
    downstream = select_last_links(chain.last(upstream), downstream, say=say)
    return _over_both(replace(chain, together=False), upstream | downstream, say)


def _over_both(chain: Chain, names: frozenset[str], say: Progress) -> tuple[Chain, frozenset[str]]:
    """What each end asks for by itself, as both together see it."""
    if chain.first is None:
        return chain, names
    say("both together")
    names = _swapped_between(chain, names)
    chain = replace(chain, together=True)
    return chain, _of_both_channels(chain, names)


def _selected_first(chain: Chain, first: TemperatureSearch, say: Progress) -> tuple[Chain, frozenset[str]]:
    """The effects of the first links, the noise weighed anew once they are known; beside what nothing explains where
    there is no film to tell more."""
    say("current to temperature")
    names = select_first_links(first)
    learned = first_renoised(chain, names)
    if learned.first is not None and learned is not chain:
        chain, first = learned, learned.first
        names = select_first_links(first, names)
    beside = beside_misfit(first, names) if chain.record.output is None else None
    if beside is None:
        return chain, names
    say("current to temperature, beside what nothing explains")
    return replace(chain, first=beside), select_first_links(beside)


def _selected_last(chain: Chain, upstream: frozenset[str], say: Progress) -> tuple[Chain, frozenset[str]]:
    """The effects of the last links, the noise weighed anew once the first of them is known, and once all are: one that
    is too large would let further effects do what another film does."""
    chain, names = with_film(chain, upstream), frozenset[str]()
    if chain.sparse is not None:
        return chain, chain.last(upstream).assumed  # the film between two rows may do what any effect does
    for steps in (1, MOST_EFFECTS):
        before, changed = names, False
        names = select_last_links(chain.last(upstream), names, steps, say)
        if 2.0 * chain.last(upstream).fit(names).minus_log < FAR_FROM_NOISE * chain.record.rows:
            chain, changed = last_renoised(chain, upstream | names)
        if names == before and not changed:
            break  # the same search would find the same
    names = select_last_links(chain.last(upstream), names, say=say) if changed else names
    return _mixed_at_last(chain, upstream, names, say)


def _mixed_at_last(
    chain: Chain, upstream: frozenset[str], names: frozenset[str], say: Progress
) -> tuple[Chain, frozenset[str]]:
    """Where much is left by all that was found, and little once the film's phases mix otherwise: the same search beside
    such a film."""
    begin = None if chain.budget.over(SEARCHING) else mixed_at_last(chain.last(upstream), names)
    if begin is None:
        return chain, names
    say("a film whose phases mix otherwise")
    chain, _ = last_renoised(chain, upstream | begin)
    return chain, select_last_links(chain.last(upstream), begin, say=say)


def worth(chain: Chain, names: frozenset[str]) -> float:
    """Score less what each effect has to bring."""
    return chain.score(names) - ENTRY * len(names)


def _swapped_between(chain: Chain, names: frozenset[str]) -> frozenset[str]:
    """What delays temperature and what delays resistance look alike in one channel: try each in place of the other."""
    first = chain.first
    assert first is not None
    for _ in range(3):  # as above; each costs much more
        upstream, downstream = chain.split(names)
        moving = [n for n in first.effects if first.effects[n].link != "plate"]
        timing = sorted((downstream & TIMING) - chain.assumed)
        base = first.fit(upstream)
        options = []
        for n in moving:
            if n in upstream or not timing or chain.budget.over(SEARCHING):
                continue
            if first.score_test(base, n) > HINT and base.minus_log - first.fit(upstream | {n}, base).minus_log > HINT:
                options.append(upstream | {n})
        for a in moving:
            for b in moving:
                if a in upstream - chain.assumed and b not in upstream:
                    option = (upstream - {a}) | {b}
                    if first.fit(option).minus_log - base.minus_log < NEAR:
                        options.append(option)
        best, value = names, worth(chain, names)
        for option in chain.budget.in_time(options):
            for rest in [downstream, *[downstream - {n} for n in timing]]:
                trial = option | rest
                if worth(chain, trial) > value + 0.5:
                    best, value = trial, worth(chain, trial)
        if best == names:
            return names
        names = best
    return names


def _of_both_channels(chain: Chain, names: frozenset[str]) -> frozenset[str]:
    """What the thermometer is too dull for: effects of the first links that both channels together ask for."""
    while len(names - chain.assumed) < MOST_EFFECTS:
        joint = chain.joint(names)
        if joint is None or chain.first is None:
            return names
        found: dict[str, tuple[float, Switched]] = {}
        for name, effect in chain.first.effects.items():
            if name not in names and not jumps(effect):
                found[name] = joint.score_test(effect)
        likely = sorted((n for n in found if found[n][0] > ENTRY), key=lambda n: -found[n][0])[:TRIED]
        best, value = names, chain.score(names) + ENTRY
        for name in chain.budget.in_time(likely):
            trial = widened(joint, found[name][1])
            if trial is None or not has_meaning(chain.first, trial.a):
                continue
            chain.keep(names | {name}, trial)
            if chain.score(names | {name}) > value:
                best, value = names | {name}, chain.score(names | {name})
        if best == names:
            return names
        added, names = best - names, best
        for name in sorted(names - added - chain.assumed):  # what stood in for it goes
            if chain.score(names) - chain.score(names - {name}) < ENTRY:
                names -= {name}
    return names
