"""Operator outputs along a path: the compiled part of a fit.

An operator's output is always an envelope's value at an earlier row of the path, shifted by the radius,
    w_j = gamma_R(v_k) - r_j   or   gamma_L(v_k) + r_j   or   its saturated value,      paper eq (6)
Envelopes are gamma(v) = f(a (v - c)), and the operators share f and (log a_R, c_R, log a_L, c_L). The smallest radius
for which the order condition below eq (6) holds is
    f = max(0, max over v of (gamma_R(v) - gamma_L(v)) / 2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array, envelope_value

Integers = NDArray[np.int64]
Sides = NDArray[np.int8]
Row = tuple[float, float, float]  # an envelope: its code, a, b
WIDE, FINE = 80, 16  # steps to each side of the middle, in which the widest place between envelopes is looked for, and
REFINED = 3  # times finer ones: until it is known to 1e-9


@njit
def operator_outputs(gamma: Array, side: Sides, radii: Array, top: float, rows: Integers, out: Array) -> None:
    """Outputs of all operators at the given rows of the path, into out (rows, operators).

    gamma: (path,), the envelope of the side on which the path arrives at a row. side: +1 rising, -1 falling,
    0 at rest; -2 and +2 begin anew, from saturation at `top` ("cooled") or at -top ("heated").
    """
    count = radii.size
    w = np.empty(count)
    r = 0
    for i in range(side.size):
        s, g = side[i], gamma[i]
        if s != 0:
            if s == 1:
                for j in range(count):
                    w[j] = max(g - radii[j], w[j])
            elif s == -1:
                for j in range(count):
                    w[j] = min(g + radii[j], w[j])
            elif s == -2:
                for j in range(count):
                    w[j] = min(g + radii[j], top - radii[j])
            else:
                for j in range(count):
                    w[j] = max(g - radii[j], radii[j] - top)
        while r < rows.size and rows[r] == i:
            for j in range(count):
                out[r, j] = w[j]
            r += 1


def envelopes_along(inputs: Array, side: Sides, shape: Array, code: float) -> Array:
    """gamma along the path on the side it arrives, shape (path,). shape: as above; code: of f in compiled loops."""
    rising, falling = ((code, math.exp(a), -math.exp(a) * c) for a, c in ((shape[0], shape[1]), (shape[2], shape[3])))
    gamma = np.empty(inputs.size)
    _along(inputs, side, rising, falling, gamma)
    return gamma


@njit
def _along(inputs: Array, side: Sides, rising: Row, falling: Row, gamma: Array) -> None:
    for k in range(inputs.size):
        code, a, b = rising if side[k] > 0 else falling
        gamma[k] = envelope_value(code, a, b, inputs[k])


@njit
def radius_floor(shape: Array, code: float) -> float:
    """Return the smallest radius that the order condition allows. code: of the envelopes in compiled loops."""
    slope_r, centre_r, slope_l, centre_l = math.exp(shape[0]), float(shape[1]), math.exp(shape[2]), float(shape[3])
    rising, falling = (code, slope_r, -slope_r * centre_r), (code, slope_l, -slope_l * centre_l)
    apart = 0.5 * abs(centre_r - centre_l)
    # the narrower one may be far steeper: a grid in each scale, out to where tails end; then refined about the best
    largest, x, near = -np.inf, centre_r, 0.0
    for middle, reach in (
        (0.5 * (centre_r + centre_l), apart + 2.0 / min(slope_r, slope_l)),
        (centre_r if slope_r > slope_l else centre_l, 2.0 / max(slope_r, slope_l)),
    ):
        for k in range(-WIDE, WIDE + 1):
            out = math.tan(0.5 * math.pi * k / (WIDE + 1))
            gap = _gap(rising, falling, middle + reach * out)
            if gap > largest:
                largest, x, near = gap, middle + reach * out, 2.0 * reach * (1.0 + out * out) / WIDE
    for _ in range(REFINED):
        centre = x
        for k in range(-FINE, FINE + 1):
            gap = _gap(rising, falling, centre + near * k / FINE)
            if gap > largest:
                largest, x = gap, centre + near * k / FINE
        near /= FINE
    return 0.5 * largest + 1e-9 if largest > 0.0 else 0.0


@njit
def _gap(rising: Row, falling: Row, v: float) -> float:
    higher = envelope_value(rising[0], rising[1], rising[2], v)
    return higher - envelope_value(falling[0], falling[1], falling[2], v)
