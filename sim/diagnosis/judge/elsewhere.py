"""Names that other records of the same rig speak against are not said.

A film of another kind may bend its own output, which another record shows. And where a fit leaves what no model
explains, an effect may do there what another cause does: then the error of a prediction grows with it elsewhere. A
record that is understood needs no such question: there the evidence is certain, and what its first rows leave open of
another's room is more than some effects change.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from sim.diagnosis.data.record import Record
from sim.diagnosis.judge.verdict import Verdict, bends_elsewhere, judge
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.held_out import residuals_on
from sim.model.own_fit import told_rows

GROWS: Final = 1.05  # times the error from which it grows: what a candidate that is told has to gain
BENDS: Final = "on another record the film is not understood, and may bend its output itself"


def borne_out(chain: Chain, judged: Verdict, others: Sequence[Record]) -> Verdict:
    """Less the names that other records speak against."""
    for other in others:
        if bends := bends_elsewhere(chain, judged.fitted, other):
            judged = judge(chain, judged.fitted - bends, judged, BENDS)
    driven = [other for other in others if other.current_A is not None]
    if chain.first is None or chain.first.channel.misfit <= 1.0 or not driven:
        return judged
    while judged.names:
        with_all = _error_K(chain, judged.fitted, driven)
        without = {n: _error_K(chain, judged.fitted - {n}, driven) for n in judged.names}
        worst = min(without, key=lambda name: without[name])
        if with_all < GROWS * without[worst]:
            break
        why = f"on another record the error grows with it from {without[worst]:.2g} to {with_all:.2g} K"
        judged = judge(chain, judged.fitted - {worst}, judged, why)
    return judged


def _error_K(chain: Chain, names: frozenset[str], others: Sequence[Record]) -> float:
    """Of a prediction of the others from their currents, what is their own fitted to their first rows."""
    left = [residuals_on(chain, names, other, told_rows(other))["temperature_K"] for other in others]
    return float(np.sqrt(np.nanmean(np.concatenate(left) ** 2)))
