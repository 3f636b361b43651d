"""Linear least squares with some coefficients >= 0, on the reduced problem.

    minimize |M_free x + M_nn p - y|^2   over x and p >= 0

The rows are first reduced to a triangle R with R'R = M'M, M = [M_free, M_nn, y] (`identification.triangle`).
The free columns come first, so that p is decided by the lower right block alone and x follows by substitution. Source:
C. L. Lawson, R. J. Hanson, Solving Least Squares Problems (SIAM 1995), ch. 23.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from compensator.hysteresis.functions import Array


def solve_triangle(r: Array, free: int) -> tuple[Array, float]:
    """Coefficients (free ones first), shape (k - 1,), and the sum of squares, from a triangle of [free, nn, y]."""
    last = r.shape[0] - 1
    coefficients = np.zeros(last)
    rest = float(r[last, last] ** 2)
    if last > free:
        block, target = r[free:last, free:last], r[free:last, last]
        try:
            coefficients[free:], norm = nnls(block, target)
            rest += float(norm) ** 2
        except RuntimeError:  # cycling on nearly equal columns: a regularized problem has no such ties
            ridge = 1e-7 * float(np.linalg.norm(block)) * np.eye(last - free)
            stacked = np.vstack((block, ridge))
            solution = nnls(stacked, np.append(target, np.zeros(last - free)), maxiter=100 * last)[0]
            coefficients[free:] = solution
            rest += float(np.sum((block @ solution - target) ** 2))
    if free:
        right = r[:free, last] - r[:free, free:last] @ coefficients[free:]
        coefficients[:free] = solve_triangular(r[:free, :free], right, check_finite=False)
    return coefficients, rest
