"""The lattice that rounded readings lie on."""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.functions import Array

SMALLEST_K = 0.02  # a file's own last digit is no finding
FEWEST_PER_STEP = 4.0
NEAR = 0.02  # of a step: on the lattice
MOST_ON_IT = 0.98  # of the readings
FEW = 4  # of the values, over which the median distance of neighbours numbers them rightly
ALIKE = 9  # digits in which readings are the same: converted or averaged ones differ in the last of sixteen


def lattice_step(values: Array) -> float:
    """The step of readings on a lattice k step, 0 where there is none that matters. It is told by the values that
    repeat; few readings may lie off it, as outliers do."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest > 0.0:
        values = np.round(values, ALIKE - 1 - math.floor(math.log10(largest)))
    distinct, times = np.unique(values, return_counts=True)
    distinct, times = distinct[times > 1], times[times > 1]
    if distinct.size < 3 or np.sum(times) < FEWEST_PER_STEP * distinct.size:
        return 0.0
    gaps = np.diff(distinct)
    tolerance = 1e-6 * max(float(np.max(np.abs(distinct))), 1.0)
    gaps = gaps[gaps > tolerance]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * np.min(gaps)]))
    count = FEW
    while True:  # over a longer and longer range, since a file's last digit hides the step over a short one
        part = distinct[:count] - distinct[0]
        index = np.round(part / step)
        if index[-1] < 2:
            return 0.0
        step = float(np.polyfit(index, part, 1)[0])
        if count >= distinct.size:
            break
        count *= 2
    index = (values - distinct[0]) / step
    if step < SMALLEST_K or np.mean(np.abs(index - np.round(index)) < NEAR) < MOST_ON_IT:
        return 0.0
    return step


def step_error(values: Array, step: float) -> float:
    """The standard error of a lattice's step: readings lie off it by a file's own last digit."""
    distinct = np.unique(values)
    index = np.round((distinct - distinct[0]) / step)
    off, index = distinct - distinct[0] - index * step, index - np.mean(index)
    on_it = np.abs(off) < NEAR * step
    return float(np.std(off[on_it]) / np.sqrt(np.sum(index[on_it] ** 2)))
