"""How often clean records reach an evidence: measured, not assumed."""

from __future__ import annotations

import numpy as np

# Evidence of the effects that were named on clean records: of none of them
# (`benchmark diagnosis --kinds clean --first 33000 --seeds 20`).
CLEAN_EVIDENCE: tuple[float, ...] = ()
RECORDS = 300  # clean ones in that run


def false_alarm(evidence: float) -> float:
    """The share of clean records with as much evidence for some effect; never below one over their number."""
    count = int(np.sum(np.asarray(CLEAN_EVIDENCE) >= evidence))
    return max(count, 1) / max(RECORDS, 1)
