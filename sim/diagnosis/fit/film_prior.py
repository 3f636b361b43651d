"""How large the film's coefficients may be before a record is looked at: normal priors, whose widths it decides.

The widths are those of the largest marginal likelihood (D. MacKay, Neural Computation 4 (1992) 415): a film of the
class needs no relays, and so the width of theirs goes to nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import FilmBasis
from sim.diagnosis.fit.film_point import LinearProblem, Point
from sim.model.film_columns import SIMPLE

CONSTANT_DEC = 30.0  # the constant's spread: any resistance there is
CURVE_DEC = 1.0  # of D's slope over the range, and the most of what bends it
LEAST_CURVE_DEC = 1e-4
BEHIND_DEC = 0.1  # of how far a filter is behind at the first row
WEIGHT_DEC = (1e-3, 3.0)  # least and most, of the play operators' weights
RELAY_DEC = (1e-6, 1.0)  # the same of the relays
MOST_OF_RELAYS_DEC = 10.0  # the same where they are all of the film
FIRST_RELAY_DEC = 0.03
NOTHING_DEC2 = 1e-14  # sum of squares of the relays' coefficients that says nothing of their width


@dataclass(frozen=True)
class PriorWidths:
    """Standard deviations, in decades: of the operators' weights, of the relays (0: there are none), of what D has of
    degree 2 and 3, and of what else it has. most_weight_dec, most_relay_dec: how large the first two may become."""

    weight_dec: float = 0.3
    relay_dec: float = 0.0
    bend_dec: float = CURVE_DEC
    wave_dec: float = CURVE_DEC
    most_weight_dec: float = WEIGHT_DEC[1]
    most_relay_dec: float = RELAY_DEC[1]

    @classmethod
    def of_relays(cls, plays_dec: float, basis: FilmBasis) -> PriorWidths:
        """Of a film that is one of relays, whose play operators come to so many decades at most."""
        weight = plays_dec / math.sqrt(basis.fractions.size)
        return cls(weight, 1.0, most_weight_dec=weight, most_relay_dec=MOST_OF_RELAYS_DEC)

    @property
    def is_of_relays(self) -> bool:
        """Whether there is no Prandtl-Ishlinskii film to begin with."""
        return self.most_weight_dec < WEIGHT_DEC[1]

    @property
    def first_relay_dec(self) -> float:
        """Where a search for the relays' width begins."""
        return 1.0 if self.is_of_relays else FIRST_RELAY_DEC

    def precision(self, basis: FilmBasis, problem: LinearProblem) -> Array:
        """Of each coefficient: free ones, operators, how far filters are behind, relays."""
        return np.concatenate(
            (
                np.array([CONSTANT_DEC**-2]),
                self._of_the_curve(basis) ** -2,
                np.full(basis.fractions.size, self.weight_dec**-2),
                np.full(problem.own.shape[1] - basis.columns, BEHIND_DEC**-2),
                np.full(problem.relays.count, max(self.relay_dec, 1e-9) ** -2),  # a width that can be divided by
            )
        )

    def _of_the_curve(self, basis: FilmBasis) -> Array:
        widths = np.full(basis.free - 1, self.wave_dec)
        widths[:SIMPLE] = self.bend_dec
        widths[:1] = CURVE_DEC
        return widths

    def asked_for(self, basis: FilmBasis, point: Point) -> PriorWidths:
        """The widths that a solution's coefficients ask for: one step of the fixed point."""
        variance = np.diag(cho_solve(point.factor, np.eye(point.coefficients.size), check_finite=False))
        square = point.coefficients**2 + variance
        weight = math.sqrt(float(np.mean(square[basis.free : basis.columns])))
        bend = wave = CURVE_DEC
        if basis.free > 1:
            bend, wave = (
                min(max(math.sqrt(float(np.mean(square[part]))), LEAST_CURVE_DEC), CURVE_DEC)
                for part in (slice(2, 1 + SIMPLE), slice(1 + SIMPLE, basis.free))
            )
        relay = self._of_the_relays(point, variance)
        weight = min(max(weight, WEIGHT_DEC[0]), self.most_weight_dec)
        return replace(self, weight_dec=weight, relay_dec=relay, bend_dec=bend, wave_dec=wave)

    def _of_the_relays(self, point: Point, variance: Array) -> float:
        count, c = point.problem.relays.count, point.coefficients
        if not count:
            return self.relay_dec
        known = count - float(np.sum(variance[c.size - count :])) / self.relay_dec**2
        square = float(np.sum(c[c.size - count :] ** 2))
        # known: of the coefficients, as many as the record tells, and > 0
        relay = math.sqrt(square / max(known, 1e-3)) if square >= NOTHING_DEC2 else self.relay_dec
        return min(max(relay, RELAY_DEC[0]), self.most_relay_dec)
