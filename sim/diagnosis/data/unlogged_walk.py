"""Where a plate wanders off for currents that changed between the rows and are in none of them.

Of n commands from row to row one is logged. Where in between a change began is known on average alone (`between_rows`:
a share c = (n - 1) / 2n of it had acted before), with a standard deviation of sqrt(c (1 - c) / 3) of the change. What
that heats, d, is lost again with the plate's own rate g:

    d(k+1) = exp(-g dt) d(k) + w(k),   <w^2> = c (1 - c) / 3 (dT/dt per ampere * change off the line * dt)^2

How large it may be is what the record's own current says of itself, not what a fit is off by. What a filter or a heat
sink makes of it besides is left out: it is less.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.between_rows import off_the_line
from sim.diagnosis.data.likelihood import noise_where_little_lies
from sim.diagnosis.data.wandering import Rows, Wandering


def unlogged_walk(time_s: Array, current_A: Array, early: float, begins: Rows, per_A: Array, rate: float) -> Wandering:
    """d in K. early: c; begins: the rows at which the plate's temperature begins anew; per_A: how fast a current heats,
    in each row, K/(s A); rate: g, 1/s."""
    step = np.diff(time_s)
    size = per_A[:-1] * off_the_line(current_A) * step
    keep, added = np.append(0.0, np.exp(-rate * step)), np.append(0.0, early * (1.0 - early) / 3.0 * size**2)
    keep[begins], added[begins] = 0.0, 0.0
    return Wandering(keep, added)


def noise_beside(walk: Wandering, residual: Array, rows: Rows) -> float:
    """The standard deviation of the thermometer alone, K: second differences of a residual, (rows,), where next to
    nothing lies in between. Not where the least does: a controller that answers noise changes its current least where
    there is little."""
    _, added = walk.between(rows)
    return noise_where_little_lies(added[1:-1] + added[2:], residual)
