"""A film whose base model has no memoryless part D(T): what it lacks is named as an effect of its own, or it has none.

Nothing tells a smooth D(T) from a film of another kind that goes round one loop. Only where the base without D(T) tells
the record far worse is D(T) needed; where it does not, or where there was no time to ask, the model has none either.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.judge.false_alarm import candidates, false_alarm
from sim.diagnosis.report.warnings import memoryless_not_asked
from sim.diagnosis.result import Diagnosis, Finding, verdict_of
from sim.diagnosis.search.budget import Budget
from sim.diagnosis.search.learned import with_film
from sim.diagnosis.search.stepwise import ABSORBS
from sim.diagnosis.validate.gain import gain
from sim.diagnosis.validate.held_out_rows import HeldOutRows
from sim.effects import memoryless_term


def without_memoryless(found: Diagnosis, held_out: HeldOutRows, out_of_time: bool) -> Diagnosis:
    """The diagnosis with D(T) named where the film needs it, else with a film that may not have one."""
    if found.chain.record.output is None:
        return found
    bare = replace(found, chain=replace(found.chain, curve=False))
    if out_of_time:
        return replace(bare, warnings=[*bare.warnings, memoryless_not_asked()])
    term = _lacking(found, held_out)
    if term is None:
        return bare
    findings = sorted([*found.findings, term], key=lambda f: -f.evidence)
    return replace(found, findings=findings, verdict=verdict_of(findings, found.unexplained))


def _lacking(found: Diagnosis, held_out: HeldOutRows) -> Finding | None:
    """What a base film without D(T) lacks; None where it lacks nothing."""
    chain, names = found.chain, found.judged.fitted
    b = chain.fits(names)[1]
    if b is None or chain.facts is None or chain.facts.basis.curve is None:
        return None
    anew, upstream = replace(chain, together=False, budget=Budget()), chain.split(names)[0]
    plain = with_film(replace(anew, relays=False), upstream)
    of_the_class = chain.score(names) - plain.score(names) < ABSORBS  # then nothing but D may stand in for what D does
    bare = with_film(replace(anew, curve=False, relays=not of_the_class), upstream)
    evidence = (plain if of_the_class else chain).score(names) - bare.score(names)
    if evidence < ABSORBS:
        return None
    curve = chain.facts.basis.curve
    path = chain.film_channel(names).path
    range_degC = np.linspace(float(np.min(path.plate_degC)), float(np.max(path.plate_degC)), 200)  # D is smooth
    span = float(np.ptp(curve.columns(range_degC) @ b.coefficients[1 : 1 + curve.count])) * chain.record.quantity.size
    span_name = f"span_{chain.record.quantity.unit}"
    before, after = (held_out.residuals(names, c)["resistance_dec"] for c in (bare, chain))
    gains = {"resistance_dec": gain(before, after, held_out.rows)}
    chance = false_alarm(evidence, candidates(chain.searched))
    return Finding(memoryless_term.NAME, {span_name: (span, None)}, evidence, chance, [], gains)
