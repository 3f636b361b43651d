"""The inverse of the extended generalized PI model, solved for v directly on the branch it is on.

From a memory, every temperature above the present one is reached on the rising branch, every one below on the
falling branch, and along a branch the hysteretic part h(v) = sum_j p_j w_j(v) never decreases in v. So on any
interval [x, y] of a branch

    f(v) = D(v) + h(v)  lies in  [min D + h(x), max D + h(y)],        f'(v) >= min D' + min h'

and a search that walks away from the present temperature can prove, interval by interval, that there is no
solution, or that f increases there and a bracket holds exactly one. The solution nearest to the present temperature
is therefore found whenever there is one; where D decreases faster than h increases, too (paper, table 1).

Inside a bracket the step is exact in the operators' kinks: with g = gamma(v) the hysteretic part is piecewise linear
in g and D is expanded to second order; a step that leaves the bracket or gains too little is replaced by a
bisection, so that it cannot fail to converge. One *evaluation* is D and the envelopes at one trial temperature.

The paper's own iteration, eq (20), is `compensator.iteration`; where it cannot converge is told there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from compensator import play
from compensator.film import FilmModel, Initial, Memory, Packed, writable
from compensator.functions import (
    Array,
    envelope,
    envelope_inverse,
    memoryless,
    memoryless_range,
    memoryless_slope_range,
)

LOW_DEGC, HIGH_DEGC = -50.0, 200.0
TOLERANCE = 1e-10  # of the output: the bound on |model(inverse(u)) - u| that a solution keeps
NARROW_K = 1e-9  # no interval below this width is searched for a further pair of solutions
SEGMENTS = 256


@njit(cache=True)
def _evaluate(
    side: int, v: float, film: Packed, memory: Array
) -> tuple[float, float, float, float, float, float]:
    """(f, D', D'', h, dh/dv, sum of moving weights) at v on a branch: side +1 rising, -1 falling."""
    envelopes, radii, weights, code, par = film
    d0, d1, d2 = memoryless(code, par, v)
    first = 0 if side > 0 else 3
    h, dh, moving = 0.0, 0.0, 0.0
    gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
    mixed = envelopes.shape[0] > 1
    for j in range(radii.size):
        if mixed and j > 0:
            gamma, slope = envelope(envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2], v)
        w = gamma - side * radii[j]
        if side * (w - memory[j]) > 0.0:
            h += weights[j] * w
            dh += weights[j] * slope
            moving += weights[j]
        else:
            h += weights[j] * memory[j]
    return d0 + h, d1, d2, h, dh, moving


@njit(cache=True)
def _kinked_step(
    side: int, x: float, f: float, d1: float, u: float, film: Packed, memory: Array
) -> float:
    """The v where D linearized at x plus the operators, each with its envelope linearized at x, reaches u.

    The sum is piecewise linear and convex (side +1) or concave (-1) in v, so that Newton's method, started where
    every operator moves, walks to the root in finitely many steps, one way.
    """
    envelopes, radii, weights = film[0], film[1], film[2]
    first = 0 if side > 0 else 3
    z = math.inf
    for _ in range(radii.size + 2):
        total, slope_sum = 0.0, d1
        gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], x)
        for j in range(radii.size):
            if envelopes.shape[0] > 1 and j > 0:
                gamma, slope = envelope(envelopes[j, first], envelopes[j, first + 1], envelopes[j, first + 2], x)
            here = side * max(side * gamma - radii[j], side * memory[j])
            w = gamma - side * radii[j]
            if z == math.inf or side * (w + slope * z - memory[j]) > 0.0:
                total += weights[j] * (w - here)
                slope_sum += weights[j] * slope
            else:
                total += weights[j] * (memory[j] - here)
        if slope_sum <= 0.0:
            return math.nan
        z_next = (u - f - total) / slope_sum
        if z != math.inf and side * (z_next - z) >= -1e-15 * (1.0 + abs(z)):
            return x + z_next
        z = z_next
    return x + z


@njit(cache=True)
def _common_step(
    side: int,
    x: float,
    f: float,
    d1: float,
    d2: float,
    h: float,
    u: float,
    film: Packed,
    memory: Array,
) -> float:
    """The same where all operators share their envelopes: exact in gamma, D to second order."""
    envelopes, radii, weights = film[0], film[1], film[2]
    first = 0 if side > 0 else 3
    code, a, b = envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2]
    gamma, slope = envelope(code, a, b, x)
    if slope <= 0.0:
        return math.nan
    kappa = d1 / slope
    rest = u - (f - h) + kappa * gamma  # kappa g + sum_j p_j w_j(g) = rest
    g, started, moving = 0.0, False, 0.0
    for _ in range(radii.size + 2):
        total, moving = 0.0, 0.0
        for j in range(radii.size):
            w = g - side * radii[j]
            if not started or side * (w - memory[j]) > 0.0:
                total -= weights[j] * side * radii[j]
                moving += weights[j]
            else:
                total += weights[j] * memory[j]
        if moving + kappa <= 0.0:
            return math.nan
        g_next = (rest - total) / (moving + kappa)
        done = started and side * (g_next - g) >= -1e-15 * (1.0 + abs(g))
        g, started = g_next, True
        if done:
            break
    v = envelope_inverse(code, a, b, g)
    if not math.isfinite(v):
        return math.nan
    z = v - x
    slope_there = a if code == 0.0 else a * (1.0 - g * g)
    error = d1 * z + 0.5 * d2 * z * z - kappa * (g - gamma)
    total_slope = d1 + d2 * z + moving * slope_there
    if total_slope > 0.0:
        v -= error / total_slope
    return v


@njit(cache=True)
def _bracketed(
    side: int,
    u: float,
    x: float,
    at_x: tuple[float, float, float, float, float, float],
    end: float,
    film: Packed,
    memory: Array,
    tolerance: float,
) -> tuple[bool, float, float, int]:
    """The root of f = u between x and end, where f is known to increase: (found, v, f(v) - u, evaluations)."""
    count = 0
    f, d1, d2, h, _, _ = at_x
    near, far = x, end  # f at near is on the side of x, f at far beyond u or not yet known
    far_known = False
    upward = end > x
    gap_before = math.inf
    for _ in range(200):
        gap = abs(f - u)
        if gap <= tolerance:
            return True, x, f - u, count
        if abs(far - near) <= 4e-16 * max(abs(far), abs(near)):
            return far_known, x, f - u, count
        trial = math.nan
        if gap <= 0.5 * gap_before:
            if film[0].shape[0] == 1:
                trial = _common_step(side, x, f, d1, d2, h, u, film, memory)
            if not (min(near, far) < trial < max(near, far)):
                trial = _kinked_step(side, x, f, d1, u, film, memory)
        gap_before = gap
        if not (min(near, far) < trial < max(near, far)):
            gap_before = math.inf
            if not far_known:
                trial = far
            else:
                trial = 0.5 * (near + far)
        x = trial
        f, d1, d2, h, _, _ = _evaluate(side, x, film, memory)
        count += 1
        if (f < u) == upward:
            if x == end and abs(f - u) > tolerance:
                return False, x, f - u, count
            near = x
        else:
            far, far_known = x, True
    return False, x, f - u, count


@njit(cache=True)
def search(
    side: int,
    u: float,
    start: float,
    end: float,
    film: Packed,
    memory: Array,
    least_slope: float,
    tolerance: float,
) -> tuple[bool, float, float, int]:
    """The solution of f = u nearest to `start` on the way to `end` along one branch.

    least_slope: a lower bound of dD/dv over the whole range. Returns (found, v, f(v) - u, evaluations).
    """
    at_x = _evaluate(side, start, film, memory)
    count = 1
    if abs(at_x[0] - u) <= tolerance or start == end:
        return abs(at_x[0] - u) <= tolerance, start, at_x[0] - u, count
    envelopes, code, par = film[0], film[3], film[4]
    first = 0 if side > 0 else 3
    flattest = math.inf  # the least slope of any envelope over the whole range
    for row in range(envelopes.shape[0]):
        flattest = min(flattest, envelopes[row, first + 1] if envelopes[row, first] == 0.0 else 0.0)
    onward = (end > start) == (side > 0)  # walking this way, operators only ever start to move
    upward = end > start
    x = start
    ends = np.empty(SEGMENTS)
    values = np.empty((SEGMENTS, 6))
    known = np.zeros(SEGMENTS, dtype=np.bool_)
    ends[0], depth = end, 1
    while depth > 0:
        y = ends[depth - 1]
        increasing = least_slope >= 0.0 or (onward and at_x[5] * flattest + least_slope >= 0.0)
        possible = True
        if increasing:
            possible = (at_x[0] < u) == upward
        else:
            if not known[depth - 1]:
                at = _evaluate(side, y, film, memory)
                for k in range(6):
                    values[depth - 1, k] = at[k]
                known[depth - 1] = True
                count += 1
            at_y = values[depth - 1]
            low, high = min(x, y), max(x, y)
            d_x, d_y = at_x[0] - at_x[3], at_y[0] - at_y[3]
            if upward:
                least, most = memoryless_range(code, par, low, high, d_x, d_y)
                possible = least + at_x[3] <= u + tolerance and u - tolerance <= most + at_y[3]
            else:
                least, most = memoryless_range(code, par, low, high, d_y, d_x)
                possible = least + at_y[3] <= u + tolerance and u - tolerance <= most + at_x[3]
            if possible:
                slope = memoryless_slope_range(code, par, low, high)[0]
                rise = min(at_x[5], at_y[5]) * _least_envelope_slope(film[0], first, low, high)
                if slope + rise >= 0.0:
                    increasing = True
                    possible = ((at_x[0] < u) == upward) and ((at_y[0] < u) != upward)
                    if abs(at_y[0] - u) <= tolerance:
                        possible = True
        if possible and not increasing:
            if abs(y - x) > NARROW_K and depth < SEGMENTS:
                ends[depth], known[depth] = 0.5 * (x + y), False
                depth += 1
                continue
            possible = (at_x[0] < u) != (values[depth - 1, 0] < u)
            increasing = True
        if possible:
            found, v, residual, more = _bracketed(side, u, x, at_x, y, film, memory, tolerance)
            count += more
            if found:
                return True, v, residual, count
        depth -= 1
        x = y
        if depth > 0:
            if known[depth]:
                row = values[depth]
                at_x = (row[0], row[1], row[2], row[3], row[4], row[5])
            else:
                at_x = _evaluate(side, x, film, memory)
                count += 1
    return False, math.nan, math.nan, count


@njit(cache=True)
def _least_envelope_slope(envelopes: Array, first: int, low: float, high: float) -> float:
    """The least slope of any envelope on [low, high]: a tanh is steepest in its middle, so at an end."""
    least = math.inf
    for row in range(envelopes.shape[0]):
        code, a, b = envelopes[row, first], envelopes[row, first + 1], envelopes[row, first + 2]
        least = min(least, envelope(code, a, b, low)[1], envelope(code, a, b, high)[1])
    return least


@njit(cache=True)
def solve(
    u: float,
    v_before: float,
    film: Packed,
    memory: Array,
    low: float,
    high: float,
    least_slope: float,
    tolerance: float,
) -> tuple[bool, float, float, int]:
    """The temperature nearest to v_before, on either branch, at which the output is u."""
    rest = memoryless(film[3], film[4], v_before)[0] + play.weighted_sum(film[2], memory)
    count = 1
    if abs(rest - u) <= tolerance:
        return True, v_before, rest - u, count
    up = (False, math.nan, math.nan, 0)
    down = (False, math.nan, math.nan, 0)
    monotone = least_slope >= 0.0
    if v_before < high and (u > rest or not monotone):
        up = search(1, u, v_before, high, film, memory, least_slope, tolerance)
        count += up[3] - 1  # the present temperature is counted once
    if v_before > low and (u < rest or not monotone):
        stop = low
        if up[0]:
            stop = max(low, v_before - (up[1] - v_before))
        if stop < v_before:
            down = search(-1, u, v_before, stop, film, memory, least_slope, tolerance)
            count += down[3] - 1
    if up[0] and (not down[0] or up[1] - v_before <= v_before - down[1]):
        return True, up[1], up[2], count
    return down[0], down[1], down[2], count


@njit(cache=True)
def _extreme(
    sign: int,
    side: int,
    start: float,
    end: float,
    film: Packed,
    memory: Array,
    tolerance: float,
) -> float:
    """The largest (sign +1) or smallest (-1) output on one branch between two temperatures, to `tolerance`."""
    code, par = film[3], film[4]
    at_x, at_y = _evaluate(side, start, film, memory), _evaluate(side, end, film, memory)
    best = max(sign * at_x[0], sign * at_y[0])
    left, right = np.empty(SEGMENTS), np.empty(SEGMENTS)
    left[0], right[0], depth = min(start, end), max(start, end), 1
    while depth > 0:
        depth -= 1
        x, y = left[depth], right[depth]
        f_x, _, _, h_x, _, _ = _evaluate(side, x, film, memory)
        f_y, _, _, h_y, _, _ = _evaluate(side, y, film, memory)
        best = max(best, sign * f_x, sign * f_y)
        least, most = memoryless_range(code, par, x, y, f_x - h_x, f_y - h_y)
        bound = most + h_y if sign > 0 else -(least + h_x)
        slopes = memoryless_slope_range(code, par, x, y)
        if bound <= best + tolerance or slopes[0] >= 0.0 or y - x <= NARROW_K or depth + 2 > SEGMENTS:
            continue
        middle = 0.5 * (x + y)
        left[depth], right[depth] = x, middle
        left[depth + 1], right[depth + 1] = middle, y
        depth += 2
    return sign * best


@njit(cache=True)
def trajectory(
    targets: Array,
    v_before: float,
    memory: Array,
    film: Packed,
    low: float,
    high: float,
    least_slope: float,
    tolerance: float,
    temperatures: Array,
    residuals: Array,
    evaluations: NDArray[np.int64],
) -> float:
    """Temperatures for a sequence of outputs; where a target is out of reach the film rests and the row is nan."""
    for i in range(targets.size):
        found, v, residual, count = solve(targets[i], v_before, film, memory, low, high, least_slope, tolerance)
        evaluations[i] = count
        residuals[i] = residual
        temperatures[i] = v if found else math.nan
        if found:
            play.advance(v, v_before, film[0], film[1], memory)
            v_before = v
    return v_before


@dataclass(frozen=True)
class Solution:
    """One temperature for one wanted output.

    reachable: whether there is one within the limits, from this memory. temperature_degC: the solution, or where
    there is none the present temperature. residual: model minus target, in the output's unit. interval: the outputs
    that can be reached, (low, high); computed where the target cannot be. nearest: its near end, else the target.
    evaluations: of D and the envelopes at one trial temperature.
    """

    reachable: bool
    temperature_degC: float
    residual: float
    nearest: float
    interval: tuple[float, float] | None
    evaluations: int
    memory: Memory


@dataclass(frozen=True)
class Inverse:
    """The inverse of a film model within temperature limits (degC).

    Every solution keeps |model(inverse(u)) - u| <= tolerance, in the output's unit.
    """

    model: FilmModel
    low_degC: float = LOW_DEGC
    high_degC: float = HIGH_DEGC
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low_degC) and self.low_degC < self.high_degC < math.inf):
            raise ValueError(f"limits: {self.low_degC!r} to {self.high_degC!r} degC: expected low < high")

    @cached_property
    def least_slope(self) -> float:
        """A lower bound of dD/dv within the limits: where it is >= 0 the model is monotone without further proof."""
        return float(memoryless_slope_range(self.model.memoryless.code, self.model.memoryless_array, self.low_degC, self.high_degC)[0])

    def solve(self, target: float, memory: Memory) -> Solution:
        """The temperature nearest to the present one at which the output is `target`, from this memory."""
        found, v, residual, count = solve(
            target,
            memory.input_degC,
            self.model.packed,
            memory.plays.copy(),
            self.low_degC,
            self.high_degC,
            self.least_slope,
            self.tolerance,
        )
        if found:
            return Solution(True, v, residual, target, None, count, self._advanced(v, memory))
        low, high = self.reachable_interval(memory)
        here = self.model.output_at(memory)
        nearest = low if abs(target - low) <= abs(target - high) else high
        if low <= target <= high:  # a gap: the order condition fails, the output jumps at a reversal
            nearest = here
        return Solution(False, memory.input_degC, here - target, nearest, (low, high), count, memory)

    def first(self, target: float, initial: Initial | None = None) -> Solution:
        """The lowest temperature at which a film with `initial` memory ("cooled" or "heated") has the output."""
        initial = initial or self.model.initial
        side = -1 if initial == "cooled" else 1
        found, v, residual, count = search(
            side,
            target,
            self.low_degC,
            self.high_degC,
            self.model.packed,
            self.model.saturated(initial),
            self.least_slope,
            self.tolerance,
        )
        if found:
            return Solution(True, v, residual, target, None, count, self.model.initial_memory(v, initial))
        saturated = self.model.saturated(initial)
        ends = (self.low_degC, self.high_degC, self.model.packed, saturated, self.tolerance)
        low, high = _extreme(-1, side, *ends), _extreme(1, side, *ends)
        nearest = low if abs(target - low) <= abs(target - high) else high
        rest = self.model.initial_memory(self.low_degC, initial)
        return Solution(False, math.nan, math.nan, nearest, (low, high), count, rest)

    def reachable_interval(self, memory: Memory) -> tuple[float, float]:
        """Least and largest output that can be reached from this memory without turning round."""
        v = memory.input_degC
        here = self.model.output_at(memory)
        least, most = here, here
        film, plays = self.model.packed, memory.plays.copy()
        for side, end in ((1, self.high_degC), (-1, self.low_degC)):
            if (end - v) * side > 0.0:
                least = min(least, _extreme(-1, side, v, end, film, plays, self.tolerance))
                most = max(most, _extreme(1, side, v, end, film, plays, self.tolerance))
        return least, most

    def trajectory(self, targets: ArrayLike, memory: Memory) -> tuple[Array, Memory]:
        """Temperatures (degC) for a sequence of outputs, nan where one is out of reach, and the memory after."""
        wanted = writable(targets)
        temperatures, residuals = np.empty(wanted.size), np.empty(wanted.size)
        counts = np.empty(wanted.size, dtype=np.int64)
        plays = memory.plays.copy()
        v = trajectory(
            wanted,
            memory.input_degC,
            plays,
            self.model.packed,
            self.low_degC,
            self.high_degC,
            self.least_slope,
            self.tolerance,
            temperatures,
            residuals,
            counts,
        )
        return temperatures, Memory(v, plays)

    def _advanced(self, v: float, memory: Memory) -> Memory:
        plays = memory.plays.copy()
        play.advance(v, memory.input_degC, self.model.packed[0], self.model.packed[1], plays)
        return Memory(v, plays)
