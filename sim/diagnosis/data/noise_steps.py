"""How large noise is at which reading: a staircase, since a meter's ranges are one.

Of the readings in order, the staircase of largest likelihood is looked for (dynamic programming over `CELLS` equal
parts); each further step has to pay for itself. Second differences have a Laplace likelihood here.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from compensator.hysteresis.functions import Array

CELLS = 48  # between which a step may lie: a tenth of a decade of four or five
FEWEST_IN_CELL = 8  # readings
MOST_STEPS = 12
OF_ABSOLUTE = 0.7979  # mean absolute value of a normal variable over its deviation
MEDIAN = 0.6745  # the same of the median absolute value
FAR = 6.0  # times the median of a cell: of normal readings one in 20,000, of Student's t with 4 degrees one in 90
SECOND = 6.0**0.5  # deviation of a second difference over that of its readings


def stairs(readings: Array, second: Array, least: float, sure: float) -> tuple[Array, Array]:
    """Edges between steps (steps - 1,), and the deviation on each (steps,). readings: (rows,); second: their second
    differences, nan where there is none, (rows,); least: the deviation at least; sure: log-likelihood that a further
    step has to bring. One step where nothing else is sure."""
    used = np.flatnonzero(np.isfinite(second))
    cells = min(CELLS, used.size // FEWEST_IN_CELL)
    if cells < 2:
        return np.empty(0), np.array([least])
    order = used[np.argsort(readings[used], kind="stable")]
    size = np.abs(second[order] - np.median(second[order]))
    bounds = np.round(np.linspace(0, order.size, cells + 1)).astype(np.int64)
    parts = np.split(size, bounds[1:-1])  # views: an outlier counts as a reading far out
    medians = np.array([max(float(np.median(part)), MEDIAN * SECOND * least) for part in parts])
    for part, most in zip(parts, FAR * maximum_filter1d(medians, 3), strict=True):  # beside a step, of its larger side
        np.minimum(part, most, out=part)
    total = np.concatenate(([0.0], np.cumsum(size)))[bounds]
    floor = OF_ABSOLUTE * SECOND * least
    begin, end = np.triu_indices(cells + 1, 1)
    count = bounds[end] - bounds[begin]
    cost = np.full((cells + 1, cells + 1), np.inf)  # of one step from a bound to another
    cost[begin, end] = count * np.log(np.maximum((total[end] - total[begin]) / count, floor))
    best = np.full((MOST_STEPS + 1, cells + 1), np.inf)
    came = np.zeros((MOST_STEPS + 1, cells + 1), dtype=np.int64)
    best[0, 0] = 0.0
    for steps in range(1, MOST_STEPS + 1):
        values = best[steps - 1][:, None] + cost
        came[steps], best[steps] = np.argmin(values, axis=0), np.min(values, axis=0)
    worth = best[1:, cells] + sure * np.arange(MOST_STEPS)
    steps, last, marks = 1 + int(np.argmin(worth)), cells, []
    while steps:
        last = int(came[steps, last])
        marks.append(last)
        steps -= 1
    starts = marks[::-1]
    y = readings[order]
    edges = np.array([0.5 * (y[bounds[k] - 1] + y[bounds[k]]) for k in starts[1:]])
    steps_of = np.split(size, bounds[starts[1:]])
    deviations = np.array([max(float(np.mean(part)) / (OF_ABSOLUTE * SECOND), least) for part in steps_of])
    return edges, deviations
