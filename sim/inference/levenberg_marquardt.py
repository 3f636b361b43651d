"""A damped Gauss-Newton descent: the one loop of every nonlinear least-squares fit here.

    (N + damping diag(s)) step = g,     N = J' W J,  g = J' W r,  s = diag N

With little damping a step is Gauss-Newton's, with much it is a short one downhill. A step that gains makes the damping
smaller, one that does not makes it larger and is tried again. The equations are solved in units of sqrt(s), so that the
parameters' own units do not matter. What a parameter is, how it moves, what it costs and when it is good enough is
known to the fit alone.

A fit that has projected out what is linear hands over N and g (`descend`), one that has not its residual and
derivatives (`least_squares`).

Sources: K. Levenberg, Q. Appl. Math. 2 (1944) 164; D. Marquardt, J. Soc. Ind. Appl. Math. 11 (1963) 431.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Generic, TypeVar

import numpy as np

from compensator.hysteresis.functions import Array

FLAT: Final = 1e-9  # of a scaled diagonal: what the record hardly tells would move without an end
SETTLED: Final = 1e-5  # log-likelihood that one more step gains: values are then within 0.005 deviations
TINY: Final = 1e-30  # of a diagonal: an unknown on which nothing depends
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
    moved: the point after a step of shape (parameters,), kept within whatever bounds there are. floor: of the damped
    diagonal in units of s, where N itself may be too small to be inverted. ends: the least and the largest step, each
    (parameters,); where one stays at its end, the others go as far as is best beside it.
    """

    normal: Array
    gradient: Array
    scale: Array
    moved: Callable[[Array], Point]
    floor: float = 0.0
    ends: tuple[Array, Array] | None = None


def held_at_bounds(normal: Array, gradient: Array, x: Array, low: Array, high: Array) -> None:
    """Take what would leave its bounds out of the equations, in place. All of shape (parameters,) but `normal`."""
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    normal[held, :] = 0.0
    normal[:, held] = 0.0
    gradient[held] = 0.0


def least_squares(
    residual: Callable[[Array], Array],
    slopes: Callable[[Array, Array], Array],
    start: Array,
    bounds: tuple[Array, Array],
    steps: int,
    damping: Damping = Damping(),
) -> tuple[Array, float]:
    """Return the x within bounds at which half the sum of squared residuals is least, near a start, and that sum.

    residual: of x, in units of its noise, (rows,); slopes: its derivatives by x, (rows, unknowns), of x and its
    residual. `scipy.optimize.least_squares` takes singular values of all rows in every step: five times the time.
    """
    low, high = bounds

    def tried(x: Array) -> tuple[Array, Array, float]:
        left = residual(x)
        return x, left, 0.5 * float(left @ left)

    def linearized(at: tuple[Array, Array, float]) -> Linearized[tuple[Array, Array, float]]:
        x, left, _ = at
        columns = slopes(x, left)
        normal, gradient = columns.T @ columns, -columns.T @ left
        held_at_bounds(normal, gradient, x, low, high)
        scale = np.maximum(np.diag(normal), TINY)
        return Linearized(
            normal, gradient, scale, lambda step: tried(np.clip(x + step, low, high)), FLAT, (low - x, high - x)
        )

    def settled(before: float, after: float) -> bool:
        return before - after < SETTLED * (1.0 + SETTLED * before)

    x, _, cost = descend(tried(np.clip(start, low, high)), steps, lambda at: at[2], linearized, settled, damping)
    return x, cost


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
        at, level = damped_step(at, cost, linearized(at), level, damping, least_gain)
        if settled(before, cost(at)):
            break
    return at


def damped_step(
    at: Point,
    cost: Callable[[Point], float],
    about: Linearized[Point],
    level: float,
    damping: Damping,
    least_gain: float = 0.0,
) -> tuple[Point, float]:
    """Return the point after one step that gains, or the same where none does; and the damping for the next. level: of
    now; least_gain: of the cost, that a step has to promise to be tried (g' step - 1/2 step' N step): at a minimum none
    does, and each of `trials` would be in vain. So would be one that more damping has hardly changed."""
    norm = np.sqrt(about.scale)
    scaled, gradient = about.normal / np.outer(norm, norm), about.gradient / norm
    before, trials = cost(at), 0
    failed: Array | None = None
    while trials < damping.trials:
        damped = scaled + level * np.eye(norm.size)
        if about.floor > 0.0:
            damped[np.diag_indices_from(damped)] = np.maximum(np.diag(damped), about.floor)
        step = np.linalg.solve(damped, gradient)
        if about.ends is not None:
            step = _within(damped, gradient, step, *(norm * end for end in about.ends))
        if float(gradient @ step - 0.5 * step @ scaled @ step) <= least_gain:
            break
        if failed is None or not np.linalg.norm(step - failed) <= SAME * np.linalg.norm(failed):  # nan is another
            trial, failed, trials = about.moved(step / norm), step, trials + 1
            if cost(trial) < before:
                return trial, max(damping.less * level, damping.least)
        level = max(damping.more * level, damping.least_after_failure)
    return at, level


def _within(damped: Array, gradient: Array, step: Array, low: Array, high: Array) -> Array:
    """Return a step within its ends, all (parameters,): what would go furthest beyond stays at its end, and the others
    are solved for anew, until none goes beyond. They were computed for the long step of an unknown that the data hardly
    tell, and gain nothing beside a short one."""
    held = np.zeros(step.size, dtype=np.bool_)
    while np.any((beyond := np.where(held, 0.0, np.maximum(step - high, low - step))) > 0.0):
        held[np.argmax(beyond)] = True
        free = ~held
        step = np.where(held, np.clip(step, low, high), step)
        beside = gradient[free] - damped[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(damped[np.ix_(free, free)], beside)
    return step
