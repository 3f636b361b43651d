"""A search along one branch that proves what it skips: roots of F = target, and the largest F.

The interval between two evaluated points is settled when its bounds (`compensator.branch.bounds`) exclude the
target, or when F is proven monotone there, so that the ends tell whether a bracket holds exactly one root. Else it
is split: at the Newton step towards the target, at the extremum of the cubic through both ends, where H alone must
have come far enough (common envelopes), or in the middle. Intervals are settled in the order of the walk, so that
the first root found is the nearest. Bounds tighten with the square of the width, so that an extremum that just
reaches the target, or just does not, takes a few splits.

Inside a bracket the step is exact in the operators' kinks (`common_step`, `kinked_step`); one that leaves the
bracket or gains too little is replaced by one that halves it.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit

from compensator import play
from compensator.branch import (
    E1,
    E2,
    GAMMA,
    ROWS,
    SLOPE,
    D,
    F,
    H,
    Work,
    Z,
    bounds,
    common_step,
    evaluate,
    held_back,
    kinked_step,
    level,
    mixed_step,
    moving_weight,
    slope_onward,
)
from compensator.film import Packed
from compensator.functions import Array, envelope, envelope_inverse, lean, memoryless
from compensator.pieces import inside

NARROW: Final = 1e-12  # relative to |z|: no interval narrower than this is searched for a further pair of roots
# rows of the workspace: typed, as a literal would compile each function once more for every row
HERE: Any = np.int64(0)  # the point that the walk has come to
TOP: Any = np.int64(1)  # the first of the far ends still to be walked to
TRIAL: Any = np.int64(ROWS - 1)
FOUND: Any = np.int64(ROWS - 2)
FOUND_UP: Any = np.int64(ROWS - 3)
DEEPEST: Final = ROWS - 5


@lean
def copy_row(source: int, sink: int, work: Work) -> None:
    """A point from one row of the workspace to another."""
    points, gammas, slopes = work[0], work[1], work[2]
    for k in range(points.shape[1]):
        points[sink, k] = points[source, k]
    if gammas.shape[0] > 1:
        for j in range(gammas.shape[1]):
            gammas[sink, j], slopes[sink, j] = gammas[source, j], slopes[source, j]


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
    """The one root of F = target from a point up to `far`, where F is known to increase: (found, evaluations).

    far_f: F there, nan where it is not evaluated; it may then turn out not to reach the target. e_increasing:
    whether E increases, too. Common envelopes. The root is left in the row FOUND. Plain arrays, not the tuples of
    the other functions: taking an array out of a tuple counts a reference, which would double the time.
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
        if gap <= tolerance or far - near <= 4e-16 * max(abs(far), abs(near)) or count >= 200:
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
                if math.isnan(far_f):
                    trial = end
                else:
                    trial = 0.5 * (near + far)
                    if fallbacks % 3 == 1:
                        share = near + (far - near) * (target - near_f) / (far_f - near_f)
                        trial = share if near < share < far else trial
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
    """The same for any envelopes and for falling F: the root between two points; far's F is nan if not evaluated."""
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
        if gap <= tolerance or far - near <= 4e-16 * max(abs(far), abs(near)) or count >= 200:
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
            if math.isnan(far_f):
                trial = end
            else:
                trial = 0.5 * (near + far)
                if fallbacks % 3 == 1:
                    share = near + (far - near) * (target - near_f) / (far_f - near_f)
                    trial = share if near < share < far else trial
        evaluate(TRIAL, side, trial, film, memory, work)
        count += 1
        f = points[TRIAL, F]
        if (f < target) == increasing:
            near, near_f = trial, f
        else:
            far, far_f = trial, f
    copy_row(TRIAL, FOUND, work)
    return abs(points[FOUND, F] - target) <= tolerance or not math.isnan(far_f), count


@lean
def extremum(x: int, y: int, sign: float, side: float, film: Packed, memory: Array, work: Work) -> float:
    """Where the cubic through both points has its largest (sign +1) or smallest (-1) value; nan if at an end."""
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
    """Where to divide the interval between two points; known: (least F', largest F', least E, largest E)."""
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


@njit(cache=True, error_model="numpy")
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
    """Roots of F = target from the point in row HERE to z = end, nearest first: (how many, evaluations).

    As many are looked for as `roots` has places; the last is left in the row FOUND. The row HERE is the limit of the
    branch at the present temperature: where the output jumps at a reversal, the first root may lie one bit beyond.
    least_slope: of dD/dv within the limits.
    """
    points, envelopes = work[0], film[0]
    first = 0 if side > 0.0 else 3
    found, count = 0, 0
    if abs(points[HERE, F] - target) <= tolerance:
        evaluate(FOUND, side, np.nextafter(points[HERE, Z], math.inf), film, memory, work)
        count += 1
        if abs(points[FOUND, F] - target) <= tolerance:
            roots[0] = points[FOUND, Z]
            found = 1
            if roots.size == 1:
                return found, count
    e_increasing = least_slope >= 0.0
    monotone = e_increasing
    if not monotone and envelopes.shape[0] == 1 and envelopes[0, first] == 0.0:
        weight = moving_weight(HERE, side, film, memory, work)
        monotone = weight * envelopes[0, first + 1] + least_slope >= 0.0
    points[TOP, Z], points[TOP, F] = end, math.nan
    if monotone:
        if points[HERE, F] > target:
            return found, count
        if envelopes.shape[0] == 1:
            reached, more = common_root(
                HERE,
                end,
                math.nan,
                e_increasing,
                side,
                target,
                *film,
                memory,
                points,
                work[3],
                work[4],
                tolerance,
            )
        else:
            reached, more = bracketed(HERE, TOP, side, target, film, memory, work, tolerance)
        if reached and (found == 0 or points[FOUND, Z] - roots[0] > 1e-6):
            roots[found] = points[FOUND, Z]
            found += 1
        return found, count + more
    evaluated, stale = np.zeros(ROWS, dtype=np.bool_), np.zeros(ROWS, dtype=np.int64)
    depth = TOP
    while depth > 0:
        p, q = points[HERE], points[depth]
        if not evaluated[depth]:
            trial = math.nan
            if envelopes.shape[0] == 1:
                trial = common_step(HERE, target, side, film, memory, work)
            if not p[Z] < trial < q[Z]:
                slope = slope_onward(HERE, side, film, memory, work)
                if slope * (target - p[F]) > 0.0:
                    trial = p[Z] + (target - p[F]) / slope
            if p[Z] < trial < q[Z] - 1e-3 * (q[Z] - p[Z]) and stale[depth] == 0:
                stale[depth] = 1  # once
                depth += 1
                evaluate(depth, side, trial, film, memory, work)
                evaluated[depth], stale[depth] = True, 0
            else:
                evaluate(depth, side, q[Z], film, memory, work)
                evaluated[depth], stale[depth] = True, 0
            count += 1
            continue
        width = q[Z] - p[Z]
        least, most, floor, ceiling, least_e, most_e = bounds(HERE, depth, side, film, table, memory, work)
        at_end = abs(q[F] - target) <= tolerance
        passes = (p[F] < target) != (q[F] < target)
        accepted = False
        settled = ceiling < target or floor > target
        if not settled:
            narrow = width <= NARROW * max(abs(p[Z]), 1.0) or depth >= DEEPEST
            settled = least >= 0.0 or most <= 0.0 or narrow
            touches = at_end and (ceiling <= target + tolerance if p[F] < target else floor >= target - tolerance)
            if (settled and at_end) or touches:
                copy_row(depth, FOUND, work)
                settled = accepted = True
            elif settled and passes:
                if p[F] < target and envelopes.shape[0] == 1:
                    accepted, more = common_root(
                        HERE,
                        q[Z],
                        q[F],
                        e_increasing,
                        side,
                        target,
                        *film,
                        memory,
                        points,
                        work[3],
                        work[4],
                        tolerance,
                    )
                else:
                    accepted, more = bracketed(HERE, depth, side, target, film, memory, work, tolerance)
                count += more
        if settled:
            if accepted and (found == 0 or points[FOUND, Z] - roots[found - 1] > 1e-6):
                roots[found] = points[FOUND, Z]
                found += 1
                if found == roots.size:
                    return found, count
            copy_row(depth, HERE, work)
            depth -= 1
            continue
        trial = split(
            HERE, depth, target, stale[depth], (least, most, least_e, most_e), side, film, table, memory, work
        )
        if not p[Z] < trial < q[Z]:
            trial = 0.5 * (p[Z] + q[Z])
        evaluate(depth + 1, side, trial, film, memory, work)
        evaluated[depth + 1] = True
        before = stale[depth]
        stale[depth] = before + 1 if points[depth, Z] - trial > 0.6 * width else 0
        stale[depth + 1] = before + 1 if trial - p[Z] > 0.6 * width else 0
        count += 1
        depth += 1
    return found, count


@njit(cache=True, error_model="numpy")
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
    """The largest (sign +1) or smallest (-1) F from the point in row HERE to z = end, to `tolerance`."""
    points = work[0]
    best = sign * points[HERE, F]
    evaluate(TOP, side, end, film, memory, work)
    depth, stale = TOP, np.zeros(ROWS, dtype=np.int64)
    while depth > 0:
        p, q = points[HERE], points[depth]
        best = max(best, sign * q[F])
        width = q[Z] - p[Z]
        least, most, floor, ceiling, least_e, most_e = bounds(HERE, depth, side, film, table, memory, work)
        bound = ceiling if sign > 0.0 else -floor
        if (
            bound <= best + tolerance
            or least >= 0.0
            or most <= 0.0
            or width <= NARROW * max(abs(p[Z]), 1.0)
            or depth >= DEEPEST
        ):
            copy_row(depth, HERE, work)
            depth -= 1
            continue
        trial = split(
            HERE,
            depth,
            sign * (best + tolerance),
            stale[depth],
            (least, most, least_e, most_e),
            side,
            film,
            table,
            memory,
            work,
        )
        if not p[Z] < trial < q[Z]:
            trial = 0.5 * (p[Z] + q[Z])
        evaluate(depth + 1, side, trial, film, memory, work)
        before = stale[depth]
        stale[depth] = before + 1 if points[depth, Z] - trial > 0.6 * width else 0
        stale[depth + 1] = before + 1 if trial - p[Z] > 0.6 * width else 0
        best = max(best, sign * points[depth + 1, F])
        depth += 1
    return float(sign * best)
