"""What wanders beside an instrument's noise, and is in none of a model's equations.

    d(k+1) = keep(k+1) d(k) + w(k+1),   <w^2> = added(k+1),   reading - model = d + white noise

The Kalman filter turns such readings into independent numbers (R. E. Kalman, J. Basic Eng. 82 (1960) 35), as it does
each slope of a model, and the smoother says where d was (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445).
The likelihood of an innovation is that of a normal distribution of its variance (F. Schweppe, IEEE Trans. Inf. Theory
11 (1965) 61).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

Rows = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Wandering:
    """keep, added: of each row since the one before, (rows,): the share of d that is left, and the variance that came,
    in the reading's unit squared; 0 in a row that begins a stretch."""

    keep: Array
    added: Array

    def between(self, rows: Rows) -> tuple[Array, Array]:
        """The same from each of some rows to the next."""
        keep, added = np.empty(rows.size), np.empty(rows.size)
        _between(self.keep, self.added, rows, keep, added)
        return keep, added

    @property
    def deviation(self) -> Array:
        """Of d in each row, as long as no reading tells of it, (rows,)."""
        _, variance = self.between(np.arange(self.keep.size))
        for k in range(1, variance.size):
            variance[k] += self.keep[k] ** 2 * variance[k - 1]
        return np.sqrt(variance)

    def whitening(self, rows: Rows, noise: Array) -> WanderingWhitening:
        """Of readings of some rows. noise: their standard deviation, (rows,)."""
        return WanderingWhitening(*self.between(rows), noise)

    def smoothed(self, residual: Array, rows: Rows, noise: Array) -> Array:
        """d in all rows, from a residual in some of them, (rows,), and the noise's standard deviation there."""
        variance = np.full(self.keep.size, np.inf)
        variance[rows] = noise**2
        whole = np.zeros(self.keep.size)
        whole[rows] = residual
        out = np.empty(self.keep.size)
        _smoothed(whole, self.keep, self.added, variance, out)
        return out


@dataclass(frozen=True, eq=False)
class WanderingWhitening:
    """Innovations over their deviation of readings of d with white noise, in some rows: keep, added and the noise's
    standard deviation, (rows,)."""

    keep: Array
    added: Array
    noise: Array

    def over(self, values: Array) -> Array:
        """(rows,) or (rows, columns)."""
        table = np.ascontiguousarray(values.reshape(values.shape[0], -1), dtype=np.float64)
        out = np.empty(table.shape)
        _innovations(table, self.keep, self.added, self.noise**2, out)
        return out.reshape(values.shape)

    @property
    def stands(self) -> NDArray[np.bool_]:
        """Rows, (rows,), before whose reading d is known to better than the reading says: since the one before it has
        not wandered by more than the noise."""
        deviation = np.empty(self.noise.size)
        _deviations(self.keep, self.added, self.noise**2, deviation)
        return np.asarray(deviation**2 < 2.0 * self.noise**2)

    def log_likelihood(self, residual: Array) -> float:
        """Of a residual in the rows, (rows,), without the constant that is the same for any d and noise."""
        deviation = np.empty(residual.size)
        _deviations(self.keep, self.added, self.noise**2, deviation)
        z = self.over(residual)
        return -0.5 * float(z @ z) - math.fsum(np.log(deviation))


@njit
def _between(keep: Array, added: Array, rows: Rows, of_rows: Array, came: Array) -> None:
    for k in range(rows.size):
        left, variance = 1.0, 0.0
        for row in range(rows[k - 1] + 1 if k else 0, rows[k] + 1):
            left *= keep[row]
            variance = variance * keep[row] ** 2 + added[row]
        of_rows[k], came[k] = left, variance


@njit
def _innovations(values: Array, keep: Array, added: Array, noise: Array, out: Array) -> None:
    d, variance = np.zeros(values.shape[1]), 0.0
    for k in range(values.shape[0]):
        variance = variance * keep[k] ** 2 + added[k]
        gain = variance / (variance + noise[k])
        root = np.sqrt(variance + noise[k])
        for j in range(d.size):
            d[j] *= keep[k]
            new = values[k, j] - d[j]
            out[k, j] = new / root
            d[j] += gain * new
        variance *= 1.0 - gain


@njit
def _deviations(keep: Array, added: Array, noise: Array, out: Array) -> None:
    variance = 0.0
    for k in range(keep.size):
        variance = variance * keep[k] ** 2 + added[k]
        out[k] = np.sqrt(variance + noise[k])
        variance *= noise[k] / (variance + noise[k])


@njit
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
