"""Names that other records of the same rig speak against are not said.

A film of another kind may bend its own output, which another record shows. And where a fit leaves what no model
explains, an effect may do there what another cause does: then the error of a prediction grows with it elsewhere. A
record that is understood needs no such question: there the evidence is certain, and what its first rows leave open of
another's room is more than some effects change.

Rows that decide do not judge. The other records are two halves (`sim.diagnosis.validate.halves`), and each is asked by
itself. A name is said where neither half speaks against it. A half judges where the other one alone comes to just these
names: so both do where they agree, each of what the other one decided, and else the one whose answer changed nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.misfit import correlated_rows
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.judge.output_nonlinearity import only_bends
from sim.diagnosis.judge.verdict import (
    UNSEEN,
    Verdict,
    film_of_the_class,
    judge,
    resistance_residual,
    temperature_residual,
)
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.halves import Halves, halves_of
from sim.diagnosis.validate.held_out import residuals_on
from sim.model.own_fit import told_rows

GROWS: Final = 1.05  # times the error from which it grows: what a candidate that is told has to gain
BENDS: Final = "on another record the film is not understood, and may bend its output itself"
Errors = Callable[[frozenset[str]], Array]


@dataclass(frozen=True, eq=False)
class BorneOut:
    """judged: less the names that other records speak against; halves: of these records' rows, and which of them
    judge; None without other records."""

    judged: Verdict
    halves: Halves | None = None


def borne_out(chain: Chain, judged: Verdict, others: Sequence[Record]) -> BorneOut:
    """What others of the same rig leave of a verdict."""
    if not others:
        return BorneOut(judged)
    halves = halves_of(others, [_correlated_s(chain, judged.fitted, other) for other in others])
    driven = chain.first is not None and chain.first.channel.misfit > 1.0 and bool(judged.names)
    driven = driven and any(other.current_A is not None for other in others)
    if not driven and not _may_bend(chain, judged.fitted):
        return BorneOut(judged, halves)
    errors = _predictions(chain, others) if driven else None
    found = [_less(chain, judged, others, half, errors) for half in (halves.first, halves.second)]
    said = found[0].fitted & found[1].fitted
    alone = [one.fitted == said for one in found]
    if any(alone):
        return BorneOut(found[alone.index(True)], halves.judged_by(first=alone[1], second=alone[0]))
    why = "each half of the other records speaks against another name"
    return BorneOut(judge(chain, said, judged, why), halves.judged_by(first=False, second=False))


def _may_bend(chain: Chain, names: frozenset[str]) -> frozenset[str]:
    """The effects that bend the reading of a film of another kind, which may bend it itself."""
    if chain.facts is None or film_of_the_class(chain, names):
        return frozenset()
    return frozenset(n for n in names - chain.assumed if only_bends(chain.effects[n]))


def _bends_elsewhere(chain: Chain, names: frozenset[str], other: Record, rows: Mask) -> frozenset[str]:
    """Those of them where these rows of another record show that the film is not understood."""
    bends = _may_bend(chain, names)
    if not bends or chain.facts is None or other.output is None:
        return frozenset()
    left = residuals_on(chain, names, other, rows, known=True)["resistance_dec"]
    z = (left / chain.facts.noise.marginal(np.nan_to_num(other.output)))[rows & np.isfinite(left)]
    return bends if z.size and np.sqrt(np.mean(z * z)) > UNSEEN else frozenset()


def _less(
    chain: Chain, judged: Verdict, others: Sequence[Record], half: tuple[Mask, ...], errors: Errors | None
) -> Verdict:
    """Without the names that these rows of the others speak against. errors: of a set's prediction in all their rows,
    one record after the other; None where they are not asked."""
    for other, rows in zip(others, half, strict=True):
        if np.any(rows) and (bends := _bends_elsewhere(chain, judged.fitted, other, rows)):
            judged = judge(chain, judged.fitted - bends, judged, BENDS)
    asked = np.concatenate(half)

    def error_K(names: frozenset[str]) -> float:
        assert errors is not None
        left = errors(names)[asked]
        return float(np.sqrt(np.mean(left[np.isfinite(left)] ** 2))) if np.any(np.isfinite(left)) else 0.0

    while errors is not None and judged.names:
        with_all = error_K(judged.fitted)
        without = {n: error_K(judged.fitted - {n}) for n in judged.names}
        worst = min(without, key=lambda name: without[name])
        if with_all < GROWS * without[worst] or with_all == 0.0:
            break
        why = f"on another record the error grows with it from {without[worst]:.2g} to {with_all:.2g} K"
        judged = judge(chain, judged.fitted - {worst}, judged, why)
    return judged


def _predictions(chain: Chain, others: Sequence[Record]) -> Errors:
    """Of a set of effects, what is left of the others predicted from their currents, what is their own fitted to their
    first rows: K, one record after the other, nan without a reading; each set predicted once."""
    known: dict[frozenset[str], Array] = {}

    def of(names: frozenset[str]) -> Array:
        if names not in known:
            known[names] = np.concatenate([_left_K(chain, names, other) for other in others])
        return known[names]

    return of


def _left_K(chain: Chain, names: frozenset[str], other: Record) -> Array:
    if other.current_A is None:
        return np.full(other.rows, np.nan)
    return residuals_on(chain, names, other, told_rows(other))["temperature_K"]


def _correlated_s(chain: Chain, names: frozenset[str], other: Record) -> float:
    """For how long what is left hangs together: of the fit, and of the other record's prediction, which a room or a
    sink of its own takes off its course for minutes."""
    z, rows = (resistance_residual if chain.first is None else temperature_residual)(chain, names)
    longest = correlated_rows(z) * float(np.median(np.diff(chain.record.time_s[rows])))
    for left in residuals_on(chain, names, other, told_rows(other)).values():
        longest = max(longest, correlated_rows(left[np.isfinite(left)]) * other.interval_s)
    return longest
