"""Linear least squares with some coefficients >= 0, on the reduced problem.

    minimize |M_free x + M_nn p - y|^2   over x and p >= 0

The rows are first reduced to a triangle R with R'R = M'M (M = [M_free, M_nn, y]): by Cholesky's factor of the Gram
matrix where speed counts, by QR where accuracy does. The free columns come first, so that p is decided by the lower
right block alone and x follows by substitution. Source: C. L. Lawson, R. J. Hanson, Solving Least Squares Problems
(SIAM 1995), ch. 23.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from compensator.functions import Array

JITTER = 1e-13  # of the trace: keeps the factor of a Gram matrix without full rank


def triangle(columns: Array, *, accurate: bool = False) -> Array:
    """R, shape (k, k), with R'R = columns' columns."""
    if accurate and columns.shape[0] >= columns.shape[1]:
        return np.asarray(np.linalg.qr(columns, mode="r"), dtype=np.float64)
    return gram_triangle(columns.T @ columns)


def gram_triangle(gram: Array) -> Array:
    """R with R'R = gram, with as little added to the diagonal as makes it definite."""
    jitter = JITTER * float(np.trace(gram)) + 1e-300
    for _ in range(8):
        try:
            factor = np.linalg.cholesky(gram + jitter * np.eye(gram.shape[0]))
        except np.linalg.LinAlgError:
            jitter *= 100.0
            continue
        return np.ascontiguousarray(factor.T)
    raise ValueError("gram: expected finite numbers of comparable size")


def solve_triangle(r: Array, free: int) -> tuple[Array, float]:
    """Coefficients (free ones first), shape (k - 1,), and the sum of squares, from a triangle of [free, nn, y]."""
    last = r.shape[0] - 1
    coefficients = np.zeros(last)
    rest = float(r[last, last] ** 2)
    if last > free:
        block, target = r[free:last, free:last], r[free:last, last]
        try:
            coefficients[free:], norm = nnls(block, target)
        except RuntimeError:  # cycling on nearly equal columns: a regularized problem has no such ties
            ridge = 1e-7 * float(np.linalg.norm(block)) * np.eye(last - free)
            stacked = np.vstack((block, ridge))
            solution = nnls(stacked, np.append(target, np.zeros(last - free)), maxiter=100 * last)[0]
            coefficients[free:], norm = solution, float(np.linalg.norm(block @ solution - target))
        rest += float(norm) ** 2
    if free:
        right = r[:free, last] - r[:free, free:last] @ coefficients[free:]
        coefficients[:free] = solve_triangular(r[:free, :free], right, check_finite=False)
    return coefficients, rest
