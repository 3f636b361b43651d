"""Where a memoryless function turns and bends: the points between which D and dD/dv are both monotone.

Between neighbours of these points the range of D and of dD/dv is that of the ends, so that any interval has exact
ranges from D at its own ends and at the points inside. They are found once for a model and its limits:

    tanh               its centre                      sin, cos    every quarter period
    polynomial         real roots of D' and D''        none, linear, arrhenius    nowhere
    a user's function  sign changes of D' and D'' on a grid of GRID points, refined by bisection
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.polynomial import Polynomial

from compensator.compiled import njit
from compensator.hysteresis.film import Memoryless
from compensator.hysteresis.functions import FIRST_COEFFICIENT, Array, memoryless

GRID: Final = 4097  # points, 60 mK apart over 250 K: two sign changes nearer to each other are not seen
VALUE_ROW, SLOPE_ROW = 1, 2  # of the table; row 0 is v


def pieces(d: Memoryless, low_degC: float, high_degC: float) -> Array:
    """Rows v (degC, increasing, the limits included), D and dD/dv at these points, shape (3, points)."""
    par = d.array()
    inside = np.array([v for v in _turns_and_bends(d, par, low_degC, high_degC) if low_degC < v < high_degC])
    v = np.unique(np.concatenate([[low_degC], inside, [high_degC]]))
    table = np.empty((3, v.size))
    for k in range(v.size):
        table[0, k] = v[k]
        table[VALUE_ROW, k], table[SLOPE_ROW, k], _ = memoryless(d.code, par, float(v[k]))
    return table


def _turns_and_bends(d: Memoryless, par: Array, low: float, high: float) -> Array:
    nowhere: Array = np.empty(0)
    if d.function in ("none", "linear", "arrhenius") or (d.function != "polynomial" and d.a == 0.0):
        return nowhere
    if d.function == "tanh":
        return np.array([-d.b / d.a])
    if d.function in ("sin", "cos"):
        first, last = sorted((d.a * low + d.b, d.a * high + d.b))
        quarter = 0.5 * math.pi
        count = np.arange(math.ceil(first / quarter), math.floor(last / quarter) + 1, dtype=np.float64)
        return np.asarray((count * quarter - d.b) / d.a, dtype=np.float64)
    if d.function == "polynomial":
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        curve = Polynomial(par[FIRST_COEFFICIENT:])(Polynomial([middle, half]))  # in x = (v - middle) / half
        roots = np.concatenate([curve.deriv().trim().roots(), curve.deriv(2).trim().roots()])
        near = np.abs(roots.imag) < 1e-6
        return np.asarray(middle + half * roots.real[near], dtype=np.float64)
    v = np.linspace(low, high, GRID)
    found = [nowhere]
    for which in (1, 2):
        values = np.array([memoryless(d.code, par, float(x))[which] for x in v])
        found.append(
            np.array(
                [
                    _bisected(d.code, par, which, v[k], v[k + 1])
                    for k in np.flatnonzero(np.sign(values[1:]) * np.sign(values[:-1]) < 0.0)
                ]
            )
        )
        found.append(v[values == 0.0])
    return np.concatenate(found)


def _bisected(code: int, par: Array, which: int, left: float, right: float) -> float:
    positive = memoryless(code, par, left)[which] > 0.0
    for _ in range(60):
        middle = 0.5 * (left + right)
        if (memoryless(code, par, middle)[which] > 0.0) == positive:
            left = middle
        else:
            right = middle
    return 0.5 * (left + right)


@njit
def inside(table: Array, low: float, high: float) -> tuple[int, int]:
    """Indices (first, one past the last) of the points strictly between low and high."""
    first = int(np.searchsorted(table[0], low, side="right"))
    return first, max(first, int(np.searchsorted(table[0], high, side="left")))


@njit
def range_between(
    table: Array, row: int, low: float, high: float, at_low: float, at_high: float
) -> tuple[float, float]:
    """Least and largest D (row 1) or dD/dv (row 2) on [low, high] degC, given its values at the two ends."""
    least, most = min(at_low, at_high), max(at_low, at_high)
    first, last = inside(table, low, high)
    for k in range(first, last):
        least, most = min(least, table[row, k]), max(most, table[row, k])
    return least, most
