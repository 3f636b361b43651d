"""Where a plate wanders off for currents that changed between the rows and are in none of them.

Of n commands from row to row one is logged. Where in between a change began is known on average alone (`between_rows`:
a share c = (n - 1) / 2n of it had acted before), with a standard deviation of sqrt(c (1 - c) / 3) of the change. What
that heats, d, is lost again with the plate's own rate g:

    d(k+1) = exp(-g dt) d(k) + w(k),   <w^2> = c (1 - c) / 3 (dT/dt per ampere * change off the line * dt)^2

How large it may be is what the record's own current says of itself, not what a fit is off by. Readings are d and white
noise: the Kalman filter turns them into independent numbers (R. E. Kalman, J. Basic Eng. 82 (1960) 35), as it does each
slope of a model, and the smoother says where the plate was (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965)
1445). What a filter or a heat sink makes of it besides is left out: it is less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.between_rows import off_the_line

QUIET: Final = 1.0  # of the noise: a wandering that adds a sixth to its second differences at most
FEWEST, TURNS = 0.1, 3  # share of the rows that is needed for it; until what is quiet does not change
MAD: Final = 1.4826
Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class UnloggedWalk:
    """keep, added: of each row since the one before, (rows,): the share of d that is left, and the variance that came,
    K^2; 0 in a row that begins a stretch."""

    keep: Array
    added: Array

    @classmethod
    def of(cls, time_s: Array, current_A: Array, early: float, begins: Rows, per_A: Array, rate: float) -> UnloggedWalk:
        """early: c; begins: the rows at which the plate's temperature begins anew; per_A: how fast a current heats, in
        each row, K/(s A); rate: g, 1/s."""
        step = np.diff(time_s)
        size = per_A[:-1] * off_the_line(current_A) * step
        keep, added = np.append(0.0, np.exp(-rate * step)), np.append(0.0, early * (1.0 - early) / 3.0 * size**2)
        keep[begins], added[begins] = 0.0, 0.0
        return cls(keep, added)

    def between(self, rows: Rows) -> tuple[Array, Array]:
        """The same from each of some rows to the next."""
        keep, added = np.empty(rows.size), np.empty(rows.size)
        _between(self.keep, self.added, rows, keep, added)
        return keep, added

    @property
    def deviation_K(self) -> Array:
        """Of d in each row, as long as no reading tells of it, (rows,)."""
        _, variance = self.between(np.arange(self.keep.size))
        for k in range(1, variance.size):
            variance[k] += self.keep[k] ** 2 * variance[k - 1]
        return np.sqrt(variance)

    def noise_K(self, residual: Array, rows: Rows) -> float:
        """Of the thermometer alone: second differences of a residual, (rows,), where next to nothing lies in between.
        Not where the least does: a controller that answers noise changes its current least where there is little."""
        _, added = self.between(rows)
        second, lies = np.abs(np.diff(residual, 2)), added[1:-1] + added[2:]
        if not second.size:
            return 0.0
        found = MAD * float(np.median(second)) / math.sqrt(6.0)
        for _ in range(TURNS):
            quiet = lies < (QUIET * found) ** 2
            if np.sum(quiet) < FEWEST * second.size:
                break
            found = MAD * float(np.median(second[quiet])) / math.sqrt(6.0)
        return found

    def smoothed(self, residual: Array, rows: Rows, noise_K: float) -> Array:
        """d in all rows, K, from a residual in some of them."""
        variance = np.full(self.keep.size, np.inf)
        variance[rows] = noise_K**2
        whole = np.zeros(self.keep.size)
        whole[rows] = residual
        out = np.empty(self.keep.size)
        _smoothed(whole, self.keep, self.added, variance, out)
        return out


@dataclass(frozen=True, eq=False)
class UnloggedWhitening:
    """Innovations over their deviation of readings of d with white noise, in some rows."""

    keep: Array
    added: Array
    noise_K: float

    def over(self, values: Array) -> Array:
        """(rows,) or (rows, columns)."""
        table = np.ascontiguousarray(values.reshape(values.shape[0], -1), dtype=np.float64)
        out = np.empty(table.shape)
        _innovations(table, self.keep, self.added, self.noise_K**2, out)
        return out.reshape(values.shape)


@njit(cache=True)
def _between(keep: Array, added: Array, rows: Rows, of_rows: Array, came: Array) -> None:
    for k in range(rows.size):
        left, variance = 1.0, 0.0
        for row in range(rows[k - 1] + 1 if k else 0, rows[k] + 1):
            left *= keep[row]
            variance = variance * keep[row] ** 2 + added[row]
        of_rows[k], came[k] = left, variance


@njit(cache=True)
def _innovations(values: Array, keep: Array, added: Array, noise: float, out: Array) -> None:
    d, variance = np.zeros(values.shape[1]), 0.0
    for k in range(values.shape[0]):
        variance = variance * keep[k] ** 2 + added[k]
        gain = variance / (variance + noise)
        root = np.sqrt(variance + noise)
        for j in range(d.size):
            d[j] *= keep[k]
            new = values[k, j] - d[j]
            out[k, j] = new / root
            d[j] += gain * new
        variance *= 1.0 - gain


@njit(cache=True)
def _smoothed(values: Array, keep: Array, added: Array, noise: Array, out: Array) -> None:
    size = values.size
    before, after, filtered = np.empty(size), np.empty(size), np.empty(size)
    d, variance = 0.0, 0.0
    for k in range(size):
        d, variance = d * keep[k], variance * keep[k] ** 2 + added[k]
        before[k] = variance
        if np.isfinite(noise[k]):
            gain = variance / (variance + noise[k])
            d += gain * (values[k] - d)
            variance *= 1.0 - gain
        after[k], filtered[k] = variance, d
    out[-1] = filtered[-1]
    for k in range(size - 2, -1, -1):
        back = after[k] * keep[k + 1] / before[k + 1] if before[k + 1] > 0.0 else 0.0
        out[k] = filtered[k] + back * (out[k + 1] - keep[k + 1] * filtered[k])
