"""The chosen temperature from a memory, in compiled loops: the nearer of the rising and the falling branch's solution.

`compensator.inverse.inverse` says what the choice means, and what is kept. One *evaluation* is D and the envelopes at
one trial temperature, the present one included.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis import play
from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, envelope, lean, memoryless
from compensator.inverse.bracket import FOUND, FOUND_UP, HERE, common_root, copy_row
from compensator.inverse.branch import E1, E2, GAMMA, SLOPE, D, F, Work, Z, evaluate, place_common, workspace
from compensator.inverse.search import FLAT_K, largest, plateau_start, plateau_start_common, search

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
