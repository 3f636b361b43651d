"""In which sense a film's output goes with its temperature: the one in which its hysteresis lags.

A sum of play operators with positive weights rises with temperature, and lags: it is lower while heating than while
cooling. Mostly the output's changes alone show the sense. Where a background goes against the loop (a diamagnetic
substrate under a magnetization) the lag does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array

CLEAR: Final = 0.8  # of all changes, that go one way: no background goes against the loop
FALLING: Final = -0.2  # below it an output without a loop falls: noise alone moves the share by less than 0.1
LAG: Final = 0.02  # of the output's span, mean of cooling less heating: less may be a thermometer's lag
STEP: Final = 0.02  # of the range: some fifty steps in a sweep, each far above a thermometer's noise
MOST_ROWS: Final = 20_000  # of a record that are looked at: a hundred to a step of a loop
Records = Sequence[tuple[Array, Array]]


def output_falls(records: Records) -> bool:
    """Return True if the output falls as temperature rises.

    records: (degC, output) of each, shape (rows,), in the order of time; rows with a nan are passed over.
    """
    steps = [_steps(*record) for record in records]
    share, lag = _share(steps), _lag(steps)
    if abs(share) < CLEAR and abs(lag) > LAG:
        return lag < 0.0
    return share < FALLING


def output_sense(records: Records) -> float:
    """Return the share of all changes of the output that go with the temperature, from -1 to 1; 0 of a constant."""
    return _share([_steps(*record) for record in records])


def _share(steps: list[tuple[Array, Array]]) -> float:
    together = sum(float(np.sum(np.sign(np.diff(v)) * np.diff(y))) for v, y in steps)
    changes = sum(float(np.sum(np.abs(np.diff(y)))) for _, y in steps)
    return together / changes if changes > 0.0 else 0.0


def _lag(steps: list[tuple[Array, Array]]) -> float:
    """Return by how much the output is higher while cooling than while heating, mean over the temperatures seen both
    ways, of its span; 0 where there are none."""
    if not steps:
        return 0.0
    middle = np.concatenate([0.5 * (v[1:] + v[:-1]) for v, _ in steps])
    output = np.concatenate([0.5 * (y[1:] + y[:-1]) for _, y in steps])
    heats = np.concatenate([np.diff(v) > 0.0 for v, _ in steps])
    if not middle.size or np.ptp(output) == 0.0:
        return 0.0
    edges = np.linspace(float(np.min(middle)), float(np.max(middle)), round(1.0 / STEP) + 1)
    place = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, edges.size - 2)
    counts = [np.bincount(place[way], minlength=edges.size - 1) for way in (heats, ~heats)]
    sums = [np.bincount(place[way], weights=output[way], minlength=edges.size - 1) for way in (heats, ~heats)]
    both = (counts[0] > 0) & (counts[1] > 0)
    if not np.any(both):
        return 0.0
    return float(np.mean(sums[1][both] / counts[1][both] - sums[0][both] / counts[0][both])) / float(np.ptp(output))


def _steps(temperature: Array, output: Array) -> tuple[Array, Array]:
    """Return means of both over the rows of each step, within which the temperature moves by less than `STEP` of its
    range."""
    rows = np.flatnonzero(np.isfinite(temperature) & np.isfinite(output))
    rows = rows[:: max(1, rows.size // MOST_ROWS)]
    v, y = temperature[rows], output[rows]
    if not v.size or np.ptp(v) == 0.0:
        return np.empty(0), np.empty(0)
    step, first = STEP * float(np.ptp(v)), [0]
    for row, value in enumerate(v.tolist()):
        if abs(value - v[first[-1]]) >= step:
            first.append(row)
    count = np.diff([*first, v.size])
    return np.add.reduceat(v, first) / count, np.add.reduceat(y, first) / count
