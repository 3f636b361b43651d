"""Whether an output rises or falls with temperature, however wide its hysteresis.

The share of all its changes that go with the temperature: sum of sign(dv) dy over sum of |dy|, both taken from step
to step of the temperature. Play operators move with the temperature only, so that it is 1 for a film of this class;
its correlation with temperature may be small, or have the other sign, where the loop is wider than the range.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array

FALLING: Final = -0.2  # below it an output falls: noise alone moves the share by less than 0.1
STEP: Final = 0.02  # of the range: some fifty steps in a sweep, each far above a thermometer's noise
MOST_ROWS: Final = 20_000  # of a record that are looked at: a hundred to a step of a loop


def output_sense(records: Sequence[tuple[Array, Array]]) -> float:
    """From -1 (falls as temperature rises) to 1 (rises); 0 where nothing changes.

    records: (degC, output) of each, shape (rows,), in the order of time; rows with a nan are passed over.
    """
    together, changes = 0.0, 0.0
    for temperature, output in records:
        rows = np.flatnonzero(np.isfinite(temperature) & np.isfinite(output))
        rows = rows[:: max(1, rows.size // MOST_ROWS)]
        v, y = _means(temperature[rows], output[rows])
        dv, dy = np.diff(v), np.diff(y)
        together += float(np.sum(np.sign(dv) * dy))
        changes += float(np.sum(np.abs(dy)))
    return together / changes if changes > 0.0 else 0.0


def output_falls(records: Sequence[tuple[Array, Array]]) -> bool:
    """Whether the output falls as temperature rises; of the same records as `output_sense`."""
    return output_sense(records) < FALLING


def _means(v: Array, y: Array) -> tuple[Array, Array]:
    """Means of both over the rows of each step, within which the temperature moves by less than `STEP` of its range."""
    if not v.size or np.ptp(v) == 0.0:
        return np.empty(0), np.empty(0)
    step, first = STEP * float(np.ptp(v)), [0]
    for row, value in enumerate(v.tolist()):
        if abs(value - v[first[-1]]) >= step:
            first.append(row)
    rows = np.diff([*first, v.size])
    return np.add.reduceat(v, first) / rows, np.add.reduceat(y, first) / rows
