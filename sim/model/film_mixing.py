"""How the phases of a film add up to one resistance: logarithms, conductances, resistances, a medium that percolates.

Where a share s of a film is metal and -log10 of its resistance is y, s is a straight function of

    F(y) = q sinh(q v) - p cosh(q v),    v = ln(10) (y - middle),    q^2 = p^2 + percolation

percolation = 0 is a power mean, R^p = (1 - s) R_i^p + s R_m^p (p = -1: domains in parallel; 1: in series; 0: logarithms
add; G. Hardy, J. Littlewood, G. Polya, Inequalities, 1934, ch. 2). q = 1 is an effective medium of d dimensions,
p = 2 / d - 1, whose metal percolates at s = 1 / d: the root of its quadratic equation is exp(asinh(a straight function
of s)) (D. Stroud, Phys. Rev. B 12 (1975) 3368). q = 1 / t is the general one of critical exponent t, where
p = q (2 / d - 1) (D. McLachlan, J. Phys. C 20 (1987) 865). A model D(T) + N, N a sum of operators, is
p = percolation = 0; with other numbers it is D(T) + B(N), B the inverse of F.

B takes the ends of a record's output to themselves, so that it changes the form between them and no scale; beyond the
ends it goes on straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading, Switched
from sim.model.ohmmeter import FARTHEST_DEC

LOGARITHMS = 1e-6  # q times half the range, nepers, below which logarithms add: B bends by half of its square


@dataclass(frozen=True)
class PhaseMixing:
    """B. low_dec, high_dec: ends of the output, which rises with the share that is metal; exponent: p; percolation."""

    low_dec: float
    high_dec: float
    exponent: float
    percolation: float = 0.0

    def mixed(self, u: Array) -> Array:
        """Return the film's output, decades."""
        if self._logarithms:
            return u
        share = (u - self.low_dec) / self._range
        inside = np.clip(share, 0.0, 1.0)
        first, last = self._ends
        f = first + inside * (last - first)
        q = self._q
        root = np.sqrt(f * f + self.percolation)
        less, more = self._q_less_and_more_p
        # the positive root of (q - p) E^2 - 2 f E - (q + p) = 0, E = exp(q v), in the form that cancels nothing
        e = np.where(f >= 0.0, f + root, more) / np.where(f >= 0.0, less, root - f)
        y = self._middle + np.log(e) / (q * math.log(10.0))
        return np.asarray(y + (share - inside) / self._shares_per_dec(y), dtype=np.float64)

    def unmixed(self, y: Array) -> Array:
        """Return the u of which B is y."""
        if self._logarithms:
            return y
        inside = np.clip(y, self.low_dec, self.high_dec)
        first, last = self._ends
        share = (self._f(inside) - first) / (last - first) + (y - inside) * self._shares_per_dec(inside)
        return np.asarray(self.low_dec + self._range * share, dtype=np.float64)

    def slope(self, y: Array) -> Array:
        """Return dB/du where B is y."""
        if self._logarithms:
            return np.ones_like(y)
        return 1.0 / (self._range * self._shares_per_dec(np.clip(y, self.low_dec, self.high_dec)))

    def reading(self) -> Switched:
        """Return B as the first thing that happens to what the operators add up to, on its way to the ohmmeter."""

        def read(par: Array, ohm: Array) -> Array:
            return np.asarray(10.0 ** -np.clip(self.mixed(-np.log10(ohm)), -FARTHEST_DEC, FARTHEST_DEC))

        return Switched(Effect("mixing of the film's phases", "ohmmeter", (), Reading(read), "", ""), np.empty(0))

    @cached_property
    def _q(self) -> float:
        return math.sqrt(self.exponent**2 + self.percolation)

    @property
    def _q_less_and_more_p(self) -> tuple[float, float]:
        """q - p and q + p, of which the smaller is the percolation over the other."""
        larger = self._q + abs(self.exponent)
        smaller = self.percolation / larger
        return (smaller, larger) if self.exponent > 0.0 else (larger, smaller)

    @property
    def _range(self) -> float:
        return self.high_dec - self.low_dec

    @property
    def _middle(self) -> float:
        return 0.5 * (self.low_dec + self.high_dec)

    @property
    def _logarithms(self) -> bool:
        return self._q * 0.5 * math.log(10.0) * self._range < LOGARITHMS

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """F where the share is 0 and 1."""
        first, last = self._f(np.array([self.low_dec, self.high_dec]))
        return float(first), float(last)

    def _f(self, y: Array) -> Array:
        qv = self._q * math.log(10.0) * (y - self._middle)
        less, more = self._q_less_and_more_p
        return np.asarray(0.5 * (less * np.exp(qv) - more * np.exp(-qv)), dtype=np.float64)

    def _shares_per_dec(self, y: Array) -> Array:
        """Return d share / d y."""
        qv = self._q * math.log(10.0) * (y - self._middle)
        less, more = self._q_less_and_more_p
        first, last = self._ends
        slope = 0.5 * math.log(10.0) * self._q * (less * np.exp(qv) + more * np.exp(-qv))
        return np.asarray(slope / (last - first), dtype=np.float64)
