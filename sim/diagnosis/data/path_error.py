"""What a path that was read off a noisy thermometer is wrong by, and what a film that follows it shows of that.

Behind the readings the temperature's rate walks at random (`sim.inference.readings.temperature_path`). Given
all of them, what the path is off by, T, and its rate are again a Markov chain from row to row,

    x(k+1) = keep(k+1) x(k) + w(k+1),   <w w'> = added(k+1),   x = (T, dT/dt)

with the readings that are still to come taken into both: with C the information that rows from k+1 on have of x(k+1),

    keep = (1 + Q C)^-1 F,   added = (1 + Q C)^-1 Q

of F, Q of the walk alone (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445, read forwards). A film shows s T
besides its ohmmeter's noise, s its own slope there, and a Kalman filter makes that independent numbers, as in
`sim.diagnosis.data.wandering`. And it remembers where the path turned, by as much as that is off, until a larger
reversal wipes it out (I. D. Mayergoyz, Mathematical Models of Hysteresis (Springer 1991), ch. 1): each turn adds a
column to what is shown, known beforehand to a standard deviation of 1. An ohmmeter that is a hundred times as good as
the thermometer then tells of a lag no more than the path does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.diagnosis.data.wandering import Rows


@dataclass(frozen=True, eq=False)
class PathError:
    """keep, added: as above, (rows, 2, 2), K and K/s; in the first row keep is 0. turns: the rows at which the path
    turned; noise_K: standard deviation of the readings' noise."""

    keep: Array
    added: Array
    turns: Rows
    noise_K: float

    @classmethod
    def of(cls, time_s: Array, read: NDArray[np.bool_], density: Array, noise_K: float, turns: Rows) -> PathError:
        """read: rows with a reading that counts, (rows,); density: of the rate's walk over the noise's variance, 1/s^3,
        (rows - 1,); noise_K: of the readings."""
        keep, added = np.zeros((time_s.size, 2, 2)), np.zeros((time_s.size, 2, 2))
        _given_all(np.diff(time_s), read, density * noise_K**2, 1.0 / noise_K**2, keep, added)
        return cls(keep, added, turns, noise_K)

    @property
    def deviation_K(self) -> Array:
        """Of the path, (rows,)."""
        out = np.empty(self.keep.shape[0])
        _deviations(self.keep, self.added, out)
        return out


@dataclass(frozen=True, eq=False)
class SeenPathError:
    """A path's error as the film shows it; per_K: by how much what is shown changes with the path, decades / K,
    (rows,); of_turns: what it shows of each turn that is off by a standard deviation, decades, (rows, turns). rough_K:
    what the path is off by besides, of which neighbouring rows share a part (correlation)."""

    path: PathError
    per_K: Array
    of_turns: Array
    rough_K: float = 0.0
    correlation: float = 0.0

    @property
    def deviation(self) -> Array:
        """Of what is shown, decades, (rows,)."""
        local = self.per_K * np.hypot(self.path.deviation_K, self.rough_K)
        return np.asarray(np.sqrt(local**2 + np.sum(self.of_turns**2, axis=1)), dtype=np.float64)

    def rougher(self, rough_K: float, correlation: float) -> SeenPathError:
        """With a part of this size, all of which hangs together from row to row, by which turns are off as well."""
        own_K = self.path.deviation_K[self.path.turns]
        of_turns = self.of_turns * (np.hypot(own_K, rough_K) / own_K)
        return replace(self, of_turns=of_turns, rough_K=rough_K, correlation=correlation)

    def alike(self, other: SeenPathError, share: float) -> bool:
        """Whether another says about the same: to this share of it, over the record."""
        one, two = self.deviation, other.deviation
        return float(np.linalg.norm(one - two)) < share * float(np.linalg.norm(two))

    def whitening(self, rows: Rows, noise: Array, correlation: float = 0.0, shared: float = 1.0) -> WhiteningOfTurns:
        """Of readings of some rows. noise: their standard deviation, (rows,); correlation, shared: of that noise, as
        `NoiseModel` has them."""
        own = (correlation, shared if correlation > 0.0 else 0.0)
        local = PathWhitening.of(self, rows, noise, own)
        return WhiteningOfTurns.of(local, self.of_turns[rows])


@dataclass(frozen=True, eq=False)
class WhiteningOfTurns:
    """What is local made independent first, and then what turns add: with their columns B = U diag(size) V' there, of a
    covariance 1 + B B', left is (1 + B B')^(-1/2) of it, which takes 1 - taken of each column of U."""

    local: PathWhitening
    along: Array
    taken: Array

    @classmethod
    def of(cls, local: PathWhitening, of_turns: Array) -> WhiteningOfTurns:
        """of_turns: in the rows, (rows, turns)."""
        along, size, _ = np.linalg.svd(local.over(of_turns), full_matrices=False)
        return cls(local, along, 1.0 - 1.0 / np.sqrt(1.0 + size**2))

    def over(self, values: Array) -> Array:
        """(rows,) or (rows, columns)."""
        z = self.local.over(values)
        return np.asarray(z - (self.along * self.taken) @ (self.along.T @ z), dtype=np.float64)

    def log_likelihood(self, residual: Array) -> float:
        """Of a residual in the rows, (rows,), without the constant that is the same for any path and noise."""
        left = self.over(residual)
        return -0.5 * float(left @ left) - math.fsum(np.log(self.local.deviation)) + math.fsum(np.log1p(-self.taken))


@dataclass(frozen=True, eq=False)
class PathWhitening:
    """Innovations over their deviation (decades) in some rows. Of the four parts of the state, the path's error and its
    rate, and what hangs together of the noise and of the rough part, each over its deviation: shows, what a reading has
    of each, and gains, what each learns of an innovation, (rows, 4). keep: of the first two, in all rows; fades: which
    share of the other two is left in the next row."""

    keep: Array
    fades: tuple[float, float]
    rows: Rows
    shows: Array
    gains: Array
    deviation: Array

    @classmethod
    def of(cls, seen: SeenPathError, rows: Rows, noise: Array, own: tuple[float, float]) -> PathWhitening:
        """noise: the ohmmeter's standard deviation in the rows, decades; own: correlation of that noise from each row
        of the record to the next, and the share of it that hangs together."""
        shows = np.zeros((rows.size, 4))
        shows[:, 0] = seen.per_K[rows]
        shows[:, 2], shows[:, 3] = noise * math.sqrt(own[1]), seen.rough_K * seen.per_K[rows]
        gains, deviation, fades = np.empty(shows.shape), np.empty(rows.size), (own[0], seen.correlation)
        _gains(seen.path.keep, seen.path.added, fades, rows, shows, noise**2 * (1.0 - own[1]), gains, deviation)
        return cls(seen.path.keep, fades, rows, shows, gains, deviation)

    def over(self, values: Array) -> Array:
        """(rows,) or (rows, columns)."""
        table = np.ascontiguousarray(values.reshape(values.shape[0], -1), dtype=np.float64)
        out = np.empty(table.shape)
        _innovations(table, self.keep, self.fades, self.rows, self.shows, self.gains, self.deviation, out)
        return out.reshape(values.shape)


@njit
def _given_all(
    steps: Array, read: NDArray[np.bool_], density: Array, information: float, keep: Array, added: Array
) -> None:
    """information: of one reading, 1/K^2; density: K^2/s^3."""
    ctt = ctr = crr = 0.0
    for k in range(read.size - 1, 0, -1):
        if read[k]:
            ctt += information
        dt = steps[k - 1]
        qtt, qtr, qrr = density[k - 1] * dt**3 / 3.0, density[k - 1] * dt**2 / 2.0, density[k - 1] * dt
        # M = (1 + Q C)^-1
        att, atr = 1.0 + qtt * ctt + qtr * ctr, qtt * ctr + qtr * crr
        art, arr = qtr * ctt + qrr * ctr, 1.0 + qtr * ctr + qrr * crr
        determinant = att * arr - atr * art
        mtt, mtr, mrt, mrr = arr / determinant, -atr / determinant, -art / determinant, att / determinant
        keep[k, 0, 0], keep[k, 0, 1] = mtt, mtt * dt + mtr
        keep[k, 1, 0], keep[k, 1, 1] = mrt, mrt * dt + mrr
        added[k, 0, 0], added[k, 1, 1] = mtt * qtt + mtr * qtr, mrt * qtr + mrr * qrr
        added[k, 0, 1] = mtt * qtr + mtr * qrr
        added[k, 1, 0] = added[k, 0, 1]
        # of x(k-1): F' (C M) F
        gtt, gtr, grr = ctt * mtt + ctr * mrt, ctt * mtr + ctr * mrr, ctr * mtr + crr * mrr
        ctt, ctr, crr = gtt, gtt * dt + gtr, gtt * dt * dt + 2.0 * gtr * dt + grr
    if read[0]:
        ctt += information
    determinant = ctt * crr - ctr * ctr
    added[0, 0, 0], added[0, 1, 1] = crr / determinant, ctt / determinant
    added[0, 0, 1] = added[0, 1, 0] = -ctr / determinant


@njit
def _deviations(keep: Array, added: Array, out: Array) -> None:
    ptt = ptr = prr = 0.0
    for k in range(out.size):
        ptt, ptr, prr = _on(keep[k], added[k], ptt, ptr, prr)
        out[k] = math.sqrt(ptt)


@njit
def _on(keep: Array, added: Array, ptt: float, ptr: float, prr: float) -> tuple[float, float, float]:
    """The covariance in the next row."""
    a, b, c, d = keep[0, 0], keep[0, 1], keep[1, 0], keep[1, 1]
    tt = a * a * ptt + 2.0 * a * b * ptr + b * b * prr + added[0, 0]
    tr = a * c * ptt + (a * d + b * c) * ptr + b * d * prr + added[0, 1]
    rr = c * c * ptt + 2.0 * c * d * ptr + d * d * prr + added[1, 1]
    return tt, tr, rr


@njit
def _gains(
    keep: Array,
    added: Array,
    fades: tuple[float, float],
    rows: Rows,
    shows: Array,
    white: Array,
    gains: Array,
    deviation: Array,
) -> None:
    """white: variance of what each reading has besides, (rows,)."""
    p, on = np.zeros((4, 4)), np.zeros((4, 4))
    p[2, 2] = p[3, 3] = 1.0
    on[2, 2], on[3, 3] = fades
    following = 0
    for k in range(rows[-1] + 1 if rows.size else 0):
        on[:2, :2] = keep[k]
        p = on @ p @ on.T
        p[:2, :2] += added[k]
        p[2, 2] += 1.0 - fades[0] ** 2
        p[3, 3] += 1.0 - fades[1] ** 2
        if rows[following] != k:
            continue
        gain = p @ shows[following]
        variance = white[following] + shows[following] @ gain
        p -= np.outer(gain, gain) / variance
        gains[following], deviation[following] = gain / variance, math.sqrt(variance)
        following += 1


@njit
def _innovations(
    values: Array,
    keep: Array,
    fades: tuple[float, float],
    rows: Rows,
    shows: Array,
    gains: Array,
    deviation: Array,
    out: Array,
) -> None:
    columns = values.shape[1]
    x = np.zeros((4, columns))
    following = 0
    for k in range(rows[-1] + 1 if rows.size else 0):
        for j in range(columns):
            t, rate = x[0, j], x[1, j]
            x[0, j] = keep[k, 0, 0] * t + keep[k, 0, 1] * rate
            x[1, j] = keep[k, 1, 0] * t + keep[k, 1, 1] * rate
            x[2, j] *= fades[0]
            x[3, j] *= fades[1]
        if rows[following] != k:
            continue
        s, g = shows[following], gains[following]
        for j in range(columns):
            new = values[following, j] - s[0] * x[0, j] - s[2] * x[2, j] - s[3] * x[3, j]
            out[following, j] = new / deviation[following]
            for i in range(4):
                x[i, j] += g[i] * new
        following += 1
