"""The paper's own inverse, to compare with: the analytic inverse (14)-(18) and the fixed-point iteration (20).

    Psi^-1[y]   = gamma_R^-1(Pi^-1[y]) if y rises, gamma_L^-1(Pi^-1[y]) if it falls                           (14)
    Pi^-1[y]    = y / p_0 + sum_i q_i F_(s_i)[y]                                                              (15)
    s_i = p_0 r_i + sum_(j<i) p_j (r_i - r_j),   q_i = -p_i / ((p_0 + .. + p_i) (p_0 + .. + p_(i-1)))   (16)-(18)
    v_n = Psi^-1[u - D(v_(n-1))]  until  |v_n - v_(n-1)| < sigma                                              (20)

The inverse plays' memory follows from the model's: z_i = w_i sum_(j<=i) p_j + sum_(j>i) p_j w_j (Krejci and Kuhnen,
IEE Proc. Control Theory Appl. 148 (2001) 185). Where it holds and where it does not:

- radii must start at 0 with a positive weight, else 1 / p(r_0) is undefined (section 4.2's radii start at 1/30);
- eqs (12), (14) are eq (6) and its inverse only where gamma_R = gamma_L: elsewhere gamma jumps at a reversal and
  moves Pi's plays. With the memory of eq (6), as here, and not one of its own, (14) is right elsewhere, too;
- (21), (26), (27) need |dD/dv|, and after a reversal with gamma_R < gamma_L all operators stand still at once, where
  the iteration never converges, however small D is;
- |v_n - v_(n-1)| < sigma bounds the error by sigma q / (1 - q), q the contraction factor, not by sigma.

`compensator.inverse.inverse` has none of these limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import Array, envelope_inverse, memoryless


@njit
def _inverse_parameters(radii: Array, weights: Array) -> tuple[Array, Array]:
    """Return radii s_i and weights q_i of the inverse, eqs (16)-(18); index 0 holds radius 0 and 1 / p_0."""
    inverse_radii, inverse_weights = np.zeros(radii.size), np.zeros(radii.size)
    inverse_weights[0] = 1.0 / weights[0]
    before = weights[0]
    for i in range(1, radii.size):
        inverse_radii[i] = weights[0] * radii[i]
        for j in range(1, i):
            inverse_radii[i] += weights[j] * (radii[i] - radii[j])
        inverse_weights[i] = -weights[i] / ((before + weights[i]) * before)
        before += weights[i]
    return inverse_radii, inverse_weights


@njit
def _analytic(
    y: float, envelope_row: Array, weights: Array, memory: Array, inverse_radii: Array, inverse_weights: Array
) -> float:
    """Return Psi^-1 at y from a memory, eqs (14), (15); nan where y leaves the envelope's range."""
    present = 0.0
    for j in range(weights.size):
        present += weights[j] * memory[j]
    if y == present:
        return math.nan
    rising = y > present
    gamma = inverse_weights[0] * y
    below, above = weights[0], present - weights[0] * memory[0]
    for i in range(1, weights.size):
        below += weights[i]
        above -= weights[i] * memory[i]
        z = below * memory[i] + above
        z = max(y - inverse_radii[i], z) if rising else min(y + inverse_radii[i], z)
        gamma += inverse_weights[i] * z
    first = 0 if rising else 3
    return envelope_inverse(envelope_row[first], envelope_row[first + 1], envelope_row[first + 2], gamma)


@njit
def _iterate(
    u: float,
    v: float,
    envelope_row: Array,
    radii: Array,
    weights: Array,
    code: int,
    par: Array,
    memory: Array,
    sigma: float,
    most: int,
) -> tuple[bool, float, int]:
    """Return (converged, v, iterations) of eq (20) from the present temperature."""
    inverse_radii, inverse_weights = _inverse_parameters(radii, weights)
    rest = v
    for n in range(1, most + 1):
        v_next = _analytic(
            u - memoryless(code, par, v)[0], envelope_row, weights, memory, inverse_radii, inverse_weights
        )
        if math.isnan(v_next):
            v_next = rest
        if not math.isfinite(v_next):
            return False, v, n
        if abs(v_next - v) < sigma:
            return True, v_next, n
        v = v_next
    return False, v, most


@dataclass(frozen=True)
class IterationResult:
    """Result of the fixed-point iteration: temperature (degC), iterations used, and whether it converged."""

    temperature_degC: float
    iterations: int
    converged: bool


def applicable(model: FilmModel) -> bool:
    """Return True if eqs (15)-(18) are defined: common envelopes, and a radius 0 with a positive weight first."""
    return (
        not isinstance(model.rising, tuple)
        and float(model.radii[0]) == 0.0
        and float(model.weights[0]) > 0.0
        and bool(np.all(np.diff(model.radii) >= 0.0))
    )


def iterate(
    model: FilmModel, target: float, memory: Memory, sigma: float = 1e-4, most_iterations: int = 1000
) -> IterationResult:
    """Solve by the paper's inverse: v_n = Psi^-1[target - D(v_(n-1))] until |v_n - v_(n-1)| < sigma (K), eq (20).

    Raises ValueError if the method is not defined for the model (see `applicable`).
    """
    if not applicable(model):
        raise ValueError("the paper's inverse needs common envelopes, radii[0] = 0 and weights[0] > 0: p(r_0) divides")
    converged, v, count = _iterate(
        target,
        memory.input_degC,
        model.packed[0][0],
        model.packed[1],
        model.packed[2],
        model.memoryless.code,
        model.memoryless_array,
        memory.plays.copy(),
        sigma,
        most_iterations,
    )
    return IterationResult(v, count, converged)
