"""A search along one branch that proves what it skips: roots of F = target, and the largest F.

The interval between two evaluated points is settled when its bounds (`compensator.inverse.branch.bounds`) exclude the
target, or when F is proven monotone there, so that the ends tell whether a bracket holds exactly one root
(`compensator.inverse.bracket`). Else it is split: at the Newton step towards the target, at the extremum of the cubic
through both ends, where H alone must have come far enough (common envelopes), or in the middle. Intervals are settled
in the order of the walk, so that the first root found is the nearest. Bounds tighten with the square of the width, so
that an extremum that just reaches the target, or just does not, takes a few splits.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, lean
from compensator.inverse.bracket import DEEPEST, FOUND, HERE, TOP, bracketed, common_root, copy_row
from compensator.inverse.branch import (
    GAMMA,
    ROWS,
    F,
    Work,
    Z,
    bounds,
    common_step,
    evaluate,
    held_back,
    moving_weight,
    slope_onward,
)
from compensator.inverse.monotone_intervals import inside

NARROW: Final = 1e-12  # relative to |z|: no interval narrower than this is searched for a further pair of roots


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
