"""The lattice that rounded readings lie on."""

from __future__ import annotations

import numpy as np

from compensator.functions import Array

SMALLEST_K = 0.02  # a file's own last digit is no finding
FEWEST_PER_STEP = 4.0


def lattice_step(values: Array) -> float:
    """The step of readings on a lattice k step, 0 where there is none that matters."""
    distinct = np.unique(values)
    if distinct.size < 3 or values.size < FEWEST_PER_STEP * distinct.size:
        return 0.0
    gaps = np.diff(distinct)
    tolerance = 1e-6 * max(float(np.max(np.abs(distinct))), 1.0)
    gaps = gaps[gaps > tolerance]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * np.min(gaps)]))
    for _ in range(3):  # the step that fits the whole range
        index = np.round((distinct - distinct[0]) / step)
        if index[-1] < 2:
            return 0.0
        step = float(index @ (distinct - distinct[0]) / (index @ index))
    away = np.abs((distinct - distinct[0]) - step * np.round((distinct - distinct[0]) / step))
    if step < SMALLEST_K or np.mean(away < 0.02 * step) < 0.98:
        return 0.0
    return step
