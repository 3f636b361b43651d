"""The film's linear problem at given envelopes and effects: its columns, its products, its solution."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import Whitens
from sim.diagnosis.data.record import Rows
from sim.diagnosis.fit.preisach_density import Relays

ROUNDING = 1e-10  # of a diagonal: columns times rows times 2**-53 of 300 columns of 3,000 rows, the products' own error
MORE_ROUNDING = 1e-8  # of columns so alike that this is not enough


def _factored(normal: Array) -> tuple[Array, bool]:
    """The Cholesky factor. Relays that stand in the same rows have columns so alike that the products' rounding can be
    more than their prior: the diagonal is then raised by as much, which no fit can tell (N. Higham, Accuracy and
    Stability of Numerical Algorithms, 2nd ed., theorem 10.7). Raises LinAlgError where nothing is finite."""
    for share in (0.0, ROUNDING):
        try:
            return _cholesky(normal, share)
        except LinAlgError:
            continue
    return _cholesky(normal, MORE_ROUNDING)


def _cholesky(normal: Array, share: float) -> tuple[Array, bool]:
    """With a share of the diagonal added to it."""
    raised = normal + np.diag(share * np.diag(normal)) if share else normal
    factor, lower = cho_factor(raised, lower=True, check_finite=False)
    return factor, bool(lower)


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """What is shown in the rows is offset + at_rows @ c[:own] + relays @ c[own:].

    at_rows: columns of film and filters in every row; own: the same in the fitted rows, over the noise; film: the
    columns of the film's own output, in every row; relays: as they are shown; gram, right: products of all columns in
    the fitted rows, over the noise; wanted: what they are to add up to there, not over the noise; range_of: the outputs
    by which the ohmmeter chose its range in every row, None where it has one.
    """

    at_rows: Array
    offset: Array
    own: Array
    film: Array
    relays: Relays
    gram: Array
    right: Array
    wanted: Array
    fitted: Rows
    noise: Whitens
    range_of: Array | None

    @classmethod
    def of(
        cls,
        at_rows: Array,
        offset: Array,
        film: Array,
        relays: Relays,
        output: Array,
        fitted: Rows,
        noise: Whitens,
        range_of: Array | None,
    ) -> LinearProblem:
        """With its products."""
        own, wanted = noise.over(np.take(at_rows, fitted, axis=0)), output[fitted] - offset[fitted]
        both, count = np.column_stack((own, noise.over(wanted))), own.shape[1]
        of_own, across = both.T @ both, both.T @ relays.fitted  # the relays' many columns are read once
        gram = np.empty((count + relays.count, count + relays.count))
        gram[:count, :count], gram[count:, count:] = of_own[:-1, :-1], relays.gram
        gram[:count, count:], gram[count:, :count] = across[:-1], across[:-1].T
        right = np.concatenate((of_own[:-1, -1], across[-1]))
        return cls(at_rows, offset, own, film, relays, gram, right, wanted, fitted, noise, range_of)

    def shifted(self, offset: Array, output: Array, range_of: Array | None) -> LinearProblem:
        """The same columns beside another offset."""
        wanted = output[self.fitted] - offset[self.fitted]
        target = self.noise.over(wanted)
        right = np.concatenate((self.own.T @ target, self.relays.fitted.T @ target))
        return replace(self, offset=offset, right=right, wanted=wanted, range_of=range_of)

    def solved(self, x: Array, prior: Array) -> Point:
        """The best coefficients under a prior: the precision of each."""
        normal = self.gram.copy()
        normal[np.diag_indices_from(normal)] += prior
        factor = _factored(normal)
        c = cho_solve(factor, self.right, check_finite=False)
        linear = self.at_rows @ c[: self.own.shape[1]]
        if self.relays.count:
            linear += self.relays.shown(c[self.own.shape[1] :])
        residual = self.noise.over(self.wanted - linear[self.fitted])
        cost = 0.5 * float(residual @ residual) + 0.5 * float(prior @ c**2)
        return Point(x, self, prior, c, linear + self.offset, cost if math.isfinite(cost) else math.inf, factor)


@dataclass(frozen=True, eq=False)
class Point:
    """Everything at one x: coefficients, what is shown in all rows, the cost."""

    x: Array
    problem: LinearProblem
    prior: Array
    coefficients: Array
    shown: Array
    cost: float
    factor: tuple[Array, bool]

    @property
    def unmixed(self) -> Array:
        """What the film's columns add up to, before its phases mix, in all rows."""
        film, relays, c = self.problem.film, self.problem.relays, self.coefficients
        return np.asarray(film @ c[: film.shape[1]] + relays.film @ c[self.problem.own.shape[1] :], dtype=np.float64)

    @property
    def columns(self) -> Array:
        """All columns in the fitted rows, over the noise."""
        return np.concatenate((self.problem.own, self.problem.relays.fitted), axis=1)

    @property
    def room(self) -> float:
        """What the marginal log-likelihood loses by the room that the coefficients leave in their prior's."""
        return float(np.sum(np.log(np.diag(self.factor[0])))) - 0.5 * float(np.sum(np.log(self.prior)))

    @property
    def evidence(self) -> float:
        """The marginal log-likelihood, up to a constant of the record."""
        return -self.cost - self.room

    def along(self, columns: Array) -> Array:
        """The columns' products with others that are over the noise, too."""
        problem = self.problem
        return np.concatenate((problem.own.T @ columns, problem.relays.fitted.T @ columns))

    def nearest(self, along: Array) -> Array:
        """The coefficients whose columns come nearest to others, under the prior. along: the products with these."""
        return np.asarray(cho_solve(self.factor, along, check_finite=False), dtype=np.float64)

    def off(self, columns: Array) -> Array:
        """What is left of others, in units of the noise, once the coefficients may follow."""
        c = self.nearest(self.along(columns))
        own, relays = self.problem.own, self.problem.relays
        reach = own @ c[: own.shape[1]]
        if relays.count:
            reach += relays.fitted @ c[own.shape[1] :]
        return np.asarray(columns - reach, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Projected:
    """The normal equations in x about a point, its coefficients eliminated.

    A point that was found linear about another guess has coefficients that are not the best ones yet. They cost next to
    nothing (1e-4 of log-likelihood), but as a phase's mixing moves all columns, the cost's slope without what is left
    was wrong by 700 per unit. along: products of the point's columns with how what is shown changes with x; to_go: how
    far its coefficients are from the best; normal, gradient: (unknowns, unknowns) and (unknowns,).
    """

    point: Point
    along: Array
    to_go: Array
    normal: Array
    gradient: Array

    @classmethod
    def about(cls, point: Point, slopes: Array, residual: Array) -> Projected:
        """slopes: of what is shown in the fitted rows with x, (rows, unknowns); residual: (rows,); over the noise."""
        along = point.along(slopes)
        to_go = point.nearest(point.along(residual) - point.prior * point.coefficients)
        normal = slopes.T @ slopes - along.T @ point.nearest(along)
        return cls(point, along, to_go, normal, slopes.T @ residual - along.T @ to_go)

    def coefficients(self, move: Array) -> Array:
        """The best ones once x has moved by so much, as far as they are linear in x. A guess that does not follow was
        up to 1e5 of log-likelihood off, and took five rounds in place of two to come near."""
        return self.point.coefficients + self.to_go - self.point.nearest(self.along @ move)
