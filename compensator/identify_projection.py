"""The separable fit of one structure: weights and D's coefficients inside, envelopes and D's shape outside.

    minimize over theta   min over p >= 0, offset   | y - offset - D(v; theta) c - sum_j p_j F_j[v; theta] |^2

The outer search is Gauss-Newton with Marquardt's damping on the projected residual: the derivative is
P (dF/dtheta p), with P the projector off the active columns. Sources: G. Golub, V. Pereyra, Inverse Problems 19
(2003) R1; L. Kaufman, BIT 15 (1975) 49.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.functions import Array
from compensator.identify_forms import Form
from compensator.identify_operators import (
    GROUP,
    Integers,
    envelope_values,
    operator_outputs,
    output_derivatives,
    radius_floor,
)
from compensator.identify_rows import Path
from compensator.nnls import solve_triangle, triangle


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
        """Radii (operators,) and the gradient of each group's floor (groups, 4)."""
        if not self.ordered:
            return self.fractions.copy(), np.zeros((self.groups, GROUP))
        floors, slopes = zip(*(radius_floor(shape) for shape in shapes), strict=True)
        floor = np.array(floors)[self.group]
        return floor + (1.0 - floor) * self.fractions, np.array(slopes)


def equal_structure(operators: int, groups: int = 1, ordered: bool = True) -> Structure:
    """`operators` in all, shared out evenly, each group's radii evenly spaced from its floor to below 1."""
    sizes = [operators // groups + (k < operators % groups) for k in range(groups)]
    group = np.repeat(np.arange(groups), sizes).astype(np.int64)
    return Structure(group, np.concatenate([np.arange(size) / size for size in sizes]), ordered)


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

    def shapes(self, theta: Array) -> Array:
        return np.ascontiguousarray(theta[: self.split].reshape(-1, GROUP))

    def operators(self, theta: Array) -> tuple[Array, Array]:
        """Operator outputs at the readings, shape (readings, operators), and the envelopes along the path."""
        shapes = self.shapes(theta)
        gamma = envelope_values(self.path.inputs, self.path.side, shapes)
        radii, _ = self.structure.radii(shapes)
        out = np.empty((self.path.rows.size, radii.size))
        operator_outputs(gamma, self.path.side, radii, self.structure.group, 1.0, self.path.rows, out)
        return out, gamma

    def solve(self, theta: Array, *, accurate: bool = False) -> Solution:
        """The best coefficients at theta."""
        return self.solve_columns(theta, self.operators(theta)[0], accurate=accurate)

    def solve_columns(self, theta: Array, operators: Array, *, accurate: bool = False) -> Solution:
        memoryless = self.form.columns(self.v, theta[self.split :])
        columns = np.concatenate((memoryless, operators, self.path.output[:, None]), axis=1)
        mean = columns.mean(axis=0)
        centred = columns - mean
        free = 0 if self.form.monotone else memoryless.shape[1]
        x, _ = solve_triangle(triangle(centred, accurate=accurate), free)
        residual = centred[:, -1] - centred[:, :-1] @ x
        k = memoryless.shape[1]
        offset = float(mean[-1] - mean[:-1] @ x)
        return Solution(theta, float(residual @ residual) / residual.size, x[k:], x[:k], offset, residual)

    def derivatives(self, solution: Solution, gamma: Array) -> Array:
        """d fit / d theta at fixed coefficients, shape (readings, parameters)."""
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
        """The columns that carry the fit, the constant first: shape (readings, 1 + active)."""
        memoryless = self.form.columns(self.v, solution.theta[self.split :])
        used = solution.coefficients != 0.0
        ones = np.ones((self.v.size, 1))
        return np.concatenate((ones, memoryless[:, used], operators[:, solution.weights > 0.0]), axis=1)

    def refine(self, start: Solution, *, steps: int = 20, tolerance: float = 1e-5, accurate: bool = False) -> Solution:
        """The local minimum reached from a solution."""
        best, damping = start, 1e-2
        for _ in range(steps):
            operators, gamma = self.operators(best.theta)
            if best.residual.size != self.v.size:
                best = self.solve_columns(best.theta, operators, accurate=accurate)
            active, _ = np.linalg.qr(self.active_columns(best, operators))
            jacobian = self.derivatives(best, gamma)
            jacobian -= active @ (active.T @ jacobian)
            normal = jacobian.T @ jacobian
            gradient = jacobian.T @ best.residual
            scale = np.diag(normal) + 1e-12 * float(np.trace(normal)) + 1e-300
            before = best.square
            for _ in range(6):
                step = np.linalg.solve(normal + damping * np.diag(scale), gradient)
                theta = np.clip(best.theta + np.clip(step, -self._reach, self._reach), self.low, self.high)
                trial = self.solve(theta, accurate=accurate)
                if trial.square < best.square:
                    best, damping = trial, max(0.2 * damping, 1e-9)
                    break
                damping = max(5.0 * damping, 1e-6)
            if not best.square < before * (1.0 - tolerance):
                break
        return best

    @property
    def _reach(self) -> Array:
        """The largest step of each parameter: a fifth of its range."""
        return 0.2 * (self.high - self.low)
