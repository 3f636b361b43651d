"""A search along one branch that proves what it skips: roots of F = target, and the largest F.

The interval between two evaluated points is settled when its bounds (`compensator.inverse.branch.bounds`) exclude the
target, or when F is proven monotone there, so that the ends tell whether a bracket holds exactly one root
(`compensator.inverse.branch`). Else it is split: at the Newton step towards the target, at the extremum of the cubic
through both ends, where H alone must have come far enough (common envelopes), or in the middle. Intervals are settled
in the order of the walk, so that the first root found is the nearest. Bounds tighten with the square of the width, so
that an extremum that just reaches the target, or just does not, takes a few splits.

Where the output stands still at the target (a plateau of F) each temperature keeps the bound, and a bracket may close
on any of them. The end nearest to where the film is is found as the root of a target that half of the bound is taken
off (`plateau_start`).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis import play
from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, envelope, lean, memoryless
from compensator.inverse.branch import (
    DEEPEST,
    E1,
    E2,
    FOUND,
    FOUND_UP,
    GAMMA,
    HERE,
    ROWS,
    SLOPE,
    TOP,
    D,
    F,
    Work,
    Z,
    bounds,
    bracketed,
    common_root,
    common_step,
    copy_row,
    evaluate,
    held_back,
    inside,
    moving_weight,
    place_common,
    slope_onward,
    workspace,
)

NARROW: Final = 1e-12  # relative to |z|: no interval narrower than this is searched for a further pair of roots
SAME_K: Final = 1e-6  # roots no further apart are one: its bracket's end may be met from both sides
LITTLE: Final = 0.6  # of an interval: a division that leaves more than this of it gains less than halving would
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@lean
def outweighed(least_slope: float, side: float, film: Packed, memory: Array, work: Work) -> bool:
    """Return True if the operators of a straight common envelope that move from HERE on rise faster than E can fall."""
    envelopes, first = film[0], 0 if side > 0.0 else 3
    if envelopes.shape[0] > 1 or envelopes[0, first] != 0.0:
        return False
    return bool(moving_weight(HERE, side, film, memory, work) * envelopes[0, first + 1] + least_slope >= 0.0)


@lean
def extremum(x: int, y: int, sign: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Return where the cubic through both points has its largest (sign +1) or smallest (-1) value; nan if at an end."""
    p, q = work[0][x], work[0][y]
    width = q[Z] - p[Z]
    rise_p = -sign * slope_onward(x, side, film, memory, work)
    rise_q = -sign * slope_onward(y, side, film, memory, work)
    if not rise_p < 0.0 < rise_q:
        return math.nan
    mean = -sign * 3.0 * (p[F] - q[F]) / width + rise_p + rise_q
    root = math.sqrt(max(mean * mean - rise_p * rise_q, 0.0))
    share = 1.0 - (rise_q + root - mean) / (rise_q - rise_p + 2.0 * root)
    return float(p[Z] + width * min(max(share, 1e-4), 1.0 - 1e-4))


@lean
def split(
    x: int,
    y: int,
    target: float,
    stale: int,
    known: tuple[float, float, float, float],
    side: float,
    film: Packed,
    table: Array,
    memory: Array,
    work: Work,
) -> float:
    """Return where to divide the interval between two points; known: (least F', largest F', least E, largest E)."""
    p, q = work[0][x], work[0][y]
    width, middle = q[Z] - p[Z], 0.5 * (p[Z] + q[Z])
    if stale >= 2:
        return float(middle)
    below = p[F] < target
    first, last = inside(table, min(side * p[Z], side * q[Z]), max(side * p[Z], side * q[Z]))
    if last - first > 1:
        if film[0].shape[0] == 1:
            margin = 1e-12 * (1.0 + abs(target))
            z = held_back(target - known[3] - margin, p[GAMMA], side, film, memory, work)
            if p[Z] + 0.05 * width < z < q[Z]:
                return z
            z = held_back(target - known[2] + margin, p[GAMMA], side, film, memory, work)
            if p[Z] < z < q[Z] - 0.05 * width:
                return z
        return float(side * table[0, (first + last) // 2])
    trial = math.nan
    if below != (q[F] < target):
        slope = slope_onward(x, side, film, memory, work)
        if (slope > 0.0) == below and slope != 0.0:
            trial = p[Z] + (target - p[F]) / slope
            if stale == 1:
                trial += 0.2 * (trial - p[Z])
        if not p[Z] + 1e-4 * width < trial < q[Z] - 1e-4 * width:
            share = (target - p[F]) / (q[F] - p[F])
            trial = p[Z] + width * min(max(share, 0.1), 0.9)
        return trial
    if not below and stale == 1:  # a kink: where the steepest lines through the ends meet
        trial = p[Z] + (q[F] - p[F] - known[1] * width) / (known[0] - known[1])
    else:
        trial = extremum(x, y, 1.0 if below else -1.0, side, film, memory, work)
    if p[Z] + 1e-6 * width < trial < q[Z] - 1e-6 * width:
        return trial
    return float(side * table[0, first] if last > first else middle)


@lean
def one_root(
    far_row: int,
    e_increasing: bool,
    side: float,
    target: float,
    film: Packed,
    memory: Array,
    work: Work,
    tolerance: float,
) -> tuple[bool, int]:
    """Find the root between the point in row HERE and another, F monotone between them: (found, evaluations)."""
    points = work[0]
    far, far_f = points[far_row, Z], points[far_row, F]
    if film[0].shape[0] == 1 and not far_f < target:
        held, parts = work[3], work[4]
        return common_root(HERE, far, far_f, e_increasing, side, target, *film, memory, points, held, parts, tolerance)
    return bracketed(HERE, far_row, side, target, film, memory, work, tolerance)


@lean
def walked(
    row: int, evaluated: Flags, stale: Integers, target: float, side: float, film: Packed, memory: Array, work: Work
) -> int:
    """Evaluate a point on the way to a far end that is not evaluated yet, and return the row that it stands in.

    It is at a step towards the target, once for each far end, else at that end.
    """
    p, q = work[0][HERE], work[0][row]
    trial = math.nan
    if film[0].shape[0] == 1:
        trial = common_step(HERE, target, side, film, memory, work)
    if not p[Z] < trial < q[Z]:
        slope = slope_onward(HERE, side, film, memory, work)
        if slope * (target - p[F]) > 0.0:
            trial = p[Z] + (target - p[F]) / slope
    into = row
    if stale[row] == 0 and p[Z] < trial < q[Z] - 1e-3 * (q[Z] - p[Z]):  # any nearer to the end, and the end tells more
        stale[row] = 1
        into = row + 1
    else:
        trial = q[Z]
    evaluate(into, side, trial, film, memory, work)
    evaluated[into], stale[into] = True, 0
    return into


@lean
def added(found: int, points: Array, roots: Array) -> int:
    """Return how many roots there are with the one in row FOUND, unless that is the same as the last."""
    if found > 0 and not points[FOUND, Z] - roots[found - 1] > SAME_K:
        return found
    roots[found] = points[FOUND, Z]
    return found + 1


@lean
def verdict(
    row: int, target: float, tolerance: float, known: tuple[float, float, float, float], work: Work
) -> tuple[bool, bool, bool]:
    """Return (settled, its far end is a root, it holds exactly one root) of the interval from HERE to a row.

    known: (least F', largest F', least F, largest F) within.
    """
    least, most, floor, ceiling = known
    p, q = work[0][HERE], work[0][row]
    if ceiling < target or floor > target:
        return True, False, False
    narrow = q[Z] - p[Z] <= NARROW * max(abs(p[Z]), 1.0) or row >= DEEPEST
    settled = least >= 0.0 or most <= 0.0 or narrow
    at_end = abs(q[F] - target) <= tolerance
    touches = at_end and (ceiling <= target + tolerance if p[F] < target else floor >= target - tolerance)
    if (settled and at_end) or touches:
        return True, True, False
    return settled, False, settled and (p[F] < target) != (q[F] < target)


@lean
def divide(
    row: int,
    target: float,
    known: tuple[float, float, float, float],
    stale: Integers,
    side: float,
    film: Packed,
    table: Array,
    memory: Array,
    work: Work,
) -> None:
    """Evaluate a point between HERE and a row, into the next row; known as for `split`.

    stale: how often in a row each interval's division has taken little of it away.
    """
    points = work[0]
    near, far = points[HERE, Z], points[row, Z]
    trial = split(HERE, row, target, stale[row], known, side, film, table, memory, work)
    if not near < trial < far:
        trial = 0.5 * (near + far)
    evaluate(row + 1, side, trial, film, memory, work)
    before = stale[row]
    stale[row] = before + 1 if far - trial > LITTLE * (far - near) else 0
    stale[row + 1] = before + 1 if trial - near > LITTLE * (far - near) else 0


@njit(error_model="numpy")
def search(
    side: float,
    target: float,
    end: float,
    film: Packed,
    table: Array,
    least_slope: float,
    memory: Array,
    work: Work,
    tolerance: float,
    roots: Array,
) -> tuple[int, int]:
    """Find the roots of F = target from the point in row HERE to z = end, nearest first: (how many, evaluations).

    The search ends when `roots` is full; the last root is left in the row FOUND. The row HERE is the limit of the
    branch at the present temperature: if the output jumps at a reversal, the first root may lie one bit beyond.
    least_slope: of dD/dv within the limits.
    """
    points, found, count = work[0], 0, 0
    if abs(points[HERE, F] - target) <= tolerance:
        evaluate(FOUND, side, np.nextafter(points[HERE, Z], math.inf), film, memory, work)
        count += 1
        if abs(points[FOUND, F] - target) <= tolerance:
            found = added(found, points, roots)
            if found == roots.size:
                return found, count
    e_increasing = least_slope >= 0.0
    points[TOP, Z], points[TOP, F] = end, math.nan
    if e_increasing or outweighed(least_slope, side, film, memory, work):
        if points[HERE, F] > target:
            return found, count
        reached, more = one_root(TOP, e_increasing, side, target, film, memory, work, tolerance)
        return added(found, points, roots) if reached else found, count + more
    evaluated, stale = np.zeros(ROWS, dtype=np.bool_), np.zeros(ROWS, dtype=np.int64)
    depth = TOP
    while depth > 0:
        if not evaluated[depth]:
            depth = walked(depth, evaluated, stale, target, side, film, memory, work)
            count += 1
            continue
        least, most, floor, ceiling, least_e, most_e = bounds(HERE, depth, side, film, table, memory, work)
        settled, accepted, passes = verdict(depth, target, tolerance, (least, most, floor, ceiling), work)
        if accepted:
            copy_row(depth, FOUND, work)
        elif passes:
            accepted, more = one_root(depth, e_increasing, side, target, film, memory, work, tolerance)
            count += more
        if settled:
            if accepted:
                found = added(found, points, roots)
                if found == roots.size:
                    return found, count
            copy_row(depth, HERE, work)
            depth -= 1
            continue
        divide(depth, target, (least, most, least_e, most_e), stale, side, film, table, memory, work)
        depth += 1
        evaluated[depth] = True
        count += 1
    return found, count


@njit(error_model="numpy")
def largest(
    sign: float,
    side: float,
    end: float,
    film: Packed,
    table: Array,
    memory: Array,
    work: Work,
    tolerance: float,
) -> float:
    """Return the largest (sign +1) or smallest (-1) F from the point in row HERE to z = end, to `tolerance`."""
    points = work[0]
    best = sign * points[HERE, F]
    evaluate(TOP, side, end, film, memory, work)
    depth, stale = TOP, np.zeros(ROWS, dtype=np.int64)
    while depth > 0:
        p, q = points[HERE], points[depth]
        best = max(best, sign * q[F])
        least, most, floor, ceiling, least_e, most_e = bounds(HERE, depth, side, film, table, memory, work)
        bound = ceiling if sign > 0.0 else -floor
        if (
            bound <= best + tolerance
            or least >= 0.0
            or most <= 0.0
            or q[Z] - p[Z] <= NARROW * max(abs(p[Z]), 1.0)
            or depth >= DEEPEST
        ):
            copy_row(depth, HERE, work)
            depth -= 1
            continue
        goal, known = sign * (best + tolerance), (least, most, least_e, most_e)
        divide(depth, goal, known, stale, side, film, table, memory, work)
        best = max(best, sign * points[depth + 1, F])
        depth += 1
    return float(sign * best)


FLAT_K: Final = 1e-3  # a root that may be moved as far within the tolerance stands on a plateau


@lean
def plateau_start(
    side: float,
    target: float,
    f_here: float,
    start: float,
    film: Packed,
    table: Array,
    least_slope: float,
    memory: Array,
    work: Work,
    tolerance: float,
    roots: Array,
) -> int:
    """Move the root in row FOUND to the near end of its plateau, if it stands on one; return the evaluations taken.

    f_here: F at z = start, where the walk began. The near end is where F is half of the tolerance short of the target.
    """
    points = work[0]
    z, f = points[FOUND, Z], points[FOUND, F]
    if abs(f_here - target) <= tolerance or abs(slope_onward(FOUND, side, film, memory, work)) * FLAT_K > tolerance:
        return 0
    towards = 1.0 if target > f_here else -1.0
    goal = target - towards * 0.5 * tolerance
    if towards * (f - goal) <= 0.0:
        return 0
    evaluate(HERE, side, start, film, memory, work)
    found, count = search(side, goal, z, film, table, least_slope, memory, work, 0.25 * tolerance, roots)
    if found == 0 or not abs(points[FOUND, F] - target) <= tolerance:
        evaluate(FOUND, side, z, film, memory, work)
        count += 1
    return count + 1


@lean
def plateau_start_common(
    side: float,
    target: float,
    bound: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    code: int,
    par: Array,
    memory: Array,
    points: Array,
    held: Array,
    parts: Array,
) -> int:
    """Do as `plateau_start` for common envelopes and a D that never falls, from what `common_root` has left."""
    total = points[FOUND, E1]
    for j in range(radii.size):
        if points[FOUND, GAMMA] - radii[j] >= held[j]:
            total += weights[j] * points[FOUND, SLOPE]
    goal, far, far_f = target - 0.5 * bound, points[FOUND, Z], points[FOUND, F]
    if total * FLAT_K > bound or far_f <= goal:
        return 0
    for k in range(points.shape[1]):
        points[FOUND_UP, k] = points[FOUND, k]
    _, count = common_root(
        HERE,
        far,
        far_f,
        True,
        side,
        goal,
        envelopes,
        radii,
        weights,
        code,
        par,
        memory,
        points,
        held,
        parts,
        0.25 * bound,
    )
    if not abs(points[FOUND, F] - target) <= bound:
        for k in range(points.shape[1]):
            points[FOUND, k] = points[FOUND_UP, k]
    return count


# what the compiled loops need beside the film: (limits and costs: see `Inverse.settings`, pieces of D)
Settings = tuple[Array, Array]
LOW, HIGH, BOUND, LEAST_SLOPE, UP_COST, DOWN_COST = range(6)  # places in the first of `Settings`


@lean
def _place_here(
    side: float,
    v: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    memory: Array,
    points: Array,
    parts: Array,
    here: Array,
) -> None:
    """Fill the row HERE, at the present temperature v on a branch, from what is known of v. Common envelopes."""
    points[HERE, Z], points[HERE, D] = side * v, here[1]
    points[HERE, E1], points[HERE, E2] = here[2], side * here[3]
    if here[4] == side:
        points[HERE, GAMMA], points[HERE, SLOPE] = here[5], here[6]
    else:
        first = 0 if side > 0.0 else 3
        gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
        points[HERE, GAMMA], points[HERE, SLOPE] = side * gamma, slope
    place_common(HERE, side, radii, weights, memory, points, parts)


@lean
def _place_next(
    side: float,
    v: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    code: int,
    par: Array,
    memory: Array,
    points: Array,
    parts: Array,
) -> float:
    """Fill the row FOUND, one bit beyond v on a branch, and return that temperature. Common envelopes."""
    v_next = np.nextafter(v, side * math.inf)
    first = 0 if side > 0.0 else 3
    d0, d1, d2 = memoryless(code, par, v_next)
    gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v_next)
    points[FOUND, Z], points[FOUND, D], points[FOUND, E1] = side * v_next, d0, d1
    points[FOUND, E2], points[FOUND, GAMMA], points[FOUND, SLOPE] = side * d2, side * gamma, slope
    place_common(FOUND, side, radii, weights, memory, points, parts)
    return float(v_next)


@lean
def solve_monotone(
    target: float,
    v: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    code: int,
    par: Array,
    limits: Array,
    memory: Array,
    points: Array,
    held: Array,
    parts: Array,
    here: Array,
) -> tuple[bool, float, float, int]:
    """Do as `solve` where D never decreases and envelopes are common: one branch, one bracket.

    Plain arrays and one exit: with tuples of arrays or a second return every call would count its references.
    """
    bound = limits[BOUND]
    if here[0] != v:
        here[0], here[4] = v, 0.0
        here[1], here[2], here[3] = memoryless(code, par, v)
    rest = here[1] + play.weighted_sum(weights, memory)
    found, v_found, residual, count = abs(rest - target) <= bound, v, rest - target, 1
    if not found:
        side, end = (-1.0, -limits[LOW]) if target < rest else (1.0, limits[HIGH])
        _place_here(side, v, envelopes, radii, weights, memory, points, parts, here)
        # not where the film is at its limit, nor where the output jumps past the target at the reversal
        if side * v < end and points[HERE, F] - side * target < -bound:
            found, more = common_root(
                HERE,
                end,
                math.nan,
                True,
                side,
                side * target,
                envelopes,
                radii,
                weights,
                code,
                par,
                memory,
                points,
                held,
                parts,
                bound,
            )
            count += more
            if found and points[FOUND, E1] * FLAT_K <= bound:
                count += plateau_start_common(
                    side, side * target, bound, envelopes, radii, weights, code, par, memory, points, held, parts
                )
            v_found, residual = side * points[FOUND, Z], side * points[FOUND, F] - target
        elif side * v < end and points[HERE, F] - side * target <= bound:  # the jump ends at the target
            v_found = _place_next(side, v, envelopes, radii, weights, code, par, memory, points, parts)
            found, residual, count = True, side * points[FOUND, F] - target, count + 1
    return found, v_found if found else math.nan, residual, count


@njit(error_model="numpy")
def solve_any(
    target: float, v: float, film: Packed, settings: Settings, memory: Array, work: Work
) -> tuple[bool, float, float, int]:
    """Do as `solve` for films of which D may fall, or whose envelopes are mixed: both branches, each searched."""
    limits, table = settings
    points, root = work.points, work.root
    bound, least_slope = limits[BOUND], limits[LEAST_SLOPE]
    rest = memoryless(film[3], film[4], v)[0] + play.weighted_sum(film[2], memory)
    count = 1
    if abs(rest - target) <= bound:
        return True, v, rest - target, count
    monotone = least_slope >= 0.0
    up, up_residual, down, down_residual = math.nan, math.nan, math.nan, math.nan
    if v < limits[HIGH] and (target > rest or not monotone):
        evaluate(HERE, 1.0, v, film, memory, work)
        here = points[HERE, F]
        found, more = search(1.0, target, limits[HIGH], film, table, least_slope, memory, work, bound, root)
        count += more
        if found > 0:
            count += plateau_start(1.0, target, here, v, film, table, least_slope, memory, work, bound, root)
            up, up_residual = points[FOUND, Z], points[FOUND, F] - target
    stop = limits[LOW]
    if not math.isnan(up):
        stop = max(stop, v - (up - v) * limits[UP_COST] / limits[DOWN_COST])
    if v > stop and (target < rest or not monotone):
        if not math.isnan(up):
            copy_row(FOUND, FOUND_UP, work)
        evaluate(HERE, -1.0, -v, film, memory, work)
        here = points[HERE, F]
        found, more = search(-1.0, -target, -stop, film, table, least_slope, memory, work, bound, root)
        count += more
        if found > 0:
            count += plateau_start(-1.0, -target, here, -v, film, table, least_slope, memory, work, bound, root)
            down, down_residual = -points[FOUND, Z], -points[FOUND, F] - target
        elif not math.isnan(up):
            copy_row(FOUND_UP, FOUND, work)
    if not math.isnan(down):
        return True, down, down_residual, count
    return not math.isnan(up), up, up_residual, count


@njit(error_model="numpy")
def solve(
    target: float, v: float, film: Packed, settings: Settings, memory: Array, work: Work
) -> tuple[bool, float, float, int]:
    """Return (found, temperature, model minus target, evaluations) of the chosen solution, from v (degC) and a memory.

    The row FOUND and `here` of the work arrays hand `arrive` what is known at the solution, so that a smooth target
    costs no evaluation twice.
    """
    limits = settings[0]
    if limits[LEAST_SLOPE] >= 0.0 and film[0].shape[0] == 1:
        envelopes, radii, weights, code, par = film
        return solve_monotone(
            target,
            v,
            envelopes,
            radii,
            weights,
            code,
            par,
            limits,
            memory,
            work.points,
            work.held,
            work.parts,
            work.here,
        )
    return solve_any(target, v, film, settings, memory, work)


@lean
def arrive(
    v: float, v_before: float, envelopes: Array, radii: Array, memory: Array, points: Array, here: Array
) -> None:
    """Move the memory, in place, to the solution that `solve` left in the row FOUND, and note what is known there."""
    if v != v_before:
        side = 1.0 if v > v_before else -1.0
        here[0], here[1], here[2], here[3] = v, points[FOUND, D], points[FOUND, E1], side * points[FOUND, E2]
        if envelopes.shape[0] > 1:
            here[4] = 0.0
            play.advance(v, v_before, envelopes, radii, memory)
        else:
            here[4], here[5], here[6] = side, points[FOUND, GAMMA], points[FOUND, SLOPE]
            play.move(side, side * points[FOUND, GAMMA], radii, memory)


@njit(error_model="numpy")
def trajectory(
    targets: Array,
    v: float,
    memory: Array,
    film: Packed,
    settings: Settings,
    rows: Array,
    evaluations: NDArray[np.int64],
) -> float:
    """Fill temperatures for a sequence of outputs and return the last; `memory` is left there.

    Where a target is out of reach the film rests and the row is nan. rows: temperatures and residuals, shape (2,
    targets).
    """
    envelopes, radii, work = film[0], film[1], workspace(film)
    for i in range(targets.size):
        found, v_next, residual, count = solve(targets[i], v, film, settings, memory, work)
        rows[0, i], rows[1, i], evaluations[i] = v_next, residual, count
        if found:
            arrive(v_next, v, envelopes, radii, memory, work.points, work.here)
            v = v_next
    return v


@njit(error_model="numpy")
def solutions_on_branch(
    side: float,
    target: float,
    v: float,
    end: float,
    film: Packed,
    settings: Settings,
    memory: Array,
    roots: Array,
) -> tuple[int, int]:
    """Find all temperatures from v to `end` on one branch where the output is `target`: (how many, evaluations)."""
    work = workspace(film)
    evaluate(HERE, side, side * v, film, memory, work)
    found, count = search(
        side,
        side * target,
        side * end,
        film,
        settings[1],
        settings[0][LEAST_SLOPE],
        memory,
        work,
        settings[0][BOUND],
        roots,
    )
    for k in range(found):
        roots[k] *= side
    return found, count + 1


@njit(error_model="numpy")
def output_range(
    side: float, v: float, end: float, film: Packed, settings: Settings, memory: Array
) -> tuple[float, float]:
    """Return the least and the largest output on one branch from v (its limit there) to `end`."""
    work = workspace(film)
    extremes = np.empty(2)
    for k in range(2):
        sign = 1.0 - 2.0 * k
        evaluate(HERE, side, side * v, film, memory, work)
        extremes[k] = side * largest(sign, side, side * end, film, settings[1], memory, work, 0.1 * settings[0][BOUND])
    return extremes.min(), extremes.max()
