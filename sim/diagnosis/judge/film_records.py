"""Names that one record leaves open, and that further records of its film decide.

A film of another kind can do much of what an effect does, as far as one run shows: its relays are told by that very
run. A record from before, as the calibration's, went through the film elsewhere and at another time. With the effect
that is there, one film tells both; without it, or with another one, the film of both is wrong in either. So each set
of effects that was fitted on the way is asked for the film of all records, and what that leaves in the rows that no
fit has seen and that decide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.diagnosis.data.misfit import correlated_rows
from sim.diagnosis.data.record import Record
from sim.diagnosis.judge.elsewhere import GROWS
from sim.diagnosis.judge.verdict import MOST_LEFT, SURVIVES, UNSEEN, Verdict, evidence_by_chance, too_small
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.fitted_better import fitted_better
from sim.diagnosis.search.identified_film import identified_film
from sim.diagnosis.validate.adequacies import adequacies


@dataclass(frozen=True)
class Left:
    """What the film of all records leaves with some effects. square: mean square over the noise in the rows of the run
    that decide, which it does not see; told_dec2: mean square in all readings that told it, and how many of these are
    independent of each other."""

    names: frozenset[str]
    square: float
    told_dec2: float
    independent: float


def told_by_film_records(chain: Chain, judged: Verdict, others: Sequence[Record]) -> Verdict:
    """The verdict with the effects that further records of the film decide; as it was where they decide none."""
    if not others or judged.resistance is None or judged.resistance.clean or chain.facts is None:
        return judged
    upstream = chain.split(judged.fitted)[0]  # the thermometer decides these
    sets = [s for s in fitted_better(chain, judged.fitted, judged.refused) if chain.split(s)[0] == upstream]
    sets = [s for s in sets if judged.fitted < s and not any(too_small(chain, s, n, False) for n in s - judged.fitted)]
    if not sets or (without := _left(chain, judged.fitted, others)) is None:
        return judged
    asked = {s: _left(chain, s, others) for s in chain.budget.in_time(sets, 1.0)}
    found = [left for left in asked.values() if left is not None]
    said = decided(without, found, evidence_by_chance(chain), lambda names: _left(chain, names, []))
    if said is None:
        return judged
    not_asked = [s for s in sets if asked.get(s) is None and not said.names < s]
    if any(chain.score(s) > chain.score(said.names) for s in not_asked):
        return judged  # of a set that tells this record better the film of all records cannot be had
    return _said(chain, judged, said.names, evidence(without, said))


def decided(
    without: Left, found: Sequence[Left], needed: float, alone: Callable[[frozenset[str]], Left | None]
) -> Left | None:
    """The smallest of the sets that bring as much evidence as any, but for what is needed to tell two apart, where it
    is the only one of its size; None where it is not, or does not tell rows that no fit has seen to about their noise,
    or brings less evidence than needed.

    Nor may another cause be left that does as much. With the set, most of what is left there without it is told; or, as
    a film that is not of the class leaves something whatever acts on it, the evidence survives that, and the film of
    all records tells these rows as well as the film that the run alone tells: with the set the records agree. alone: of
    a set, what the latter leaves."""
    if not found:
        return None
    best = min(found, key=lambda left: left.told_dec2)
    good = [left for left in found if evidence(left, best) < needed]
    fewest = min(len(left.names) for left in good)
    least = [left for left in good if len(left.names) == fewest]
    said, brings = least[0], evidence(without, least[0])
    if len(least) > 1 or said.square > UNSEEN**2 or brings < needed:
        return None
    if said.square - 1.0 <= MOST_LEFT * (without.square - 1.0):
        return said
    own = alone(said.names) if brings >= SURVIVES else None
    return said if own is not None and said.square <= GROWS**2 * own.square else None


def evidence(without: Left, found: Left) -> float:
    """Log-likelihood that the one brings over the other: of independent normal errors of either variance."""
    return 0.5 * min(without.independent, found.independent) * math.log(without.told_dec2 / found.told_dec2)


def _left(chain: Chain, names: frozenset[str], others: Sequence[Record]) -> Left | None:
    """None where no film of all records could be identified, or no row decides."""
    record = chain.film_channel(names).record
    assert record.output is not None
    assert chain.facts is not None
    held = np.flatnonzero(record.output_used & record.held_out)
    film = identified_film(chain, names, others, held)
    if film is None:
        return None
    z = (film.left / chain.facts.noise.marginal(record.output[held], held))[record.deciding[held]]
    z = z[np.isfinite(z)]
    if z.size == 0:
        return None
    independent = film.told.size / correlated_rows(film.told)
    return Left(names, float(np.mean(z * z)), float(np.mean(film.told**2)), independent)


def _said(chain: Chain, judged: Verdict, names: frozenset[str], most: float) -> Verdict:
    """most: the evidence that the records give, beyond which none is claimed for what they decide. As it was where this
    record by itself speaks against one of them."""
    new = names - judged.fitted
    brings = {n: min(chain.loses(names, n), most) if n in new else judged.evidence[n] for n in names - chain.assumed}
    if any(brings[name] < evidence_by_chance(chain) for name in new):
        return judged
    temperature, resistance = adequacies(chain, names)
    refused = {name: why for name, why in judged.refused.items() if name not in new}
    order = tuple(sorted(brings, key=lambda name: -brings[name]))
    return replace(
        judged,
        names=order,
        evidence=brings,
        temperature=temperature,
        resistance=resistance,
        refused=refused,
        fitted=names,
        by_records=new,
    )
