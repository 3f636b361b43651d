"""How often clean records reach an evidence: measured, not assumed."""

from __future__ import annotations

import numpy as np

# Evidence of the effects that were named on clean records of the blind cases (kind "clean", seeds 4 to 149, and twelve
# of kind "other_film"), with what the diagnosis was before the memory at the first row was searched for beside the
# effects; on the others none was. None was named on the 28 that were looked at since (`benchmark diagnosis`).
CLEAN_EVIDENCE: tuple[float, ...] = (18.7,)
RECORDS = 158


def false_alarm(evidence: float) -> float:
    """The share of clean records with as much evidence for some effect; never below one over their number."""
    count = int(np.sum(np.asarray(CLEAN_EVIDENCE) >= evidence))
    return max(count, 1) / max(RECORDS, 1)
