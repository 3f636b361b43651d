"""One branch of the model from a memory: values, bounds and steps along it, for the inverse to search.

From a memory every temperature above the present one lies on the rising branch, every one below on the falling
branch. The falling one is the rising one of the model turned round: with z = side v and side = +-1,

    F(z) = side f(side z) = E(z) + H(z),      E(z) = side D(side z),
    H(z) = sum_j p_j max(G(z) - r_j, side m_j),    G(z) = side gamma(side z)

so that only a walk to larger z is needed, along which H never decreases and operators only ever start to move. In
g = G(z) H is convex and piecewise linear (common envelopes). On an interval [x, y]

    E in [min E, max E],  E' in [min E', max E']                         exactly, `compensator.pieces`
    H in [H(x), H(y)],    H' in [sum_(moving at x) p min G', sum_(moving at y) p max G']

which bounds F by its range and by lines through both ends. Nothing but `evaluate` computes D and the envelopes at a
trial temperature; the rest reuses what stands in the rows of the workspace.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from compensator import play
from compensator.film import Packed
from compensator.functions import Array, envelope, envelope_inflection, envelope_inverse, memoryless
from compensator.pieces import SLOPE_ROW, VALUE_ROW, range_between

ROWS: Final = 128  # points that a search can hold
Z, F, E1, E2, H, GAMMA, SLOPE, D = range(8)  # columns of a point: z, F, E', E'', H, G, G', D(side z)

Work = tuple[Array, Array, Array, Array]  # points (ROWS, 8), each envelope's G and G' (ROWS, envelopes), scratch


@njit(cache=True)
def workspace(film: Packed) -> Work:
    """Room for a search; the two arrays of envelopes hold anything only where envelopes are mixed."""
    envelopes, operators = film[0].shape[0], film[1].size
    rows = ROWS if envelopes > 1 else 1
    return np.empty((ROWS, 8)), np.empty((rows, envelopes)), np.empty((rows, envelopes)), np.empty((2, operators))


@njit(cache=True)
def place(row: int, side: float, film: Packed, memory: Array, work: Work) -> None:
    """Complete a row that has z, D and its slopes in v, and the envelope there: H and F, in the model's own bits."""
    radii, weights = film[1], film[2]
    points, gammas, _, scratch = work
    moved = scratch[0]
    point = points[row]
    if film[0].shape[0] == 1:
        gamma = point[GAMMA]
        for j in range(radii.size):
            moved[j] = side * max(gamma - radii[j], side * memory[j])
    else:
        for j in range(radii.size):
            moved[j] = side * max(gammas[row, j] - radii[j], side * memory[j])
    total = play.weighted_sum(weights, moved)
    point[H] = side * total
    point[F] = side * (point[D] + total)


@njit(cache=True)
def evaluate(row: int, side: float, z: float, film: Packed, memory: Array, work: Work) -> None:
    """One evaluation: D and the envelopes at z, into a row of the workspace."""
    envelopes, code, par = film[0], film[3], film[4]
    points, gammas, slopes, _ = work
    point = points[row]
    v = side * z
    d0, d1, d2 = memoryless(code, par, v)
    point[Z], point[D], point[E1], point[E2] = z, d0, d1, side * d2
    first = 0 if side > 0.0 else 3
    if envelopes.shape[0] == 1:
        gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
        point[GAMMA], point[SLOPE] = side * gamma, slope
    else:
        for j in range(envelopes.shape[0]):
            gamma, slope = envelope(envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2], v)
            gammas[row, j], slopes[row, j] = side * gamma, slope
    place(row, side, film, memory, work)


@njit(cache=True)
def slope_onward(row: int, side: float, film: Packed, memory: Array, work: Work) -> float:
    """F' just above a point: an operator that has reached its envelope moves."""
    envelopes, radii, weights = film[0], film[1], film[2]
    points, gammas, slopes, _ = work
    total = 0.0
    common = envelopes.shape[0] == 1
    gamma, slope = points[row, GAMMA], points[row, SLOPE]
    for j in range(radii.size):
        if not common:
            gamma, slope = gammas[row, j], slopes[row, j]
        if gamma - radii[j] >= side * memory[j]:
            total += weights[j] * slope
    return points[row, E1] + total


@njit(cache=True)
def moving_weight(row: int, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Sum of the weights of the operators that move just above a point."""
    envelopes, radii, weights = film[0], film[1], film[2]
    gamma, total = work[0][row, GAMMA], 0.0
    for j in range(radii.size):
        if envelopes.shape[0] > 1:
            gamma = work[1][row, j]
        if gamma - radii[j] >= side * memory[j]:
            total += weights[j]
    return total


@njit(cache=True)
def bounds(
    x: int, y: int, side: float, film: Packed, table: Array, memory: Array, work: Work
) -> tuple[float, float, float, float, float, float]:
    """(least F', largest F', least F, largest F, least E, largest E) between the points in rows x and y."""
    envelopes, radii, weights = film[0], film[1], film[2]
    points, gammas, slopes, _ = work
    p, q = points[x], points[y]
    width = q[Z] - p[Z]
    low, high = min(side * p[Z], side * q[Z]), max(side * p[Z], side * q[Z])
    d_low, d_high = (p[D], q[D]) if side > 0.0 else (q[D], p[D])
    s_low, s_high = (p[E1], q[E1]) if side > 0.0 else (q[E1], p[E1])
    least_d, most_d = range_between(table, VALUE_ROW, low, high, d_low, d_high)
    least_e, most_e = (least_d, most_d) if side > 0.0 else (-most_d, -least_d)
    least, most = range_between(table, SLOPE_ROW, low, high, s_low, s_high)
    first = 0 if side > 0.0 else 3
    slack = 0.0
    if envelopes.shape[0] == 1:
        code, a, b = envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2]
        flat, steep = min(p[SLOPE], q[SLOPE]), max(p[SLOPE], q[SLOPE])
        centre = envelope_inflection(code, a, b)
        if low < centre < high:
            at_centre = envelope(code, a, b, centre)[1] if code != 1.0 else a
            flat, steep = min(flat, at_centre), max(steep, at_centre)
        already, at_last = 0.0, 0.0
        for j in range(radii.size):
            if p[GAMMA] - radii[j] >= side * memory[j]:
                already += weights[j]
            if q[GAMMA] - radii[j] > side * memory[j]:
                at_last += weights[j]
        least += already * flat
        most += max(already, at_last) * steep
    else:
        for j in range(radii.size):
            code, a, b = envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2]
            if gammas[y, j] - radii[j] <= side * memory[j]:
                continue
            flat, steep = min(slopes[x, j], slopes[y, j]), max(slopes[x, j], slopes[y, j])
            centre = envelope_inflection(code, a, b)
            if low < centre < high:
                at_centre = envelope(code, a, b, centre)[1] if code != 1.0 else a
                flat, steep = min(flat, at_centre), max(steep, at_centre)
            if gammas[x, j] - radii[j] >= side * memory[j]:
                least += weights[j] * flat
            most += weights[j] * steep
    floor, ceiling = least_e + p[H], most_e + q[H]
    if most <= 0.0:
        ceiling = min(ceiling, p[F])
    elif least >= 0.0:
        ceiling = min(ceiling, q[F])
    else:
        ceiling = min(ceiling, p[F] + most * (q[F] - p[F] - least * width) / (most - least))
    if least >= 0.0:
        floor = max(floor, p[F])
    elif most <= 0.0:
        floor = max(floor, q[F])
    else:
        floor = max(floor, p[F] + least * (q[F] - p[F] - most * width) / (least - most))
    slack = 4e-16 * (abs(p[D]) + abs(q[D]) + abs(p[H]) + abs(q[H]))
    return least, most, floor - slack, ceiling + slack, least_e, most_e


@njit(cache=True)
def level(kappa: float, rest: float, start: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """The g at which kappa g + sum_j p_j max(g - r_j, side m_j) = rest, common envelopes; nan where there is none.

    The sum is convex and piecewise linear in g: Newton's method, from `start`, is exact after finitely many steps.
    """
    radii, weights = film[1], film[2]
    parts, active = work[3][0], work[3][1]
    count = radii.size
    g, steps = start, 0
    while steps <= count + 4:
        for j in range(count):
            held = side * memory[j]
            moves = g - radii[j] >= held
            parts[j] = -radii[j] if moves else held
            active[j] = weights[j] if moves else 0.0
        slope = kappa + play.lane_sum(active)
        if slope <= 0.0:
            if g == math.inf or steps > 0:
                return math.nan
            g = math.inf  # where all operators move the slope is largest
        else:
            g_next = (rest - play.weighted_sum(weights, parts)) / slope
            if steps > 0 and g < math.inf and g_next >= g - 1e-15 * (1.0 + abs(g)):
                return g_next
            g = g_next
        steps += 1
    return g


@njit(cache=True)
def common_step(row: int, target: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """The z where F reaches the target, common envelopes: exact in the operators' kinks and in g, E to second order."""
    point = work[0][row]
    slope = point[SLOPE]
    if slope <= 0.0:
        return math.nan
    kappa = point[E1] / slope
    g = level(kappa, target - (point[F] - point[H]) + kappa * point[GAMMA], point[GAMMA], side, film, memory, work)
    if not math.isfinite(g):
        return math.nan
    z = z_of(g, side, film)
    if not math.isfinite(z):
        return math.nan
    envelopes = film[0]
    first = 0 if side > 0.0 else 3
    code, a = envelopes[0, first], envelopes[0, first + 1]
    slope_there = slope
    if code == 0.0:
        slope_there = a
    elif code == 1.0:
        slope_there = a * (1.0 - g * g)
    step = z - point[Z]
    error = step * (point[E1] + 0.5 * step * point[E2]) - kappa * (g - point[GAMMA])
    total = point[E1] + point[E2] * step + play.lane_sum(work[3][1]) * slope_there
    if total > 0.0:
        z -= error / total
    return z


@njit(cache=True)
def z_of(g: float, side: float, film: Packed) -> float:
    """The z at which the common envelope has the value g."""
    envelopes = film[0]
    first = 0 if side > 0.0 else 3
    return side * envelope_inverse(
        envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], side * g
    )


@njit(cache=True)
def kinked_step(row: int, target: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """The z where E and every operator's envelope, each a straight line through the point, reach the target."""
    radii, weights = film[1], film[2]
    points, gammas, slopes, _ = work
    common = film[0].shape[0] == 1
    gap, z = target - points[row, F], math.inf
    gamma, slope = points[row, GAMMA], points[row, SLOPE]
    for _ in range(radii.size + 2):
        total, slope_sum = 0.0, points[row, E1]
        for j in range(radii.size):
            if not common:
                gamma, slope = gammas[row, j], slopes[row, j]
            held, w = side * memory[j], gamma - radii[j]
            here = max(w, held)
            if z == math.inf or w + slope * z > held:
                total += weights[j] * (w - here)
                slope_sum += weights[j] * slope
            else:
                total += weights[j] * (held - here)
        if slope_sum <= 0.0:
            return math.nan
        z_next = (gap - total) / slope_sum
        if z != math.inf and z_next >= z - 1e-15 * (1.0 + abs(z)):
            return points[row, Z] + z_next
        z = z_next
    return points[row, Z] + z
