"""The noise of an instrument: how large at which reading, how it hangs together from row to row, how heavy its tails.

    x_k = (reading - shown)_k / deviation(reading_k),     u_k = x_k - c x_{k-1} + theta u_{k-1}

A real meter's noise goes with its range and its resistance, neighbouring readings share some of it, and some readings
are further off than a normal distribution has them. Everything that a likelihood needs of this is `Whitening.over`: it
turns what a model is off by (and by as much any slope of the model) into numbers u that are independent and of
variance 1, those far out weighed down as Student's t has it (K. Lange, R. Little, J. Taylor, J. Am. Stat. Assoc. 84
(1989) 881: the weight of a reading is (nu + 1) / (nu + u^2)). Half the sum of their squares is minus the logarithm of
the likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_colour import ColouredWhitening, NoiseColour
from sim.diagnosis.data.path_error import SeenPathError
from sim.diagnosis.data.wandering import Rows, Wandering

GROUPS: Final = 30  # of readings alike, for another record's
SAME_PATH: Final = 0.2  # of what the film shows of its path's error: what it is told by, slopes, is not known better


class Whitens(Protocol):
    """What turns values of some rows into independent ones."""

    def over(self, values: Array) -> Array: ...


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """deviations: in the reading's unit, (steps,), each from its edge on (steps - 1,) of the readings; correlation: of
    neighbouring rows, of that part of the variance (`shared`: which share) that goes on from row to row, as rounding
    does not; weights: of each row of the record in the likelihood, (rows,), None: 1, and the degrees of the Student's t
    that they come from; floor: what each row is uncertain by besides, (rows,), None: nothing; level: root mean square
    of the noise over the record's readings; wandering: what goes on from row to row beside
    white noise, and no model tells: where the plate may have gone, how the film's domains stand. wanders: readings,
    rising, and the deviation of it at these, for rows of another record; None: nothing, or none is asked for. colour:
    in place of the correlation, where that does not do; None: it does. path: what the film shows of what the path is
    off by that drives it; None: that path is known, or the floor stands for it.
    """

    level: float
    edges: Array
    deviations: Array
    correlation: float = 0.0
    shared: float = 1.0
    weights: Array | None = None
    degrees: float = math.inf
    floor: Array | None = None
    wandering: Wandering | None = None
    wanders: tuple[Array, Array] | None = None
    colour: NoiseColour | None = None
    path: SeenPathError | None = None

    @classmethod
    def white(cls, deviation: float) -> NoiseModel:
        """The same everywhere, and independent."""
        return cls(deviation, np.empty(0), np.array([deviation]))

    @property
    def plain(self) -> bool:
        """Whether it is white and the same everywhere."""
        same = not self.edges.size and self.weights is None
        wanders = self.wandering is not None or self.path is not None
        return same and self.correlation == 0.0 and not wanders and self.colour is None

    @property
    def as_correlated(self) -> float:
        """The correlation of neighbouring rows by which a mean over very many would be as uncertain as it is."""
        if self.colour is None:
            return self.correlation
        return (self.colour.rows_alike - 1.0) / (self.colour.rows_alike + 1.0)

    def at(self, readings: Array, rows: Rows | None = None) -> Array:
        """The standard deviation at these readings. rows: the record's that they are in, None: they are another's."""
        own = self.deviations[np.searchsorted(self.edges, readings, side="right")]
        return own if self.floor is None or rows is None else np.hypot(own, self.floor[rows])

    def rms(self, readings: Array, rows: Rows | None = None) -> float:
        """Root mean square of the instrument's noise at these readings, tails and all."""
        if self.plain:
            return self.level
        return root_mean_square(self.with_tails(readings, rows))

    def with_tails(self, readings: Array, rows: Rows | None = None) -> Array:
        """The standard deviation at these readings, tails and all."""
        tails = 1.0 if math.isinf(self.degrees) else self.degrees / (self.degrees - 2.0)
        return math.sqrt(tails) * self.at(readings, rows)

    def marginal(self, readings: Array, rows: Rows | None = None) -> Array:
        """The same with what wanders, as long as no reading tells of it."""
        own = self.with_tails(readings, rows)
        if self.path is not None and rows is not None:
            return np.hypot(own, self.path.deviation[rows])
        if self.wandering is not None and rows is not None:
            return np.hypot(own, self.wandering.deviation[rows])
        return own if self.wanders is None else np.hypot(own, np.interp(readings, *self.wanders))

    def with_floor(self, floor: Array) -> NoiseModel:
        """The same where each row is uncertain by so much besides, (rows of the record,)."""
        return self if self.plain or not np.any(floor) else replace(self, floor=floor)

    def alike(self, other: NoiseModel, readings: Array, share: float) -> bool:
        """Whether another model weighs these readings about the same: to this share of a deviation."""
        if (self.weights is None) != (other.weights is None) or (self.colour is None) != (other.colour is None):
            return False
        if self.path is not None and (other.path is None or not self.path.alike(other.path, SAME_PATH)):
            return False
        if self.colour is not None and other.colour is not None and not self.colour.alike(other.colour, share):
            return False
        apart = np.log(self.at(readings) / other.at(readings))
        return root_mean_square(apart) < share and abs(self.correlation - other.correlation) < share

    def on(self, rows: Rows, readings: Array, begins: NDArray[np.bool_] | None = None) -> Whitens:
        """For some rows of the record. readings: of these rows; begins: which of them hang together with none before,
        (rows,)."""
        if self.plain:
            return Whitening(1.0 / np.full(rows.size, self.level))
        if self.wandering is not None:
            return self.wandering.whitening(rows, self.at(readings, rows))
        if self.path is not None:
            return self.path.whitening(rows, self._weighed_down(readings, rows), self.correlation, self.shared)
        scale = 1.0 / self.at(readings, rows)
        root = np.ones(rows.size) if self.weights is None else np.sqrt(self.weights[rows])
        follows = np.diff(rows, prepend=rows[:1] - 2) == 1
        if begins is not None:
            follows &= ~begins
        if self.colour is not None:
            return ColouredWhitening(scale, self.colour, np.flatnonzero(~follows), root)
        if self.correlation == 0.0:
            return Whitening(root * scale)
        theta, size = self._innovations()
        before = np.zeros(rows.size)
        before[1:] = np.where(follows[1:], self.correlation * scale[:-1], 0.0)
        return Whitening(scale, before, theta, np.flatnonzero(~follows), root / np.where(follows, size, 1.0))

    def _weighed_down(self, readings: Array, rows: Rows) -> Array:
        """The standard deviation at these readings, larger where a reading counts for less."""
        own = self.at(readings, rows)
        return own if self.weights is None else own / np.sqrt(self.weights[rows])

    def _innovations(self) -> tuple[float, float]:
        """theta and the deviation of u in u_k = x_k - c x_{k-1} + theta u_{k-1}: an autoregression and a white part are
        one with a moving average (C. Granger, M. Morris, J. R. Statist. Soc. A 139 (1976) 246)."""
        c, white = self.correlation, 1.0 - self.shared
        gamma_0, gamma_1 = self.shared * (1.0 - c * c) + white * (1.0 + c * c), c * white
        if white == 0.0:
            return 0.0, math.sqrt(gamma_0)
        half = 0.5 * gamma_0 / gamma_1
        theta = half - math.sqrt(half * half - 1.0)
        return theta, math.sqrt(gamma_1 / theta)


@dataclass(frozen=True, eq=False)
class Whitening:
    """weight_k u_k over some rows, u_k = own_k v_k - before_k v_{k-1} + theta u_{k-1}; before: None where rows are
    independent, and then there are no weights; begins: rows that hang together with none before."""

    own: Array
    before: Array | None = None
    theta: float = 0.0
    begins: Rows | None = None
    weight: Array | None = None

    def over(self, values: Array) -> Array:
        """Values of the rows, (rows,) or (rows, columns), over the noise."""
        if self.before is None or self.weight is None or self.begins is None:
            return np.asarray(values * (self.own if values.ndim == 1 else self.own[:, None]), dtype=np.float64)
        table = np.ascontiguousarray(values.reshape(values.shape[0], -1), dtype=np.float64)
        out = np.empty(table.shape)
        _innovations(table, self.own, self.before, self.theta, self.begins, self.weight, out)
        return out.reshape(values.shape)


@njit
def _innovations(
    values: Array, own: Array, before: Array, theta: float, begins: Rows, weight: Array, out: Array
) -> None:
    u = np.empty(values.shape[1])
    following = 0
    for k in range(values.shape[0]):
        if following < begins.size and begins[following] == k:
            following += 1
            u[:] = 0.0
        if k == 0:
            for j in range(u.size):
                u[j] = own[k] * values[k, j]
        else:
            for j in range(u.size):
                u[j] = own[k] * values[k, j] - before[k] * values[k - 1, j] + theta * u[j]
        for j in range(u.size):
            out[k, j] = weight[k] * u[j]


def by_reading(readings: Array, deviation: Array) -> tuple[Array, Array]:
    """Readings, rising, and the root mean square of a deviation at these, as another record has it there. readings,
    deviation: (rows,)."""
    groups = np.array_split(np.argsort(readings), min(GROUPS, readings.size))
    at = np.array([float(np.mean(readings[g])) for g in groups])
    return at, np.array([root_mean_square(deviation[g]) for g in groups])


def root_mean_square(values: Array) -> float:
    """0 of none."""
    return math.sqrt(float(np.mean(values**2))) if values.size else 0.0
