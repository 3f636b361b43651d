"""The inverse of the extended generalized PI model, solved for v directly on the branch it is on.

From a memory, every temperature above the present one is reached on the rising branch, every one below on the falling
branch (`compensator.inverse.branch`). A walk away from the present temperature proves, interval by interval, that there
is no solution, or that a bracket holds exactly one (`compensator.inverse.search`); so the solution nearest to the
present temperature is found whenever there is one, where D decreases faster than h increases too (paper, table 1), and
where there is none that is proven. Of several the nearest is taken, or with a `heading` the next one that way, if there
is one. The bound that is kept: |model(inverse(u)) - u| <= `bound`, 1e-10 of the output's unit, or 1e-12 of the model's
span where that is more (outputs of hundreds). One *evaluation* is D and the envelopes at one trial temperature, the
present one included.

A plan of a whole course, `branch_plan`: where D falls faster than the operators rise a target can have several
temperatures, and the nearest may lead to where the next target has none. So several courses are followed side by side,
each with its own memory. Of those that reach the last target the one is taken that the plate is least late on, and of
equals the one that moves least. It is a beam search: at each target the `BEAM` best courses go on, no two of them
within `APART_K` of each other, and the coldest and the hottest: where two ways part they are near each other, and the
one that pays later costs more now.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.film import FilmModel, Initial, Memory, memory_owning, writable
from compensator.hysteresis.functions import Array
from compensator.inverse.branch import SLOPE_ROW, pieces
from compensator.inverse.search import BOUND, FLAT_K, Settings, output_range, solutions_on_branch, trajectory

LOW_DEGC, HIGH_DEGC = -50.0, 200.0  # limits of the search where none are given: no VO2 film switches beyond
TOLERANCE = 5e-10  # of the output: 1e-9 decades are promised
SPAN_SHARE = 1e-12  # of the output's span, where that is more
MOST_SOLUTIONS: Final = 512


@dataclass(frozen=True)
class Solution:
    """Temperature for a wanted output.

    reachable: True if there is one within the limits, from this memory. temperature_degC: the solution, or the present
    temperature if there is none. residual: model minus target, in the output's unit. If the target cannot be reached,
    `intervals` are the outputs that can, (low, high) each and in order (more than one where the order condition fails
    and the output jumps at a reversal), `interval` is from the least to the largest of them, and `nearest` the near end
    (nan for a target of nan); else nearest is the target. evaluations: of D and the envelopes at one temperature.
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
    """Inverse of a film model within temperature limits (degC).

    Every solution keeps |model(inverse(u)) - u| <= bound, in the output's unit.
    """

    model: FilmModel
    low_degC: float = LOW_DEGC
    high_degC: float = HIGH_DEGC
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low_degC) and self.low_degC < self.high_degC < math.inf):
            raise ValueError(f"limits: {self.low_degC!r} to {self.high_degC!r} degC: expected low < high")

    @cached_property
    def pieces(self) -> Array:
        """Return the temperatures where D turns and bends, with D and dD/dv there, shape (3, points)."""
        return pieces(self.model.memoryless, self.low_degC, self.high_degC)

    @cached_property
    def least_slope(self) -> float:
        """Return the least dD/dv within the limits (exact): if it is >= 0 the model is monotone."""
        return float(self.pieces[SLOPE_ROW].min())

    @cached_property
    def bound(self) -> float:
        """Return the bound of |model(inverse(u)) - u|, in the output's unit: `tolerance`, or SPAN_SHARE of the span."""
        span = float(self.model.weights.sum() + np.ptp(self.pieces[1]))
        return max(self.tolerance, SPAN_SHARE * span)

    def settings(self, heading: int = 0) -> Settings:
        """Return what the compiled loops need in addition to the film; heading: 1 up, -1 down, 0 to the nearest."""
        up, down = 1e9 if heading < 0 else 1.0, 1e9 if heading > 0 else 1.0
        limits = np.array([self.low_degC, self.high_degC, self.bound, self.least_slope, up, down])
        return limits, self.pieces

    @cached_property
    def _settings(self) -> Settings:
        return self.settings()

    def solve(self, target: float, memory: Memory, heading: int = 0) -> Solution:
        """Return the temperature at which the output is `target`, from this memory: the nearest, or with a heading (1
        up, -1 down) the next that way, if there is one."""
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
        nearest = _nearest(target, ends)
        residual = self.model.output_at(memory) - target
        return Solution(False, before, residual, nearest, (ends[0], ends[-1]), count, memory, intervals)

    def solutions(self, target: float, memory: Memory) -> tuple[Array, int]:
        """Return all temperatures (degC, increasing) where the output is `target` from this memory, and evaluations.

        Of a range over which the output stands still at the target, one temperature is returned.
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
        """Return the lowest temperature at which a film with `initial` memory ("cooled" or "heated") has the output.

        None is found (reachable is False) for a target that is not finite.
        """
        initial = initial or self.model.initial
        film, saturated = self.model.packed, self.model.saturated(initial)
        side, start, end = 1.0, self.low_degC, self.high_degC
        if initial == "cooled":
            side, start, end = -1.0, end, start
        v, count = self._lowest(target, initial) if math.isfinite(target) else (math.nan, 0)
        if not math.isnan(v):
            memory = self.model.initial_memory(v, initial)
            return Solution(True, v, self.model.output_at(memory) - target, target, None, count, memory)
        low, high = output_range(side, start, end, film, self._settings, saturated)
        nearest = _nearest(target, [low, high])
        rest = self.model.initial_memory(self.low_degC, initial)
        return Solution(False, math.nan, math.nan, nearest, (low, high), count, rest, ((low, high),))

    def _lowest(self, target: float, initial: Initial) -> tuple[float, int]:
        """Return the temperature of `first`, nan if there is none, and evaluations."""

        def misses(v: float) -> bool:
            return abs(self.model.output_at(self.model.initial_memory(v, initial)) - target) > self.bound

        if not misses(self.low_degC):
            return self.low_degC, 1
        v, count = self._lowest_root(target, initial, self.bound)
        if math.isnan(v) or misses(v - FLAT_K):
            return v, count + 1
        for goal in (target - 0.5 * self.bound, target + 0.5 * self.bound):  # a plateau: one of its ends
            root, more = self._lowest_root(goal, initial, 0.25 * self.bound)
            count += more
            if root < v and not misses(root):
                v = root
        return v, count + 1

    def _lowest_root(self, target: float, initial: Initial, bound: float) -> tuple[float, int]:
        """Return the lowest root along the branch of an initial memory, nan if there is none, and evaluations."""
        side, start, end = 1.0, self.low_degC, self.high_degC
        if initial == "cooled":
            side, start, end = -1.0, end, start
        roots = np.empty(1 if side > 0.0 or self.least_slope >= 0.0 else MOST_SOLUTIONS)
        limits, table = self._settings
        limits = limits.copy()
        limits[BOUND] = bound
        saturated = self.model.saturated(initial)
        found, count = solutions_on_branch(
            side, target, start, end, self.model.packed, (limits, table), saturated, roots
        )
        return (float(roots[found - 1]) if found else math.nan), count

    def reachable_intervals(self, memory: Memory) -> tuple[tuple[float, float], ...]:
        """Return the outputs that can be reached from this memory without a reversal, as intervals in order.

        There is more than one if the order condition fails: the output then jumps at a reversal.
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
        """Return the least and the largest output that can be reached from this memory without a reversal."""
        intervals = self.reachable_intervals(memory)
        return intervals[0][0], intervals[-1][1]

    def trajectory(self, targets: ArrayLike, memory: Memory) -> tuple[Array, Memory]:
        """Return temperatures (degC) for a sequence of outputs, nan where one is out of reach, and the memory after."""
        wanted = writable(targets)
        rows, counts = np.empty((2, wanted.size)), np.empty(wanted.size, dtype=np.int64)
        plays = memory.plays.copy()
        v = trajectory(wanted, memory.input_degC, plays, self.model.packed, self._settings, rows, counts)
        return rows[0], Memory(v, plays)


def _nearest(target: float, ends: Sequence[float]) -> float:
    """Return the nearest of some outputs, in order from the least; nan for a target of nan."""
    if math.isnan(target):
        return math.nan
    within = min(max(target, ends[0]), ends[-1])
    return min(ends, key=lambda end: abs(end - within))


BEAM: Final = 12  # a film of table 1 has at most four temperatures for a target (`benchmark paper`)
APART_K: Final = 0.05  # nearer than the noise of the plate: one course


@dataclass(frozen=True, eq=False)
class BranchPlan:
    """Temperatures of a course: which of several to take at each target.

    temperatures_degC: shape (targets,), up to the first target that no course reaches. memory: after the last of them.
    late_s: total time by which the plate is late on it.
    """

    temperatures_degC: Array
    memory: Memory
    late_s: float


@dataclass(frozen=True, eq=False)
class _Course:
    late_s: float
    moved_K: float
    degC: float
    memory: Memory
    before: _Course | None


def branch_plan(
    inverse: Inverse, times_s: Array, targets: Array, memory: Memory, cooling_K_per_s: float, heating_K_per_s: float
) -> BranchPlan:
    """Plan the course for outputs `targets` at `times_s`, shapes (targets,), from a memory.

    The rates (both > 0) are the plate's; the first target is reached in whatever time it takes.
    """
    courses = [_Course(0.0, 0.0, memory.input_degC, memory, None)]
    spans = np.diff(times_s, prepend=-np.inf)
    for target, span_s in zip(targets, spans, strict=True):
        following: list[_Course] = []
        for course in courses:
            for degC in inverse.solutions(float(target), course.memory)[0]:
                moved = float(degC) - course.degC
                needed_s = moved / heating_K_per_s if moved > 0.0 else -moved / cooling_K_per_s
                late_s = course.late_s + max(needed_s - span_s, 0.0)
                after = inverse.model.step(float(degC), course.memory)[1]
                following.append(_Course(late_s, course.moved_K + abs(moved), float(degC), after, course))
        if not following:
            break
        courses = _best(following)
    return _plan(courses[0])


def _best(courses: list[_Course]) -> list[_Course]:
    """Return the courses that go on, the best first."""
    cheapest = sorted(courses, key=lambda c: (c.late_s, c.moved_K))
    kept: list[_Course] = []
    for course in cheapest:
        if all(abs(course.degC - other.degC) > APART_K for other in kept):
            kept.append(course)
        if len(kept) == BEAM:
            break
    ends = (min(cheapest, key=lambda c: c.degC), max(cheapest, key=lambda c: c.degC))
    return kept + [course for course in ends if course not in kept]


def _plan(last: _Course) -> BranchPlan:
    temperatures: list[float] = []
    course: _Course | None = last
    while course is not None and course.before is not None:
        temperatures.append(course.degC)
        course = course.before
    return BranchPlan(np.array(temperatures[::-1]), last.memory, last.late_s)
