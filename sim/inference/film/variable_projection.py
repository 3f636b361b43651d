"""The separable fit of one structure: weights and D's coefficients inside, envelopes and D's shape outside.

    minimize over theta   min over p >= 0, offset   | y - offset - D(v; theta) c - sum_j p_j F_j[v; theta] |^2

The outer search is a damped Gauss-Newton descent (`levenberg_marquardt`) on the projected residual: the derivative is
P (dF/dtheta p), with P the projector off the active columns. Sources: G. Golub, V. Pereyra, Inverse Problems 19
(2003) R1; L. Kaufman, BIT 15 (1975) 49.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.rows import Path
from sim.inference.levenberg_marquardt import Damping, Linearized, descend
from sim.inference.nnls import solve_triangle, triangle
from sim.model.operator_outputs import (
    GROUP,
    Integers,
    envelope_values,
    operator_outputs,
    output_derivatives,
    radius_floor,
)

# Weights that come and go with the active columns bend the cost: damping begins higher and changes more slowly.
DAMPING: Final = Damping(1e-2, 0.2, 5.0, 1e-9, 1e-6, 6)


@dataclass(frozen=True, eq=False)
class Structure:
    """Groups of operators with common envelopes: the group of each operator and its place s_j in [0, 1) on the grid
    of radii r_j = f + (1 - f) s_j, f the group's smallest allowed radius (0 for all if `ordered` is False)."""

    group: Integers
    fractions: Array
    ordered: bool = True

    @property
    def groups(self) -> int:
        return int(self.group[-1]) + 1

    def radii(self, shapes: Array) -> tuple[Array, Array]:
        """Return radii (operators,) and the gradient of each group's floor (groups, 4)."""
        if not self.ordered:
            return self.fractions.copy(), np.zeros((self.groups, GROUP))
        floors, slopes = zip(*(radius_floor(shape) for shape in shapes), strict=True)
        floor = np.array(floors)[self.group]
        return floor + (1.0 - floor) * self.fractions, np.array(slopes)


def equal_structure(operators: int, groups: int = 1, ordered: bool = True) -> Structure:
    """Return `operators` in all, shared out evenly, each group's radii evenly spaced from its floor to below 1."""
    sizes = [operators // groups + (k < operators % groups) for k in range(groups)]
    group = np.repeat(np.arange(groups), sizes).astype(np.int64)
    return Structure(group, np.concatenate([np.arange(size) / size for size in sizes]), ordered)


def denser(structure: Structure, factor: int = 4) -> Structure:
    """Return the same groups on radius grids with `factor` times as many places: true radii are on nobody's grid."""
    sizes = [factor * int(np.sum(structure.group == k)) for k in range(structure.groups)]
    group = np.repeat(np.arange(structure.groups), sizes).astype(np.int64)
    return Structure(group, np.concatenate([np.arange(size) / size for size in sizes]), structure.ordered)


def merged(structure: Structure, weights: Array, most: int) -> Structure:
    """Return only the operators with weight, neighbours joined at their common centre down to at most `most`."""
    kept = weights > 1e-6 * float(np.sum(weights))
    if not np.any(kept):
        return Structure(structure.group[:1], structure.fractions[:1], structure.ordered)
    group, place, weight = structure.group[kept], structure.fractions[kept], weights[kept]
    while place.size > most:
        together = weight[1:] + weight[:-1]
        cost = weight[1:] * weight[:-1] / together * np.diff(place) ** 2
        cost = np.where(group[1:] == group[:-1], cost, np.inf)
        k = int(np.argmin(cost))
        if not np.isfinite(cost[k]):
            break
        place[k] = (weight[k] * place[k] + weight[k + 1] * place[k + 1]) / together[k]
        weight[k] = together[k]
        group, place, weight = np.delete(group, k + 1), np.delete(place, k + 1), np.delete(weight, k + 1)
    return Structure(group, place, structure.ordered)


@dataclass(frozen=True, eq=False)
class Solution:
    """A point of the outer search with the best coefficients there."""

    theta: Array
    square: float  # mean square residual
    weights: Array
    coefficients: Array
    offset: float
    residual: Array  # y - fit, shape (readings,)


class Problem:
    """One structure and one form of D on one path. theta: 4 numbers a group, then D's nonlinear parameters."""

    def __init__(self, path: Path, structure: Structure, form: Form, low: Array, high: Array) -> None:
        self.path, self.structure, self.form = path, structure, form
        d_low, d_high = form.bounds()
        self.low, self.high = np.append(low, d_low), np.append(high, d_high)
        self.split = GROUP * structure.groups
        self.v = path.inputs[path.rows]
        self._fixed = form.columns(self.v, d_low) if d_low.size == 0 else None  # of a form that no theta changes

    def _memoryless(self, theta: Array) -> Array:
        """Return D's columns at the readings."""
        return self.form.columns(self.v, theta[self.split :]) if self._fixed is None else self._fixed

    def shapes(self, theta: Array) -> Array:
        return np.ascontiguousarray(theta[: self.split].reshape(-1, GROUP))

    def operators(self, theta: Array) -> tuple[Array, Array]:
        """Return operator outputs at the readings, shape (readings, operators), and the envelopes along the path."""
        shapes = self.shapes(theta)
        gamma = envelope_values(self.path.inputs, self.path.side, shapes)
        radii, _ = self.structure.radii(shapes)
        out = np.empty((self.path.rows.size, radii.size))
        operator_outputs(gamma, self.path.side, radii, self.structure.group, 1.0, self.path.rows, out)
        return out, gamma

    def solve(self, theta: Array) -> Solution:
        """Return the best coefficients at theta."""
        return self.solve_columns(theta, self.operators(theta)[0])

    def solve_columns(self, theta: Array, operators: Array) -> Solution:
        memoryless = self._memoryless(theta)
        columns = np.concatenate((memoryless, operators, self.path.output[:, None]), axis=1)
        mean = columns.mean(axis=0)
        centred = columns - mean
        free = 0 if self.form.monotone else memoryless.shape[1]
        x, _ = solve_triangle(triangle(centred), free)
        residual = centred[:, -1] - centred[:, :-1] @ x
        k = memoryless.shape[1]
        offset = float(mean[-1] - mean[:-1] @ x)
        return Solution(theta, float(residual @ residual) / residual.size, x[k:], x[:k], offset, residual)

    def derivatives(self, solution: Solution, gamma: Array) -> Array:
        """Return d fit / d theta at fixed coefficients, shape (readings, parameters)."""
        shapes = self.shapes(solution.theta)
        radii, slopes = self.structure.radii(shapes)
        out = np.zeros((self.path.rows.size, solution.theta.size))
        part = np.empty((self.path.rows.size, self.split))
        path, structure = self.path, self.structure
        output_derivatives(
            path.inputs,
            gamma,
            path.side,
            shapes,
            radii,
            structure.fractions,
            structure.group,
            solution.weights,
            slopes,
            path.rows,
            part,
        )
        out[:, : self.split] = part
        for k in range(self.split, solution.theta.size):
            step = np.zeros(solution.theta.size - self.split)
            step[k - self.split] = 1e-5
            par = solution.theta[self.split :]
            change = self.form.columns(self.v, par + step) - self.form.columns(self.v, par - step)
            out[:, k] = change @ solution.coefficients / 2e-5
        return out

    def active_columns(self, solution: Solution, operators: Array) -> Array:
        """Return the columns that carry the fit, the constant first: shape (readings, 1 + active)."""
        memoryless = self._memoryless(solution.theta)
        used = solution.coefficients != 0.0
        ones = np.ones((self.v.size, 1))
        return np.concatenate((ones, memoryless[:, used], operators[:, solution.weights > 0.0]), axis=1)

    def refine(self, start: Solution, *, steps: int = 20, tolerance: float = 1e-5) -> Solution:
        """Return the local minimum reached from a solution, which may be one on another path."""
        if start.residual.size != self.v.size:
            start = self.solve(start.theta)

        def settled(before: float, after: float) -> bool:
            return not after < before * (1.0 - tolerance)

        return descend(start, steps, lambda at: at.square, self._linearized, settled, DAMPING)

    def _linearized(self, at: Solution) -> Linearized[Solution]:
        operators, gamma = self.operators(at.theta)
        normal, gradient = self._projected(self.active_columns(at, operators), self.derivatives(at, gamma), at)
        scale = np.diag(normal) + 1e-12 * float(np.trace(normal)) + 1e-300  # for what nothing depends on

        def moved(step: Array) -> Solution:
            theta = at.theta + np.clip(step, -self._reach, self._reach)
            return self.solve(np.clip(theta, self.low, self.high))

        return Linearized(normal, gradient, scale, moved)

    @staticmethod
    def _projected(active: Array, jacobian: Array, solution: Solution) -> tuple[Array, Array]:
        """Return J'PJ and J'Pe, P the projector off the active columns: the lower right of the common triangle."""
        common = np.concatenate((active, jacobian, solution.residual[:, None]), axis=1)
        first = active.shape[1]
        rest = triangle(common)[first:, first:]
        return rest[:, :-1].T @ rest[:, :-1], rest[:, :-1].T @ rest[:, -1]

    @property
    def _reach(self) -> Array:
        """The largest step of each parameter: a fifth of its range."""
        return 0.2 * (self.high - self.low)


@dataclass(frozen=True, eq=False)
class PlainFit:
    """A solution with its derivatives by everything that was fitted, along any path."""

    problem: Problem
    solution: Solution

    @property
    def form(self) -> Form:
        """Of D."""
        return self.problem.form

    @property
    def operators(self) -> int:
        """How many operators have weight."""
        return int(np.sum(self.solution.weights > 0.0))

    @property
    def shape(self) -> Array:
        """D's nonlinear parameters."""
        return self.solution.theta[self.problem.split :]

    def at(self, path: Path) -> Array:
        """Return the fit at another path's readings, shape (readings,)."""
        other, own = self._along(path), self.solution
        memoryless = self.form.columns(other.v, self.shape) @ own.coefficients
        return np.asarray(own.offset + memoryless + self.play_outputs(path) @ own.weights, dtype=np.float64)

    @property
    def outer_names(self) -> tuple[str, ...]:
        each = ("log_rising_slope", "rising_centre_degC", "log_falling_slope", "falling_centre_degC")
        groups = self.problem.structure.groups
        names = each if groups == 1 else tuple(f"{name}_{k + 1}" for k in range(groups) for name in each)
        shape = ("log_memoryless_slope", "memoryless_centre_degC")
        return (*names, *shape[: self.problem.form.parameters])

    @property
    def outer_values(self) -> Array:
        return self.solution.theta

    @property
    def parameters(self) -> float:
        used = np.sum(self.solution.weights > 0.0) + np.sum(self.solution.coefficients != 0.0)
        return int(used) + 1 + self.solution.theta.size

    @property
    def precision(self) -> None:
        """There are no priors."""
        return None

    def _along(self, path: Path) -> Problem:
        own = self.problem
        return Problem(path, own.structure, own.form, own.low[: own.split], own.high[: own.split])

    def play_outputs(self, path: Path) -> Array:
        """Return operator outputs at the path's readings, shape (readings, operators)."""
        return self._along(path).operators(self.solution.theta)[0]

    def jacobian(self, path: Path) -> Array:
        """Return outer parameters, offset, D's coefficients, active weights: shape (readings, parameters)."""
        other = self._along(path)
        operators, gamma = other.operators(self.solution.theta)
        outer = other.derivatives(self.solution, gamma)
        return np.concatenate((outer, other.active_columns(self.solution, operators)), axis=1)
