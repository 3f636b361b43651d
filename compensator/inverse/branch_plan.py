"""Which of several temperatures keeps the rest of a wanted course within reach: a plan of all of it, before it begins.

Where D falls faster than the operators rise (paper, table 1) a target can have several temperatures, and which one is
taken decides what the film remembers, and with it what it can do later: the nearest may lead to where the next target
has none. So several courses are followed side by side, each with its own memory, from target to target; a course that
has no temperature for the next target ends there. Of those that reach the last one, the one is taken that the plate is
least late on, and of equals the one that moves least.

It is a beam search: at each target the `BEAM` best courses go on, no two of them within `APART_K` of each other, and
the coldest and the hottest: where two ways part they are near each other, and the one that pays later costs more now.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.film import Memory
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse

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
