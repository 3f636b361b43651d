"""How often a record with nothing in it would show as much evidence for some effect.

With nothing in the record, twice the rise of the log-likelihood by an effect of k free parameters has the distribution
chi^2_k (S. S. Wilks, Ann. Math. Stat. 9 (1938) 60), so that it exceeds an evidence E with P(chi^2_k > 2 E). A search
names the best of all its candidates: the chance that any of them gets so far is at most the sum over them (Bonferroni;
for dependent candidates an upper bound). A parameter that is chosen among several values makes as many candidates.
Where a size is zero without the effect, its other parameters mean nothing there, and where it can only be positive,
half of the chance is gone: the first makes the sum too small, by at most the factor that these parameters' range holds
of separate values, the second too large.

That is the noise's share. What a noise model does not know of is bounded by experience alone: of the clean records
of the blind benchmark none was given a name.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincc

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect

SMALLEST: Final = 1e-12  # share that may be chosen: below it no distribution is known well enough
LARGEST: Final = 0.05  # the same: the search follows up nothing of less evidence (`ENTRY`)
CLEAN_RECORDS: Final = 300  # without any name (`benchmark diagnosis --kinds clean --first 33000 --seeds 20`)


def candidates(effects: Iterable[Effect]) -> Array:
    """The number of free parameters of each candidate, shape (candidates,)."""
    free: list[int] = []
    for effect in effects:
        values = math.prod(len(p.choices) for p in effect.parameters if p.choices)
        free += [sum(not p.choices for p in effect.parameters)] * values
    return np.maximum(np.asarray(free, dtype=np.float64), 1.0)


def chance(evidence: float, free: Array) -> float:
    """The largest share of records with nothing in them, in which some candidate gets so much evidence by noise alone.
    free: as `candidates` counts them."""
    return min(1.0, float(np.sum(gammaincc(0.5 * free, max(evidence, 0.0)))))


def evidence_for(share: float, free: Array) -> float:
    """The evidence that noise alone reaches in this share of records with nothing in them, at most."""
    most = -math.log(share) + 10.0 * float(np.max(free)) + math.log(free.size)  # beyond it for any number of both
    return float(brentq(lambda evidence: math.log(max(chance(evidence, free), 1e-300) / share), 0.0, most))


def false_alarm(evidence: float, free: Array) -> float:
    """The same chance, never below what experience bounds."""
    return max(chance(evidence, free), 1.0 / CLEAN_RECORDS)
