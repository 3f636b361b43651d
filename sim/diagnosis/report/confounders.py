"""Effects that this record cannot tell from those that were named."""

from __future__ import annotations

from sim.diagnosis.judge.verdict import Verdict
from sim.diagnosis.search.chain import Chain

CLOSE = 8.0  # log-likelihood: a set that is this close is as good
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
        own = min(gains[name], judged.evidence[name])
        order = sorted((n for n in others if n != name), key=lambda n: -gains[n])[:LOOKED_AT]
        for other in order:
            if gains[other] < HOPE * own:
                continue
            if is_last:
                named, quick = search.fit(chain.split(names)[1]), search.quick(fit, other)
                if quick.score < named.score - FAR:
                    continue
                chain.followed(rest | {other}, max(quick, search.instead(named, name, other), key=lambda f: f.score))
            if chain.score(rest | {other}) > whole - CLOSE:
                found.append(other)
        out[name] = found
    return out
