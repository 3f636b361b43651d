"""A damped Gauss-Newton descent: the one loop of every nonlinear least-squares fit here.

    (N + damping diag(s)) step = g,     N = J' W J,  g = J' W r,  s = diag N

With little damping a step is Gauss-Newton's, with much it is a short one downhill. A step that gains makes the damping
smaller, one that does not makes it larger and is tried again. The equations are solved in units of sqrt(s), so that the
parameters' own units do not matter. What a parameter is, how it moves, what it costs and when it is good enough is
known to the fit alone.

Sources: K. Levenberg, Q. Appl. Math. 2 (1944) 164; D. Marquardt, J. Soc. Ind. Appl. Math. 11 (1963) 431.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

from compensator.hysteresis.functions import Array

SAME: Final = 0.1  # of a step that gained nothing, by which another has to differ to be tried

Point = TypeVar("Point")


@dataclass(frozen=True)
class Damping:
    """first: at the beginning; less, more: factors after a step that gained, and that did not; least: that it is made
    by a gain; least_after_failure: that it is made at least by none; trials: of a step."""

    first: float = 1e-3
    less: float = 0.1
    more: float = 10.0
    least: float = 1e-12
    least_after_failure: float = 1e-9
    trials: int = 8


@dataclass(frozen=True, eq=False)
class Linearized(Generic[Point]):
    """The problem about a point.

    normal, gradient: N and g, shapes (parameters, parameters) and (parameters,); scale: s, > 0, shape (parameters,);
    moved: the point after a step of shape (parameters,), kept within whatever bounds there are.
    """

    normal: Array
    gradient: Array
    scale: Array
    moved: Callable[[Array], Point]


def held_at_bounds(normal: Array, gradient: Array, x: Array, low: Array, high: Array) -> None:
    """Take what would leave its bounds out of the equations, in place. All of shape (parameters,) but `normal`."""
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    normal[held, :] = 0.0
    normal[:, held] = 0.0
    gradient[held] = 0.0


def descend(
    start: Point,
    steps: int,
    cost: Callable[[Point], float],
    linearized: Callable[[Point], Linearized[Point]],
    settled: Callable[[float, float], bool],
    damping: Damping = Damping(),
    least_gain: float = 0.0,
) -> Point:
    """Return the point reached in at most `steps` steps. settled: whether a step from one cost to another was the last;
    least_gain: of the cost, that a step has to promise to be tried."""
    at, level = start, damping.first
    for _ in range(steps):
        before = cost(at)
        if not math.isfinite(before):  # no slope leads back from there
            break
        at, level = _damped_step(at, cost, linearized(at), level, damping, least_gain)
        if settled(before, cost(at)):
            break
    return at


def _damped_step(
    at: Point,
    cost: Callable[[Point], float],
    about: Linearized[Point],
    level: float,
    damping: Damping,
    least_gain: float,
) -> tuple[Point, float]:
    """Return the point after one step that gains, or the same where none does; and the damping for the next. level: of
    now; least_gain: of the cost, that a step has to promise to be tried (g' step - 1/2 step' N step): at a minimum none
    does, and each of `trials` would be in vain. So would be one that more damping has hardly changed."""
    norm = np.sqrt(about.scale)
    scaled, gradient = about.normal / np.outer(norm, norm), about.gradient / norm
    before, trials = cost(at), 0
    failed: Array | None = None
    while trials < damping.trials:
        step = np.linalg.solve(scaled + level * np.eye(norm.size), gradient)
        if float(gradient @ step - 0.5 * step @ scaled @ step) <= least_gain:
            break
        if failed is None or not np.linalg.norm(step - failed) <= SAME * np.linalg.norm(failed):  # nan is another
            trial, failed, trials = about.moved(step / norm), step, trials + 1
            if cost(trial) < before:
                return trial, max(damping.less * level, damping.least)
        level = max(damping.more * level, damping.least_after_failure)
    return at, level
