"""How often clean records reach an evidence: measured, not assumed."""

from __future__ import annotations

import numpy as np

# Largest evidence of any effect on clean records of the blind cases, those of other films included, sorted: what
# `./peltier benchmark diagnosis --kinds clean,other_film` prints.
CLEAN_EVIDENCE: tuple[float, ...] = ()
RECORDS = 100


def false_alarm(evidence: float) -> float:
    """The share of clean records with as much evidence for some effect; never below one over their number."""
    count = int(np.sum(np.asarray(CLEAN_EVIDENCE) >= evidence))
    return max(count, 1) / max(RECORDS, 1)
