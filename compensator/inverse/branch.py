"""One branch of the model from a memory: values, bounds and steps along it, for the inverse to search.

From a memory every temperature above the present one lies on the rising branch, every one below on the falling
branch. The falling one is the rising one of the model turned round: with z = side v and side = +-1,

    F(z) = side f(side z) = E(z) + H(z),      E(z) = side D(side z),
    H(z) = sum_j p_j max(G(z) - r_j, side m_j),    G(z) = side gamma(side z)

so that only a walk to larger z is needed, along which H never decreases and operators only ever start to move. In
g = G(z) H is convex and piecewise linear (common envelopes). On an interval [x, y]

    E in [min E, max E],  E' in [min E', max E']                         exactly (`pieces`)
    H in [H(x), H(y)],    H' in [sum_(moving at x) p min G', sum_(moving at y) p max G']

which bounds F by its range and by lines through both ends. Nothing but `evaluate` computes D and the envelopes at a
trial temperature; the rest reuses what stands in the rows of the workspace.

`pieces` are the points between which D and dD/dv are both monotone, so that any interval has exact ranges of both from
their values at its own ends and at the points inside:

    tanh               its centre                      sin, cos    every quarter period
    polynomial         real roots of D' and D''        none, linear, arrhenius    nowhere
    a user's function  sign changes of D' and D'' on a grid of GRID points, refined by bisection
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from compensator.compiled import njit
from compensator.hysteresis import play
from compensator.hysteresis.film import Memoryless, Packed
from compensator.hysteresis.functions import (
    FIRST_COEFFICIENT,
    Array,
    envelope,
    envelope_inverse,
    envelope_steepest,
    lean,
    memoryless,
)

VALUE_ROW, SLOPE_ROW = 1, 2  # of the table; row 0 is v


def pieces(d: Memoryless, low_degC: float, high_degC: float) -> Array:
    """Return rows v (degC, increasing, the limits included), D and dD/dv at these points, shape (3, points)."""
    par = d.array()
    inside = np.array([v for v in _turns_and_bends(d, par, low_degC, high_degC) if low_degC < v < high_degC])
    v = np.unique(np.concatenate([[low_degC], inside, [high_degC]]))
    table = np.empty((3, v.size))
    for k in range(v.size):
        table[0, k] = v[k]
        table[VALUE_ROW, k], table[SLOPE_ROW, k], _ = memoryless(d.code, par, float(v[k]))
    return table


def _turns_and_bends(d: Memoryless, par: Array, low: float, high: float) -> Array:
    if d.function in ("none", "linear", "arrhenius") or (d.function != "polynomial" and d.a == 0.0):
        return np.empty(0)
    if d.function == "tanh":
        return np.array([-d.b / d.a])
    if d.function in ("sin", "cos"):
        first, last = sorted((d.a * low + d.b, d.a * high + d.b))
        quarter = 0.5 * math.pi
        count = np.arange(math.ceil(first / quarter), math.floor(last / quarter) + 1, dtype=np.float64)
        return np.asarray((count * quarter - d.b) / d.a, dtype=np.float64)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    curve = Polynomial(par[FIRST_COEFFICIENT:])(Polynomial([middle, half]))  # in x = (v - middle) / half
    roots = np.concatenate([curve.deriv().trim().roots(), curve.deriv(2).trim().roots()])
    near = np.abs(roots.imag) < 1e-6
    return np.asarray(middle + half * roots.real[near], dtype=np.float64)


@njit
def inside(table: Array, low: float, high: float) -> tuple[int, int]:
    """Return the indices (first, one past the last) of the points strictly between low and high."""
    first = int(np.searchsorted(table[0], low, side="right"))
    return first, max(first, int(np.searchsorted(table[0], high, side="left")))


@njit
def range_between(
    table: Array, row: int, low: float, high: float, at_low: float, at_high: float
) -> tuple[float, float]:
    """Return the least and largest D (row 1) or dD/dv (row 2) on [low, high] degC, given its values at the two ends."""
    least, most = min(at_low, at_high), max(at_low, at_high)
    first, last = inside(table, low, high)
    for k in range(first, last):
        least, most = min(least, table[row, k]), max(most, table[row, k])
    return least, most


ROWS: Final = 128  # points that a search can hold
Z, F, E1, E2, H, GAMMA, SLOPE, D = range(8)  # columns of a point: z, F, E', E'', H, G, G', D(side z)

# what is known of the present temperature: v, D, D', D'', and of the branch last walked its side, G and G'
HERE_SIZE: Final = 7


class Work(NamedTuple):
    """Work arrays of a search, so that a step of it allocates nothing.

    points: shape (ROWS, 8). gammas, slopes: each envelope's G and G', shape (ROWS, envelopes), used if envelopes are
    mixed. held, parts: shape (operators,). here: what is known at the present temperature, shape (HERE_SIZE,), nan if
    unknown. root: the solution of a search, shape (1,).
    """

    points: Array
    gammas: Array
    slopes: Array
    held: Array
    parts: Array
    here: Array
    root: Array


@njit(error_model="numpy")
def workspace(film: Packed) -> Work:
    """Allocate the work arrays for a search on this film."""
    envelopes, operators = film[0].shape[0], film[1].size
    rows = ROWS if envelopes > 1 else 1
    gammas, slopes = np.empty((rows, envelopes)), np.empty((rows, envelopes))
    here = np.full(HERE_SIZE, math.nan)
    return Work(np.empty((ROWS, 8)), gammas, slopes, np.empty(operators), np.empty(operators), here, np.empty(1))


@lean
def place_common(
    row: int, side: float, radii: Array, weights: Array, memory: Array, points: Array, parts: Array
) -> None:
    """Complete a row that has z, D and its slopes, and G with H and F, in the model's own bits. Common envelopes."""
    gamma = points[row, GAMMA]
    for j in range(radii.size):
        parts[j] = max(gamma - radii[j], side * memory[j])
    h = play.weighted_sum(weights, parts)
    points[row, H], points[row, F] = h, side * points[row, D] + h


@lean
def evaluate(row: int, side: float, z: float, film: Packed, memory: Array, work: Work) -> None:
    """Evaluate D and the envelopes at z, into a row of the work arrays."""
    envelopes, code, par = film[0], film[3], film[4]
    points, gammas, slopes = work[0], work[1], work[2]
    v = side * z
    d0, d1, d2 = memoryless(code, par, v)
    points[row, Z], points[row, D], points[row, E1], points[row, E2] = z, d0, d1, side * d2
    first = 0 if side > 0.0 else 3
    if envelopes.shape[0] == 1:
        gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
        points[row, GAMMA], points[row, SLOPE] = side * gamma, slope
        place_common(row, side, film[1], film[2], memory, points, work[4])
    else:
        for j in range(envelopes.shape[0]):
            gamma, slope = envelope(envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2], v)
            gammas[row, j], slopes[row, j] = side * gamma, slope
        radii, weights, parts = film[1], film[2], work[4]
        for j in range(radii.size):
            parts[j] = max(gammas[row, j] - radii[j], side * memory[j])
        h = play.weighted_sum(weights, parts)
        points[row, H], points[row, F] = h, side * d0 + h


@lean
def slope_onward(row: int, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return F' just above a point: an operator that has reached its envelope moves."""
    envelopes, radii, weights = film[0], film[1], film[2]
    points, gammas, slopes = work[0], work[1], work[2]
    total = 0.0
    common = envelopes.shape[0] == 1
    gamma, slope = points[row, GAMMA], points[row, SLOPE]
    for j in range(radii.size):
        if not common:
            gamma, slope = gammas[row, j], slopes[row, j]
        if gamma - radii[j] >= side * memory[j]:
            total += weights[j] * slope
    return float(points[row, E1] + total)


@lean
def moving_weight(row: int, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return the sum of the weights of the operators that move just above a point."""
    envelopes, radii, weights = film[0], film[1], film[2]
    gamma, total = work[0][row, GAMMA], 0.0
    for j in range(radii.size):
        if envelopes.shape[0] > 1:
            gamma = work[1][row, j]
        if gamma - radii[j] >= side * memory[j]:
            total += weights[j]
    return total


@lean
def bounds(
    x: int, y: int, side: float, film: Packed, table: Array, memory: Array, work: Work
) -> tuple[float, float, float, float, float, float]:
    """Return (least F', largest F', least F, largest F, least E, largest E) between the points in rows x and y."""
    envelopes, radii, weights = film[0], film[1], film[2]
    points, gammas, slopes = work[0], work[1], work[2]
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
        centre, at_centre = envelope_steepest(code, a, b)
        if low < centre < high:
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
            centre, at_centre = envelope_steepest(code, a, b)
            if low < centre < high:
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


@njit(error_model="numpy", fastmath={"reassoc", "nsz"})
def moving_sums(g: float, held: Array, radii: Array, weights: Array) -> tuple[float, float]:
    """Return (rest, moving) of sum_j p_j max(g - r_j, held_j) = moving g + rest, summed in any order (for steps)."""
    rest, moving = 0.0, 0.0
    for j in range(radii.size):
        moves = g - radii[j] >= held[j]
        rest += weights[j] * (-radii[j] if moves else held[j])
        moving += weights[j] if moves else 0.0
    return rest, moving


@lean
def level(kappa: float, target: float, start: float, held: Array, radii: Array, weights: Array) -> tuple[float, float]:
    """Solve kappa g + sum_j p_j max(g - r_j, held_j) = target: return (g, weight that moves there), nan if nowhere.

    held: side m_j. The sum is convex and piecewise linear in g: Newton's method, from `start`, is exact after finitely
    many steps.
    """
    g, moving, steps = start, 0.0, 0
    while steps <= radii.size + 4:
        rest, moving = moving_sums(g, held, radii, weights)
        slope = kappa + moving
        if slope > 0.0:
            g_next = (target - rest) / slope
            done = steps > 0 and g < math.inf and g_next >= g - 1e-15 * (1.0 + abs(g))
            g = g_next
            if done:
                break
        elif steps > 0:
            g = math.nan
            break
        else:
            g = math.inf  # where all operators move the slope is largest
        steps += 1
    return g, moving


@lean
def hold(side: float, memory: Array, held: Array) -> None:
    """Set held_j = side m_j, which each operator keeps until its envelope has passed it."""
    for j in range(memory.size):
        held[j] = side * memory[j]


@lean
def held_back(rest: float, start: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return the z at which H alone reaches the value `rest`, common envelopes; nan if it never does."""
    envelopes, held = film[0], work[3]
    hold(side, memory, held)
    g = level(0.0, rest, start, held, film[1], film[2])[0]
    first = 0 if side > 0.0 else 3
    return side * envelope_inverse(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], side * g)


@lean
def common_step(row: int, target: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return the z where F reaches the target, common envelopes: exact in the operators' kinks, E linear in g."""
    point, envelopes, held = work[0][row], film[0], work[3]
    if point[SLOPE] <= 0.0:
        return math.nan
    hold(side, memory, held)
    kappa = point[E1] / point[SLOPE]
    rest = target - (point[F] - point[H]) + kappa * point[GAMMA]
    g = level(kappa, rest, point[GAMMA], held, film[1], film[2])[0]
    first = 0 if side > 0.0 else 3
    return side * envelope_inverse(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], side * g)


@lean
def kinked_step(gap: float, e1: float, slope: float, gamma: float, held: Array, radii: Array, weights: Array) -> float:
    """Return the step in z after which E and the common envelope, both straight lines, close the gap; nan: never."""
    rest, moving = moving_sums(gamma, held, radii, weights)
    total = gap + rest + moving * gamma
    g, z = math.inf, math.inf
    for _ in range(radii.size + 2):
        rest, moving = moving_sums(g, held, radii, weights)
        if e1 + moving * slope <= 0.0:
            z = math.nan
            break
        z_next = (total - rest - moving * gamma) / (e1 + moving * slope)
        done = z_next >= z - 1e-15 * (1.0 + abs(z))
        z, g = z_next, gamma + slope * z_next
        if done:
            break
    return z


@lean
def mixed_step(row: int, target: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return the same step where every operator has an envelope of its own."""
    radii, weights = film[1], film[2]
    points, gammas, slopes = work[0], work[1], work[2]
    gap, z = target - points[row, F], math.inf
    for _ in range(radii.size + 2):
        total, slope_sum = 0.0, points[row, E1]
        for j in range(radii.size):
            held, w, slope = side * memory[j], gammas[row, j] - radii[j], slopes[row, j]
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
            return float(z_next)
        z = z_next
    return z


# ---- the one root of F = target inside a bracket that is proven to hold exactly one -------------------
#
# The step is exact in the operators' kinks (`common_step`, `kinked_step`); one that leaves the bracket or gains too
# little is replaced by one that halves it.

# rows of the workspace: typed, as a literal would compile each function once more for every row
HERE: Any = np.int64(0)  # the point that the walk has come to
TOP: Any = np.int64(1)  # the first of the far ends still to be walked to
TRIAL: Any = np.int64(ROWS - 1)
FOUND: Any = np.int64(ROWS - 2)
FOUND_UP: Any = np.int64(ROWS - 3)
DEEPEST: Final = ROWS - 5
TOUCHING: Final = 4e-16  # relative: two bits, as close as the ends of a bracket come
MOST: Final = 200  # evaluations: halving alone takes 60 from any bracket to its last bit


@lean
def copy_row(source: int, sink: int, work: Work) -> None:
    """Copy a point from one row of the work arrays to another."""
    points, gammas, slopes = work[0], work[1], work[2]
    for k in range(points.shape[1]):
        points[sink, k] = points[source, k]
    if gammas.shape[0] > 1:
        for j in range(gammas.shape[1]):
            gammas[sink, j], slopes[sink, j] = gammas[source, j], slopes[source, j]


@lean
def halved(near: float, near_f: float, far: float, far_f: float, end: float, target: float, fallbacks: int) -> float:
    """Return where to look next inside a bracket.

    At its end if F is not known there (far_f nan), else in the middle, every third time on the straight line through
    both ends.
    """
    if math.isnan(far_f):
        return end
    if fallbacks % 3 == 1:
        share = near + (far - near) * (target - near_f) / (far_f - near_f)
        if near < share < far:
            return share
    return 0.5 * (near + far)


@lean
def common_root(
    near_row: int,
    far: float,
    far_f: float,
    e_increasing: bool,
    side: float,
    target: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    d_code: int,
    par: Array,
    memory: Array,
    points: Array,
    held: Array,
    parts: Array,
    tolerance: float,
) -> tuple[bool, int]:
    """Find the one root of F = target from a point up to `far`, where F is known to increase: (found, evaluations).

    far_f: F there, nan if not evaluated; it may then turn out not to reach the target. e_increasing: True if E
    increases, too. Common envelopes. The root is left in the row FOUND. Plain arrays, not the tuples of the other
    functions: taking an array out of a tuple counts a reference, which would double the time. One loop, not three
    functions: handing its numbers over costs 6 to 14 % of the inverse's time (measured, benchmark inverse).
    """
    first = 0 if side > 0.0 else 3
    code, a, b = envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2]
    for j in range(radii.size):
        held[j] = side * memory[j]
    z, f, h = points[near_row, Z], points[near_row, F], points[near_row, H]
    e1, e2, d0 = points[near_row, E1], points[near_row, E2], points[near_row, D]
    gamma, slope = points[near_row, GAMMA], points[near_row, SLOPE]
    near, near_f, end = z, f, far
    count, fallbacks, gap_before = 0, 0, math.inf
    while True:
        gap = abs(f - target)
        if gap <= tolerance or far - near <= TOUCHING * max(abs(far), abs(near)) or count >= MOST:
            break
        trial = math.nan
        if gap <= 0.5 * gap_before:
            if slope > 0.0:
                kappa = e1 / slope
                g, moving = level(kappa, target - side * d0 + kappa * gamma, gamma, held, radii, weights)
                step = side * envelope_inverse(code, a, b, side * g) - z
                slope_there = slope
                if code == 0.0:
                    slope_there = a
                elif code == 1.0:
                    slope_there = a * (1.0 - g * g)
                elif abs(g) < 1.0:
                    slope_there = envelope(code, a, b, side * (z + step))[1]
                error = step * (e1 + 0.5 * step * e2) - kappa * (g - gamma)
                total = e1 + e2 * step + moving * slope_there
                if total > 0.0:
                    step -= error / total
                trial = z + step
            if not near < trial < far:
                trial = z + kinked_step(target - f, e1, slope, gamma, held, radii, weights)
        gap_before = gap
        if not near < trial < far:
            gap_before = math.inf
            if e_increasing and f < target:
                # E only grows from here on, so H alone would reach the target no sooner than F does
                g, _ = level(0.0, target - side * d0, gamma, held, radii, weights)
                trial = side * envelope_inverse(code, a, b, side * g)
            if not near < trial < far:
                fallbacks += 1
                trial = halved(near, near_f, far, far_f, end, target, fallbacks)
        z = trial
        d0, d1, d2 = memoryless(d_code, par, side * z)
        e1, e2 = d1, side * d2
        gamma, slope = envelope(code, a, b, side * z)
        gamma *= side
        for j in range(radii.size):
            parts[j] = max(gamma - radii[j], held[j])
        h = play.weighted_sum(weights, parts)
        f = side * d0 + h
        count += 1
        if f < target:
            near, near_f = z, f
            if z == end:
                far = end  # not reached: near and far meet
        else:
            far, far_f = z, f
    points[FOUND, Z], points[FOUND, F], points[FOUND, H] = z, f, h
    points[FOUND, E1], points[FOUND, E2], points[FOUND, D] = e1, e2, d0
    points[FOUND, GAMMA], points[FOUND, SLOPE] = gamma, slope
    return abs(f - target) <= tolerance or not math.isnan(far_f), count


@lean
def bracketed(
    near_row: int,
    far_row: int,
    side: float,
    target: float,
    film: Packed,
    memory: Array,
    work: Work,
    tolerance: float,
) -> tuple[bool, int]:
    """Find the root between two points, for any envelopes and for falling F; far's F is nan if not evaluated."""
    points = work[0]
    common = film[0].shape[0] == 1
    far, far_f = points[far_row, Z], points[far_row, F]
    copy_row(near_row, TRIAL, work)
    near, near_f, end = points[TRIAL, Z], points[TRIAL, F], far
    increasing = near_f < target
    count, fallbacks, gap_before = 0, 0, math.inf
    while True:
        z, f = points[TRIAL, Z], points[TRIAL, F]
        gap = abs(f - target)
        if gap <= tolerance or far - near <= TOUCHING * max(abs(far), abs(near)) or count >= MOST:
            break
        trial = math.nan
        if gap <= 0.5 * gap_before:
            if increasing and not common:
                trial = z + mixed_step(TRIAL, target, side, film, memory, work)
            else:
                slope = slope_onward(TRIAL, side, film, memory, work)
                trial = z + (target - f) / slope if slope != 0.0 else math.nan
        gap_before = gap
        if not near < trial < far:
            gap_before = math.inf
            fallbacks += 1
            trial = halved(near, near_f, far, far_f, end, target, fallbacks)
        evaluate(TRIAL, side, trial, film, memory, work)
        count += 1
        f = points[TRIAL, F]
        if (f < target) == increasing:
            near, near_f = trial, f
        else:
            far, far_f = trial, f
    copy_row(TRIAL, FOUND, work)
    return abs(points[FOUND, F] - target) <= tolerance or not math.isnan(far_f), count
