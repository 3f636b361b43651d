"""The lattice that rounded readings lie on."""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.functions import Array

SMALLEST_K = 0.02  # a file's own last digit is no finding
NEAR = 0.02  # of a step: on the lattice, unless the file's last digit is coarser
FARTHEST = 0.15  # of a step: of a coarser digit three in ten readings anywhere would be on it
MOST_ON_IT = 0.98  # of the readings
OFF = 0.05  # share of a step of `SMALLEST_K`: a last digit of 0.001, by which the distance of neighbours may be off
IN_A_TURN = 8.0  # steps tried for each by which the last reading's number changes by one
ENOUGH = 2000  # values to tell a step by: each more sharpens nothing
ALIKE = 9  # digits in which readings are the same: converted or averaged ones differ in the last of sixteen


def lattice_step(values: Array) -> float:
    """The step of readings on a lattice k step, 0 where there is none that matters. It is told by the values that
    repeat; few readings may lie off it, as outliers do."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest > 0.0:
        values = np.round(values, ALIKE - 1 - math.floor(math.log10(largest)))
    distinct, times = np.unique(values, return_counts=True)
    distinct = distinct[times > 1]
    if distinct.size < 3:
        return 0.0
    gaps = np.diff(distinct)
    tolerance = 1e-6 * max(float(np.max(np.abs(distinct))), 1.0)
    gaps = gaps[gaps > tolerance]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * np.min(gaps)]))
    if (1.0 + OFF) * step < SMALLEST_K:
        return 0.0
    # a file's last digit hides the step between neighbours, not over the whole range
    some = distinct[:: 1 + distinct.size // ENOUGH] - distinct[0]
    turns = np.linspace(1.0 - OFF, 1.0 + OFF, 3 + round(IN_A_TURN * 2.0 * OFF * float(some[-1]) / step)) / step
    sharp = [abs(np.mean(np.exp(2j * np.pi * turn * some))) for turn in turns.tolist()]
    step = 1.0 / float(turns[int(np.argmax(sharp))])
    index = np.round((distinct - distinct[0]) / step)
    if index[-1] < 2:
        return 0.0
    step, first = (float(number) for number in np.polyfit(index, distinct, 1))
    index = (values - first) / step
    if step < SMALLEST_K or np.mean(np.abs(index - np.round(index)) < _near(distinct, step)) < MOST_ON_IT:
        return 0.0
    return step


def _near(distinct: Array, step: float) -> float:
    """How far from the lattice readings on it may lie, in steps: half of a file's last digit. distinct: values."""
    for digits in range(ALIKE):
        last = 10.0**-digits
        if np.all(np.abs(distinct / last - np.round(distinct / last)) < 1e-3):
            return float(np.clip(0.55 * last / step, NEAR, FARTHEST))
    return NEAR


def step_error(values: Array, step: float) -> float:
    """The standard error of a lattice's step: readings lie off it by a file's own last digit."""
    distinct = np.unique(values)
    index = np.round((distinct - distinct[0]) / step)
    off, index = distinct - distinct[0] - index * step, index - np.mean(index)
    off -= np.median(off)  # the first one is off, too
    on_it = np.abs(off) < _near(distinct, step) * step
    return float(np.std(off[on_it]) / np.sqrt(np.sum(index[on_it] ** 2)))
