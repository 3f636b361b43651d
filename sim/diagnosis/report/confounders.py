"""Effects that this record cannot tell from those that were named."""

from __future__ import annotations

from sim.diagnosis.judge.smoother_path import LEAST_BEYOND
from sim.diagnosis.judge.verdict import Verdict, is_prandtl_ishlinskii
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.delays import TIMING
from sim.diagnosis.search.stepwise import ABSORBS

CLOSE = 8.0  # log-likelihood: a set that is this close is as good
CLOSE_BESIDE_RELAYS = 2.0 * ABSORBS  # of two effects each may owe as much to what relays lack: a lag of 0.5 s in the
# film, at rows 1 s apart, was 33 worse than one of the ohmmeter; where lags are told apart it is hundreds
LOOKED_AT = 3
FAR = 40.0  # log-likelihood after a few steps that no more steps make up for
HOPE = 0.5  # share of the effect's own score test that a confounder has to reach


def confounders_of(chain: Chain, names: frozenset[str], judged: Verdict) -> dict[str, list[str]]:
    """By named effect, the others that do as well in its place."""
    out: dict[str, list[str]] = {}
    whole = chain.score(names)
    for name in chain.budget.in_time(judged.names, 1.0):
        rest = names - {name}
        upstream, downstream = chain.split(rest)
        is_last = name in chain.split(names)[1]
        found = []
        beside_relays = is_last and not is_prandtl_ishlinskii(chain, names)
        if is_last:
            search = chain.last(upstream)
            fit = search.fit(downstream)
            others = [n for n in search.effects if n not in rest]
            gains = {n: max(t.gain for t in each) for n, each in search.score_tests(fit, others).items()}
        else:
            assert chain.first is not None
            first = chain.first.fit(upstream)
            others = [n for n in chain.first.effects if n not in rest]
            gains = {n: chain.first.score_test(first, n) for n in others}
        own = gains[name] if beside_relays else min(gains[name], judged.evidence[name])
        order = sorted((n for n in others if n != name), key=lambda n: -gains[n])[:LOOKED_AT]
        delays = [n for n in others if n != name and _delay_on_a_measured_path(chain, name, n)]
        for other in dict.fromkeys([*order, *delays]):
            alike = other in delays
            if gains[other] < HOPE * own and not alike:
                continue
            if is_last and not beside_relays:  # a few steps say nothing of where relays settle
                named = search.fit(chain.split(names)[1])
                begun = search.quick(fit, other), chain.instead(names, name, other)
                best = max(begun, key=lambda f: f.score)
                if best.score < named.score - FAR:
                    continue
                chain.followed(rest | {other}, best)
            if alike and beside_relays:  # begun without either, the film may be another one
                named = search.fit(chain.split(names)[1])
                bare = search.starts(named.parameters, [e for e in named.effects if e.name != name], other)[0]
                search.ended(search.beside(named, next(e for e in bare.effects if e.name == other), name))
            close = LEAST_BEYOND if alike else CLOSE_BESIDE_RELAYS if beside_relays else CLOSE
            if chain.score(rest | {other}) > whole - close:
                found.append(other)
        out[name] = found
    return out


def _delay_on_a_measured_path(chain: Chain, name: str, other: str) -> bool:
    """Whether both delay a film on a path that was measured. They are told apart by the corners of that path, which its
    noise rounds or sharpens as a lag does: there a set is as good that is as close as what a lag has to bring beyond a
    smoother path."""
    noise = chain.facts.noise if chain.facts is not None else None
    return noise is not None and noise.path is not None and TIMING.issuperset((name, other))
