"""Where a lag was refused for what it smooths, the rest is judged on a path that is smoothed as the film tells it."""

from __future__ import annotations

from typing import Final

from sim.diagnosis.judge.smoother_path import on_smoothed
from sim.diagnosis.judge.verdict import SMOOTHS, Verdict, judge
from sim.diagnosis.search.budget import JUDGING
from sim.diagnosis.search.chain import Chain

SHARES: Final = (0.25, 0.5, 0.7, 1.0)  # of the lag that was refused: to half as much again as smooths like it


def on_a_smoothed_path(chain: Chain, names: frozenset[str], judged: Verdict) -> tuple[Chain, Verdict]:
    """The chain on the path that the film fits best to, and what is said there; both as they are where no lag was
    refused so, or no smoother path is better. names: that the search found."""
    refused = {name for name, why in judged.refused.items() if why == SMOOTHS}
    b = chain.fits(names)[1]
    if b is None or not refused or chain.budget.over(JUDGING):
        return chain, judged
    tau_s = max((e.values()["tau_s"] for e in b.effects if e.name in refused), default=0.0)
    tried = [on_smoothed(chain, judged.fitted, share * tau_s) for share in SHARES if tau_s > 0.0]
    best = max([chain, *tried], key=lambda each: each.score(judged.fitted))
    return (chain, judged) if best is chain else (best, judge(best, judged.fitted, judged))
