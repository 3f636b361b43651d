"""A film that switches in visible steps: what is left beside it is judged with the steps that its domains make.

Beside a smooth density of relays such a film leaves far more than its ohmmeter's noise, and what acts on it is lost, or
stands in for a step. Where what is left grows with how far the film switches, and comes again each time that it goes
through the same temperatures, it is the film's own: effects are searched for anew with such domains in the likelihood.
What is said then counts where it leaves nothing: domains of which more is known than their statistics (fifty, each of
which can be seen) are no walk, and cost names that were found without them.
"""

from __future__ import annotations

from typing import Final

from sim.diagnosis.fit.domain_noise import domain_noise, steps_may_show
from sim.diagnosis.fit.film_basis import SHAPE
from sim.diagnosis.fit.repeated_passes import Repeated, repeated
from sim.diagnosis.fit.unknowns import fitted_parameters
from sim.diagnosis.judge.verdict import Verdict, judge, least_evidence, likeliest_timed
from sim.diagnosis.search.both_ends import select_anew
from sim.diagnosis.search.budget import JUDGING
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.delays import TIMING
from sim.diagnosis.search.film_facts import LEAST_NOISE_DEC
from sim.diagnosis.search.learned import with_domains
from sim.diagnosis.search.stepwise import Progress
from sim.diagnosis.validate.adequacies import adequacies
from sim.diagnosis.validate.deviations import of_one_pass

WORTH: Final = 20.0  # log-likelihood that two numbers more bring where a film has domains: chance brings 10
WORTH_ASKING: Final = 2.0  # the same as below, from which they are fitted, and effects searched for beside them: the
# noise of a fit without them may be too large, and hide that they come again (2.5 where it is 9.9 once they are fitted)
DEVIATIONS: Final = 4.0  # of chance, that what is left of one pass and of another are alike: one record in 30,000
SHARE: Final = 0.3  # their correlation: 0.28 to 0.68 with domains, 0.04 to 0.2 with what heats a film now and then
CERTAIN: Final = 10.0  # deviations from which a smaller correlation does: small domains beside much noise
ONCE: Final = "what shows it comes again at the same temperatures, as the steps of domains do"
ROUNDS: Final = 3  # of domains and effects: each makes the other clearer


def beside_domains(chain: Chain, names: frozenset[str], judged: Verdict, say: Progress) -> tuple[Chain, Verdict]:
    """The chain with the film's domains and what is said then, or both as they are where the film shows none. names:
    the effects that the search had found."""
    if judged.resistance is None or chain.facts is None or chain.sparse is not None or chain.budget.over(JUDGING):
        return chain, judged
    if not any(_may_have_domains(chain, each) for each in dict.fromkeys((judged.fitted, names))):
        return chain, judged
    say("a film that switches in steps")
    other = with_domains(chain, names)
    if not _promises(other, names):
        return chain, judged
    for _ in range(ROUNDS):
        before = names
        other, names = select_anew(other, names, say)
        names = _best_timed(other, names)
        if names == before:
            break
        other = with_domains(other, names)
    if not _is_clean(other, names):  # fewer effects leave no less, and judging them takes the longest
        return chain, judged
    found = _as_of_one_pass(other, judge(other, names))
    if found.resistance is None or not found.resistance.clean or not _come_again(_repeated(other, found.fitted)):
        return chain, judged
    return other, found


def _as_of_one_pass(chain: Chain, judged: Verdict) -> Verdict:
    """Without the effects of film and ohmmeter that are no more than what domains do at one temperature: it comes again
    in each pass, and the likelihood counts every pass anew."""
    while True:
        b, names = chain.fits(judged.fitted)[1], judged.fitted
        assert b is not None
        share, k = of_one_pass(chain, names)[SHAPE:], 0
        weak: dict[str, float] = {}
        for effect in b.effects:
            count = len(fitted_parameters(effect.effect))
            if effect.name in judged.names and count:
                left = judged.evidence[effect.name] * float(share[k])
                if left < least_evidence(chain, names, effect.name):
                    weak[effect.name] = left
            k += count
        if not weak:
            return judged
        weakest = min(weak, key=lambda name: weak[name])
        judged = judge(chain, names - {weakest}, judged, ONCE)


def _best_timed(chain: Chain, names: frozenset[str]) -> frozenset[str]:
    """With the likeliest of those effects that delay what is read of the film in the place of one. Each is followed to
    its end, relays and all, which the search's own swap (`delays`) leaves out: beside steps it chose the wrong lag."""
    for name in sorted((names & TIMING) - chain.assumed):
        others = [names - {name} | {other} for other in sorted(TIMING - names) if other in chain.effects]
        names = likeliest_timed(chain, [names, *chain.budget.in_time(others)])
    return names


def _may_have_domains(chain: Chain, names: frozenset[str]) -> bool:
    """Whether what is left grows as the film switches, and may come again."""
    b = chain.fits(names)[1]
    assert b is not None
    channel = chain.film_channel(names)
    if not steps_may_show(channel, b, WORTH):
        return False
    domains = domain_noise(channel, b, LEAST_NOISE_DEC)
    return domains.gain > WORTH and any(one.deviations > WORTH_ASKING for one in repeated(channel, b, domains))


def _promises(chain: Chain, names: frozenset[str]) -> bool:
    """Whether domains that are fitted may be the cause of what is left: where they leave nothing else, it may come
    again; where they leave something, as they do beside an effect that is still to be found, it does."""
    found = _repeated(chain, names)
    if _come_again(found):
        return True
    return any(one.deviations > WORTH_ASKING for one in found) and _is_clean(chain, names)


def _is_clean(chain: Chain, names: frozenset[str]) -> bool:
    """Whether nothing is left of the film with these effects."""
    resistance = adequacies(chain, names)[1]
    return resistance is not None and resistance.clean


def _repeated(chain: Chain, names: frozenset[str]) -> tuple[Repeated, Repeated]:
    b = chain.fits(names)[1]
    assert b is not None
    assert chain.facts is not None
    assert chain.facts.domains is not None
    return repeated(chain.film_channel(names), b, chain.facts.domains)


def _come_again(found: tuple[Repeated, Repeated]) -> bool:
    return any(one.deviations > (DEVIATIONS if one.share > SHARE else CERTAIN) for one in found)
