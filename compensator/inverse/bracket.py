"""The one root of F = target inside a bracket that is proven to hold exactly one.

The step is exact in the operators' kinks (`compensator.inverse.branch.common_step`, `kinked_step`); one that leaves the
bracket or gains too little is replaced by one that halves it.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from compensator.hysteresis import play
from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, envelope, envelope_inverse, lean, memoryless
from compensator.inverse.branch import (
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
    evaluate,
    kinked_step,
    level,
    mixed_step,
    slope_onward,
)

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
