"""Operator outputs along a path: the compiled part of a fit.

An operator's output is always an envelope's value at an earlier row of the path, shifted by the radius,
    w_j = gamma_R(v_k) - r_j   or   gamma_L(v_k) + r_j   or   its saturated value,      paper eq (6)
Envelopes are gamma(v) = tanh(a (v - c)), and the operators share (log a_R, c_R, log a_L, c_L). The smallest radius for
which the order condition below eq (6) holds is
    f = max(0, max over v of (gamma_R(v) - gamma_L(v)) / 2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

Integers = NDArray[np.int64]
Sides = NDArray[np.int8]
GROUP = 4  # parameters of a group: log a_R, c_R, log a_L, c_L
WIDE, FINE = 80, 16  # steps to each side of the middle, in which the widest place between envelopes is looked for


@njit
def operator_outputs(
    gamma: Array, side: Sides, radii: Array, group: Integers, top: float, rows: Integers, out: Array
) -> None:
    """Outputs of all operators at the given rows of the path, into out (rows, operators).

    gamma: (path, groups), the envelope of the side on which the path arrives at a row. side: +1 rising, -1 falling,
    0 at rest; -2 and +2 begin anew, from saturation at `top` ("cooled") or at -top ("heated").
    """
    count = radii.size
    w = np.empty(count)
    g = np.empty(count)
    r = 0
    for i in range(side.size):
        s = side[i]
        if s != 0:
            if gamma.shape[1] == 1:
                g[:] = gamma[i, 0]
            else:
                for j in range(count):
                    g[j] = gamma[i, group[j]]
            if s == 1:
                for j in range(count):
                    w[j] = max(g[j] - radii[j], w[j])
            elif s == -1:
                for j in range(count):
                    w[j] = min(g[j] + radii[j], w[j])
            elif s == -2:
                for j in range(count):
                    w[j] = min(g[j] + radii[j], top - radii[j])
            else:
                for j in range(count):
                    w[j] = max(g[j] - radii[j], radii[j] - top)
        while r < rows.size and rows[r] == i:
            for j in range(count):
                out[r, j] = w[j]
            r += 1


def envelope_values(inputs: Array, side: Sides, shapes: Array) -> Array:
    """gamma along the path on the side it arrives, shape (path, groups); shapes as above."""
    rising = (side > 0)[:, None]
    a = np.where(rising, np.exp(shapes[None, :, 0]), np.exp(shapes[None, :, 2]))
    c = np.where(rising, shapes[None, :, 1], shapes[None, :, 3])
    return np.asarray(np.tanh(a * (inputs[:, None] - c)), dtype=np.float64)


@njit
def radius_floor(shape: Array) -> tuple[float, Array]:
    """Return the smallest radius that the order condition allows for tanh envelopes, and its gradient, shape (4,)."""
    slope_r, centre_r, slope_l, centre_l = math.exp(shape[0]), float(shape[1]), math.exp(shape[2]), float(shape[3])
    envelopes = slope_r, centre_r, slope_l, centre_l
    middle, reach = 0.5 * (centre_r + centre_l), 0.5 * abs(centre_r - centre_l) + 4.0 / min(slope_r, slope_l)
    gap, x = _largest_gap(*envelopes, middle, reach, WIDE)
    # The narrower tanh may be far steeper: a grid in each scale, then twice refined about the best place.
    near, its_reach = centre_r if slope_r > slope_l else centre_l, 4.0 / max(slope_r, slope_l)
    other_gap, other_x = _largest_gap(*envelopes, near, its_reach, WIDE)
    if other_gap > gap:
        x, reach = other_x, its_reach
    reach /= WIDE
    for _ in range(2):
        gap, x = _largest_gap(*envelopes, x, reach, FINE)
        reach /= FINE
    floor = 0.5 * gap
    if floor <= 0.0:
        return 0.0, np.zeros(GROUP)
    g_r, g_l = math.tanh(slope_r * (x - centre_r)), math.tanh(slope_l * (x - centre_l))
    bell_r, bell_l = 0.5 * (1.0 - g_r * g_r) * slope_r, 0.5 * (1.0 - g_l * g_l) * slope_l
    gradient = np.array([bell_r * (x - centre_r), -bell_r, -bell_l * (x - centre_l), bell_l])
    return floor + 1e-9, gradient


@njit
def _largest_gap(
    slope_r: float, centre_r: float, slope_l: float, centre_l: float, middle: float, reach: float, steps: int
) -> tuple[float, float]:
    """Return the largest gamma_R - gamma_L of so many steps to each side of the middle, and where it is."""
    largest, at = -np.inf, middle
    for k in range(-steps, steps + 1):
        v = middle + reach * k / steps
        gap = math.tanh(slope_r * (v - centre_r)) - math.tanh(slope_l * (v - centre_l))
        if gap > largest:
            largest, at = gap, v
    return largest, at
