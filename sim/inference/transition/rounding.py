"""What the last digit of a thermometer may do to readings, row by row, and slowly.

Where a ramp goes on by about as much in a row as the readings are rounded to, the rounding's error is no noise: it
drifts from row to row, and over many of them all readings are off to the same side (the beat of the two steps). How far
nobody knows who has only the readings, because they do not tell where the lattice lies to the truth: so every place of
it is tried. The thermometer's own noise before the rounding breaks the beat, and is drawn with it.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array

NEAR: Final = 0.02  # of a step: on the lattice
MOST_ON_IT: Final = 0.98  # of the readings; outliers may lie off it
TOLERANCE: Final = 1e-6  # of the largest reading: two readings that differ by less are the same in floating point


def last_digit(readings: Array) -> float:
    """The step that finite readings are rounded to, 0 where there is none."""
    distinct = np.unique(readings[np.isfinite(readings)])
    if distinct.size < 3:
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > TOLERANCE * max(float(np.max(np.abs(distinct))), 1.0)]
    if gaps.size < 2:
        return 0.0
    step = float(np.min(gaps))
    index = (distinct - distinct[0]) / step
    return step if np.mean(np.abs(index - np.round(index)) < NEAR) >= MOST_ON_IT else 0.0


def rounding_errors(course: Array, step: float, noise: float, draws: int, seed: int) -> Array:
    """What the rounding adds to each reading of a course, in its unit, shape (draws, rows); noise: the standard
    deviation of the readings' noise, the rounding's own in it."""
    random = np.random.default_rng(seed)
    before = np.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    place = (np.arange(draws)[:, None] + random.random()) / draws * step
    true = course + place + before * random.standard_normal((draws, course.size))
    return np.asarray(step * np.round(true / step) - true, dtype=np.float64)
