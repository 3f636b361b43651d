"""Readings that a fit shows to be lone: far from what the readings around them are off by.

What a model is off by changes slowly beside what an outlier is off by, so that outliers stand out of a residual that
they do not stand out of in the readings themselves: on a flank, at a corner, on a lattice, two near one another.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask, Rows

AROUND = 7  # readings of which the middle one is judged
FAR = 8.0  # robust standard deviations, besides twice what the medians around differ by
FEWEST = 30


def strays(residual: Array, used: Mask, least: float) -> Rows:
    """Rows of lone readings among the used ones. residual: (rows,); least: the noise at least, in its unit."""
    rows = np.flatnonzero(used & np.isfinite(residual))
    if rows.size < FEWEST:
        return np.empty(0, dtype=np.int64)
    r = residual[rows]
    middle = median_filter(r, AROUND, mode="nearest")
    reach = maximum_filter1d(middle, AROUND, mode="nearest") - minimum_filter1d(middle, AROUND, mode="nearest")
    away = np.abs(r - middle)
    noise = max(1.4826 * float(np.median(away)), least)
    return np.asarray(rows[away > FAR * noise + 2.0 * reach], dtype=np.int64)
