"""Lone outliers: readings that neither their neighbours nor the trend on either side can explain.

A reading is compared with the hull of its two neighbours on each side and of the straight lines through them, so that
steep flanks and corners are no outliers; one further outside than the hull is wide, and than noise allows, is one.
The noise is the median deviation from the neighbours' mean (P. J. Rousseeuw, C. Croux, J. Am. Stat. Assoc. 88 (1993)
1273, on such scales).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

FAR: Final = 8.0  # in robust standard deviations, besides the hull's width
FEWEST: Final = 7


def lone_outliers(values: Array, finite: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return rows of lone outliers among the finite values, shape (found,)."""
    rows = np.flatnonzero(finite)
    if rows.size < FEWEST:
        return np.empty(0, dtype=np.int64)
    y = values[rows]
    padded = np.concatenate((y[2:0:-1], y, y[-2:-4:-1]))
    before2, before, after, after2 = (padded[k : k + y.size] for k in (0, 1, 3, 4))
    around = np.stack((before2, before, after, after2, 2.0 * before - before2, 2.0 * after - after2))
    low, high = around.min(axis=0), around.max(axis=0)
    outside = np.maximum(np.maximum(low - y, y - high), 0.0)
    noise = 1.2 * float(np.median(np.abs(y - 0.5 * (before + after)))) + 1e-9 * (1.0 + float(np.ptp(y)))
    return np.asarray(rows[outside > FAR * noise + (high - low)], dtype=np.int64)
