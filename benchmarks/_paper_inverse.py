"""The paper's inverse as it is printed, with a memory of its own: eqs (14) to (18) and (20).

A second opinion on `compensator.inverse.iteration`: written from the paper's equations, with the inverse's plays F_s[y]
as the state, driven by y alone. The state that belongs to a film's memory w is z_i = w_i (p_0 + .. + p_i) + sum_(j>i)
p_j w_j. Two outputs closer than EQUAL are "y(t) = y(t-)", eq (14)'s third line; without that, rounding decides the
branch.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks._paper_models import Array
from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import envelope_inverse

EQUAL = 1e-9  # share of the weights' sum


class PaperInverse:
    """Psi^-1 with its state, and the fixed point v = Psi^-1[u - D(v)]."""

    def __init__(self, film: FilmModel, memory: Memory) -> None:
        p, r, w = film.weights, film.radii, memory.plays
        if r[0] != 0.0 or not p[0] > 0.0:
            raise ValueError("p(r_0) is the weight of radius 0, and divides: there is none")
        total = np.cumsum(p)
        self.radii = np.array([float(np.sum(p[:i] * (r[i] - r[:i]))) for i in range(r.size)])  # eq (16)
        self.weights = np.concatenate(([1.0 / p[0]], -p[1:] / (total[1:] * total[:-1])))  # eqs (17), (18)
        self.rows = film.envelopes[0]
        self.equal = EQUAL * float(total[-1])
        self.plays = np.array([w[i] * total[i] + float(p[i + 1 :] @ w[i + 1 :]) for i in range(r.size)])
        self.y, self.v = float(p @ w), memory.input_degC

    def moved(self, y: float) -> Array:
        """The plays F_s[y] after y."""
        if y > self.y:
            return np.maximum(y - self.radii, self.plays)
        return np.minimum(y + self.radii, self.plays)

    def at(self, y: float) -> float:
        """Psi^-1[y], eq (14); the state stays."""
        if abs(y - self.y) <= self.equal:
            return self.v
        gamma = self.weights[0] * y + float(self.weights[1:] @ self.moved(y)[1:])
        code, a, b = self.rows[:3] if y > self.y else self.rows[3:]
        return float(envelope_inverse(code, a, b, gamma))

    def move(self, y: float, v: float) -> None:
        """Accept v as the temperature for y."""
        if abs(y - self.y) > self.equal:
            self.plays, self.y = self.moved(y), y
        self.v = v

    def iterate(
        self, u: float, memoryless: Callable[[float], float], sigma: float, most: int = 500
    ) -> tuple[bool, float, int]:
        """(converged, v, iterations): v_n = Psi^-1[u - D(v_(n-1))] until |v_n - v_(n-1)| < sigma, eq (20)."""
        v = self.v
        for n in range(1, most + 1):
            following = self.at(u - memoryless(v))
            if not math.isfinite(following):
                return False, v, n
            if abs(following - v) < sigma:
                return True, following, n
            v = following
        return False, v, most
