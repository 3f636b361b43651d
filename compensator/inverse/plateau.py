"""Where the output stands still at the target, the root that is nearest to where the film is.

On a plateau of F each temperature keeps the bound, and a bracket may close on any of them, its far end too. The near
end is found as the root of a target that half of the bound is taken off.
"""

from __future__ import annotations

from typing import Final

from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, lean
from compensator.inverse.bracket import FOUND, FOUND_UP, HERE, common_root
from compensator.inverse.branch import E1, GAMMA, SLOPE, F, Work, Z, evaluate, slope_onward
from compensator.inverse.search import search

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
    """Where the root in row FOUND stands on a plateau, put the plateau's near end there instead; evaluations taken.

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
    """`plateau_start` for common envelopes and a D that never falls; HERE and `held` are as `common_root` left them."""
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
