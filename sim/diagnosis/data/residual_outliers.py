"""Readings that a fit shows to be lone: far from what the readings around them are off by.

What a model is off by changes slowly beside what an outlier is off by, so that outliers stand out of a residual that
they do not stand out of in the readings themselves: on a flank, at a corner, on a lattice, two near one another. Where
the readings lie so far apart that neighbours tell as little of one another, nothing is lone.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask, Rows

AROUND = 7  # readings of which the middle one is judged
NEARBY = 21  # readings by whose deviations the noise is taken: seven outliers among them do not show in the median
BESIDE = 11  # the same of what neighbours are off one another: two outliers change the deviations of five or six
FAR = 8.0  # robust standard deviations, besides twice what the medians around differ by
FLANK = 0.25  # of what both neighbours differ by: half a row's step, which no temperature is known better than
FEWEST = 30


def outlying_rows(readings: Array, shown: Array, used: Mask, least: Array | float) -> Rows:
    """Rows of lone readings among the used ones. readings, shown: as they are and as a fit has them, (rows,); least:
    the noise at least, in their unit, or that of each row, (rows,)."""
    residual = readings - shown
    rows = np.flatnonzero(used & np.isfinite(residual))
    if rows.size < FEWEST:
        return np.empty(0, dtype=np.int64)
    r, y = residual[rows], readings[rows]
    middle = median_filter(r, AROUND, mode="nearest")
    reach = maximum_filter1d(middle, AROUND, mode="nearest") - minimum_filter1d(middle, AROUND, mode="nearest")
    away = np.abs(r - middle)
    around = median_filter(away, NEARBY, mode="nearest")  # an instrument's noise is not the same everywhere
    noise = np.maximum(1.4826 * np.maximum(around, np.median(away)), np.broadcast_to(least, readings.shape)[rows])
    chord = median_filter(np.abs(y - 0.5 * (np.roll(y, 1) + np.roll(y, -1))), BESIDE, mode="nearest")
    apart = maximum_filter1d(chord, BESIDE, mode="nearest")  # how far neighbours are off one another about here
    flank = FLANK * np.abs(np.roll(y, 1) - np.roll(y, -1))
    return np.asarray(rows[away > FAR * noise + 2.0 * (reach + apart) + flank], dtype=np.int64)
