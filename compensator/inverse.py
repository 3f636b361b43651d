"""The inverse of the extended generalized PI model, solved for v directly on the branch it is on.

From a memory, every temperature above the present one is reached on the rising branch, every one below on the
falling branch (`compensator.branch`). A walk away from the present temperature proves, interval by interval, that
there is no solution, or that a bracket holds exactly one (`compensator.search`); so the solution nearest to the
present temperature is found whenever there is one, where D decreases faster than h increases too (paper, table 1),
and where there is none that is proven. Of several the `choice` is:

    "nearest"           the smallest change of temperature
    "fastest"           the shortest time, at the plate's rates of heating and cooling
    "fewest_reversals"  onward in the direction of `heading`, if there is a solution, else back

On one branch all three take the nearest. The bound that is kept: |model(inverse(u)) - u| <= `bound`, 1e-10 of the
output's unit, or 1e-12 of the model's span where that is more (outputs of hundreds). One *evaluation* is D and the
envelopes at one trial temperature, the present one included.

The paper's own iteration, eq (20), is `compensator.iteration`; where it cannot converge is told there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from compensator import play
from compensator.branch import E1, E2, GAMMA, SLOPE, D, F, Z, evaluate, place_common, workspace
from compensator.film import FilmModel, Initial, Memory, Packed, memory_owning, writable
from compensator.functions import Array, envelope, lean, memoryless
from compensator.pieces import SLOPE_ROW, pieces
from compensator.search import FOUND, FOUND_UP, HERE, common_root, copy_row, largest, search

LOW_DEGC, HIGH_DEGC = -50.0, 200.0
TOLERANCE = 5e-10  # of the output: 1e-9 decades are promised
SPAN_SHARE = 1e-12  # of the output's span, where that is more
MOST_SOLUTIONS: Final = 512

Choice = Literal["nearest", "fastest", "fewest_reversals"]
# what the compiled loops need beside the film: (limits and costs: see `Inverse.settings`, pieces of D)
Settings = tuple[Array, Array]
LOW, HIGH, BOUND, LEAST_SLOPE, UP_COST, DOWN_COST = range(6)
# what is known of the present temperature: v, D, D', D'', and of the branch last walked its side, G and G'
HERE_SIZE: Final = 7


@njit(cache=True, error_model="numpy")
def no_point() -> Array:
    """An empty note of the present temperature."""
    return np.full(HERE_SIZE, math.nan)


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
    """`solve` where D never decreases and envelopes are common: one branch, one bracket.

    Plain arrays and one exit: with tuples of arrays or a second return every call would count its references.
    """
    bound = limits[BOUND]
    if here[0] != v:
        here[0], here[4] = v, 0.0
        here[1], here[2], here[3] = memoryless(code, par, v)
    rest = here[1] + play.weighted_sum(weights, memory)
    found, v_found, residual, count = abs(rest - target) <= bound, v, rest - target, 1
    if not found:
        side, first, end = 1.0, 0, limits[HIGH]
        if target < rest:
            side, first, end = -1.0, 3, -limits[LOW]
        points[HERE, Z], points[HERE, D] = side * v, here[1]
        points[HERE, E1], points[HERE, E2] = here[2], side * here[3]
        if here[4] == side:
            points[HERE, GAMMA], points[HERE, SLOPE] = here[5], here[6]
        else:
            gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v)
            points[HERE, GAMMA], points[HERE, SLOPE] = side * gamma, slope
        place_common(HERE, side, radii, weights, memory, points, parts)
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
            v_found, residual = side * points[FOUND, Z], side * points[FOUND, F] - target
        elif side * v < end and points[HERE, F] - side * target <= bound:
            v_found = np.nextafter(v, side * math.inf)  # the jump ends at the target, one bit from here
            d0, d1, d2 = memoryless(code, par, v_found)
            gamma, slope = envelope(envelopes[0, first], envelopes[0, first + 1], envelopes[0, first + 2], v_found)
            points[FOUND, Z], points[FOUND, D], points[FOUND, E1] = side * v_found, d0, d1
            points[FOUND, E2], points[FOUND, GAMMA], points[FOUND, SLOPE] = side * d2, side * gamma, slope
            place_common(FOUND, side, radii, weights, memory, points, parts)
            found, residual = True, side * points[FOUND, F] - target
            count += 1
    return found, v_found if found else math.nan, residual, count


@njit(cache=True, error_model="numpy")
def solve(
    target: float,
    v: float,
    envelopes: Array,
    radii: Array,
    weights: Array,
    code: int,
    par: Array,
    limits: Array,
    table: Array,
    memory: Array,
    points: Array,
    gammas: Array,
    slopes: Array,
    held: Array,
    parts: Array,
    here: Array,
    root: Array,
) -> tuple[bool, float, float, int]:
    """(found, temperature, model minus target, evaluations) of the chosen solution, from v and a memory.

    The arguments are the film, the settings, the memory and the workspace, taken apart. `here` and the row FOUND tell
    `arrive` what is known at the solution, so that a smooth target costs no evaluation twice.
    """
    bound, least_slope = limits[BOUND], limits[LEAST_SLOPE]
    rest = memoryless(code, par, v)[0] + play.weighted_sum(weights, memory)
    count = 1
    if abs(rest - target) <= bound:
        return True, v, rest - target, count
    monotone = least_slope >= 0.0
    film, work = (envelopes, radii, weights, code, par), (points, gammas, slopes, held, parts)
    up, up_residual, down, down_residual = math.nan, math.nan, math.nan, math.nan
    if v < limits[HIGH] and (target > rest or not monotone):
        evaluate(HERE, 1.0, v, film, memory, work)
        found, more = search(1.0, target, limits[HIGH], film, table, least_slope, memory, work, bound, root)
        count += more
        if found > 0:
            up, up_residual = points[FOUND, Z], points[FOUND, F] - target
    stop = limits[LOW]
    if not math.isnan(up):
        stop = max(stop, v - (up - v) * limits[UP_COST] / limits[DOWN_COST])
    if v > stop and (target < rest or not monotone):
        if not math.isnan(up):
            copy_row(FOUND, FOUND_UP, work)
        evaluate(HERE, -1.0, -v, film, memory, work)
        found, more = search(-1.0, -target, -stop, film, table, least_slope, memory, work, bound, root)
        count += more
        if found > 0:
            down, down_residual = -points[FOUND, Z], -points[FOUND, F] - target
        elif not math.isnan(up):
            copy_row(FOUND_UP, FOUND, work)
    if not math.isnan(down):
        return True, down, down_residual, count
    return not math.isnan(up), up, up_residual, count


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


@njit(cache=True, error_model="numpy")
def trajectory(
    targets: Array,
    v: float,
    memory: Array,
    film: Packed,
    settings: Settings,
    rows: Array,
    evaluations: NDArray[np.int64],
) -> float:
    """Temperatures for a sequence of outputs; where a target is out of reach the film rests and the row is nan.

    rows: temperatures and residuals, shape (2, targets). Returns the last temperature; `memory` is left there.
    """
    here, root = no_point(), np.empty(1)
    envelopes, radii, weights, code, par = film
    limits, table = settings
    points, gammas, slopes, held, parts = workspace(film)
    monotone = limits[LEAST_SLOPE] >= 0.0 and envelopes.shape[0] == 1
    for i in range(targets.size):
        if monotone:
            found, v_next, residual, count = solve_monotone(
                targets[i], v, envelopes, radii, weights, code, par, limits, memory, points, held, parts, here
            )
        else:
            found, v_next, residual, count = solve(
                targets[i],
                v,
                envelopes,
                radii,
                weights,
                code,
                par,
                limits,
                table,
                memory,
                points,
                gammas,
                slopes,
                held,
                parts,
                here,
                root,
            )
        rows[0, i], rows[1, i], evaluations[i] = v_next, residual, count
        if found:
            arrive(v_next, v, envelopes, radii, memory, points, here)
            v = v_next
    return v


@njit(cache=True, error_model="numpy")
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
    """All temperatures from v to `end` on one branch where the output is `target`: (how many, evaluations)."""
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


@njit(cache=True, error_model="numpy")
def output_range(
    side: float, v: float, end: float, film: Packed, settings: Settings, memory: Array
) -> tuple[float, float]:
    """Least and largest output on one branch from v (its limit there) to `end`."""
    work = workspace(film)
    extremes = np.empty(2)
    for k in range(2):
        sign = 1.0 - 2.0 * k
        evaluate(HERE, side, side * v, film, memory, work)
        extremes[k] = side * largest(sign, side, side * end, film, settings[1], memory, work, 0.1 * settings[0][BOUND])
    return extremes.min(), extremes.max()


@dataclass(frozen=True)
class Solution:
    """One temperature for one wanted output.

    reachable: whether there is one within the limits, from this memory. temperature_degC: the solution, or where
    there is none the present temperature. residual: model minus target, in the output's unit. Where the target
    cannot be reached, intervals are the outputs that can, (low, high) each and in order - more than one where the
    order condition fails and the output jumps at a reversal -, interval is from the least to the largest of them,
    and nearest the near end; else nearest is the target. evaluations: of D and the envelopes at one temperature.
    """

    reachable: bool
    temperature_degC: float
    residual: float
    nearest: float
    interval: tuple[float, float] | None
    evaluations: int
    memory: Memory
    intervals: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Inverse:
    """The inverse of a film model within temperature limits (degC).

    Every solution keeps |model(inverse(u)) - u| <= bound, in the output's unit. choice: of several solutions.
    heating_K_per_s, cooling_K_per_s: the plate's rates (both > 0), for the choice "fastest".
    """

    model: FilmModel
    low_degC: float = LOW_DEGC
    high_degC: float = HIGH_DEGC
    tolerance: float = TOLERANCE
    choice: Choice = "nearest"
    heating_K_per_s: float = 1.0
    cooling_K_per_s: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low_degC) and self.low_degC < self.high_degC < math.inf):
            raise ValueError(f"limits: {self.low_degC!r} to {self.high_degC!r} degC: expected low < high")
        if self.choice not in ("nearest", "fastest", "fewest_reversals"):
            raise ValueError(f"choice: {self.choice!r} is none of nearest, fastest, fewest_reversals")
        if not (0.0 < self.heating_K_per_s < math.inf and 0.0 < self.cooling_K_per_s < math.inf):
            raise ValueError("heating_K_per_s, cooling_K_per_s: expected finite numbers > 0")

    @cached_property
    def pieces(self) -> Array:
        """Where D turns and bends within the limits, shape (3, points): `compensator.pieces`."""
        return pieces(self.model.memoryless, self.low_degC, self.high_degC)

    @cached_property
    def least_slope(self) -> float:
        """The least dD/dv within the limits (exact): where it is >= 0 the model is monotone."""
        return float(self.pieces[SLOPE_ROW].min())

    @cached_property
    def bound(self) -> float:
        """What |model(inverse(u)) - u| keeps, in the output's unit: `tolerance`, or SPAN_SHARE of the span."""
        span = float(self.model.weights.sum() + np.ptp(self.pieces[1]))
        return max(self.tolerance, SPAN_SHARE * span)

    def settings(self, heading: int = 0) -> Settings:
        """What the compiled loops need beside the film; heading: the sign of the last move, 0 if there was none."""
        up, down = 1.0, 1.0
        if self.choice == "fastest":
            up, down = 1.0 / self.heating_K_per_s, 1.0 / self.cooling_K_per_s
        elif self.choice == "fewest_reversals" and heading != 0:
            up, down = (1.0, 1e9) if heading > 0 else (1e9, 1.0)
        limits = np.array([self.low_degC, self.high_degC, self.bound, self.least_slope, up, down])
        return limits, self.pieces

    @cached_property
    def _settings(self) -> Settings:
        return self.settings()

    def solve(self, target: float, memory: Memory, heading: int = 0) -> Solution:
        """The chosen temperature at which the output is `target`, from this memory.

        heading: sign of the last move of the temperature, for the choice "fewest_reversals".
        """
        rows, counts = np.empty((2, 1)), np.empty(1, dtype=np.int64)
        plays = memory.plays.copy()
        settings = self.settings(heading) if heading else self._settings
        before = memory.input_degC
        v = trajectory(np.array([target]), before, plays, self.model.packed, settings, rows, counts)
        count = int(counts[0])
        if not math.isnan(rows[0, 0]):
            return Solution(True, v, float(rows[1, 0]), target, None, count, memory_owning(v, plays))
        intervals = self.reachable_intervals(memory)
        ends = [end for interval in intervals for end in interval]
        nearest = min(ends, key=lambda end: abs(end - target))
        residual = self.model.output_at(memory) - target
        return Solution(False, before, residual, nearest, (ends[0], ends[-1]), count, memory, intervals)

    def solutions(self, target: float, memory: Memory) -> tuple[Array, int]:
        """All temperatures (degC, increasing) at which the output is `target` from this memory, and evaluations.

        Where the output stands still at the target, one of the temperatures there.
        """
        v, film, plays = memory.input_degC, self.model.packed, memory.plays.copy()
        found: list[Array] = []
        count = 1
        at_rest = abs(self.model.output_at(memory) - target) <= self.bound
        if at_rest:
            found.append(np.array([v]))
        for side, end in ((-1.0, self.low_degC), (1.0, self.high_degC)):
            if (end - v) * side > 0.0:
                roots = np.empty(MOST_SOLUTIONS)
                n, more = solutions_on_branch(side, target, v, end, film, self._settings, plays, roots)
                found.append(roots[:n][np.abs(roots[:n] - v) > 1e-6] if at_rest else roots[:n])
                count += more - 1
        return np.sort(np.concatenate(found)) if found else np.empty(0), count

    def first(self, target: float, initial: Initial | None = None) -> Solution:
        """The lowest temperature at which a film with `initial` memory ("cooled" or "heated") has the output."""
        initial = initial or self.model.initial
        film, saturated = self.model.packed, self.model.saturated(initial)
        side, start, end = 1.0, self.low_degC, self.high_degC
        if initial == "cooled":
            side, start, end = -1.0, end, start
        roots = np.empty(1 if side > 0.0 or self.least_slope >= 0.0 else MOST_SOLUTIONS)
        found, count = solutions_on_branch(side, target, start, end, film, self._settings, saturated, roots)
        if found:
            v = float(roots[found - 1])
            memory = self.model.initial_memory(v, initial)
            return Solution(True, v, self.model.output_at(memory) - target, target, None, count, memory)
        low, high = output_range(side, start, end, film, self._settings, saturated)
        nearest = low if abs(target - low) <= abs(target - high) else high
        rest = self.model.initial_memory(self.low_degC, initial)
        return Solution(False, math.nan, math.nan, nearest, (low, high), count, rest, ((low, high),))

    def reachable_intervals(self, memory: Memory) -> tuple[tuple[float, float], ...]:
        """The outputs that can be reached from this memory without turning round, as intervals in order.

        There is more than one where the output jumps at a reversal: the order condition fails.
        """
        v, film, plays = memory.input_degC, self.model.packed, memory.plays.copy()
        here = self.model.output_at(memory)
        parts = [(here, here)]
        for side, end in ((-1.0, self.low_degC), (1.0, self.high_degC)):
            if (end - v) * side > 0.0:
                parts.append(output_range(side, v, end, film, self._settings, plays))
        parts.sort()
        merged = [parts[0]]
        for low, high in parts[1:]:
            if low <= merged[-1][1] + self.bound:
                merged[-1] = (merged[-1][0], max(merged[-1][1], high))
            else:
                merged.append((low, high))
        return tuple((float(low), float(high)) for low, high in merged)

    def reachable_interval(self, memory: Memory) -> tuple[float, float]:
        """Least and largest output that can be reached from this memory without turning round."""
        intervals = self.reachable_intervals(memory)
        return intervals[0][0], intervals[-1][1]

    def trajectory(self, targets: ArrayLike, memory: Memory) -> tuple[Array, Memory]:
        """Temperatures (degC) for a sequence of outputs, nan where one is out of reach, and the memory after."""
        wanted = writable(targets)
        rows, counts = np.empty((2, wanted.size)), np.empty(wanted.size, dtype=np.int64)
        plays = memory.plays.copy()
        v = trajectory(wanted, memory.input_degC, plays, self.model.packed, self._settings, rows, counts)
        return rows[0], Memory(v, plays)
