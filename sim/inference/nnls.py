"""Linear least squares with some coefficients >= 0, on the reduced problem.

    minimize |M_free x + M_nn p - y|^2   over x and p >= 0

The rows are first reduced to a triangle R with R'R = M'M, M = [M_free, M_nn, y]. The free columns come first, so that p
is decided by the lower right block alone and x follows by substitution. Source: C. L. Lawson, R. J. Hanson, Solving
Least Squares Problems (SIAM 1995), ch. 23.

The triangle is Cholesky's, of columns that may depend on others: LAPACK's refuses such columns and its QR leaves
rounding in their place, on which the coefficients' signs would hang. The square of the columns is BLAS'; callers keep
it to one thread (`threadpool_limits`), because on small blocks a threaded one waits for its own threads as soon as
another process wants a core (twenty times slower was seen).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

JITTER: Final = 1e-13  # of the mean diagonal: what rank deficiency may cost


@njit
def _reduce(jitter: float, out: Array) -> None:
    """Upper triangle R with R'R = out, in its place; a column that depends on others counts as nothing."""
    k = out.shape[0]
    for i in range(k):
        line = out[i]
        line[:i] = 0.0
        if not line[i] > jitter:  # a column that depends on those before it: nothing of it is left
            line[i:] = 0.0
            line[i] = math.sqrt(jitter)
            continue
        root = math.sqrt(line[i] + jitter)
        line[i] = root
        for j in range(i + 1, k):
            line[j] /= root
        for p in range(i + 1, k):
            factor = line[p]
            below = out[p]
            for j in range(p, k):
                below[j] -= factor * line[j]


def reduced(products: Array) -> Array:
    """Return R, shape (k, k), upper triangular with R'R = M'M, up to a jitter of `JITTER` on the diagonal, in the place
    of the products M'M."""
    _reduce(JITTER * float(np.trace(products)) / max(products.shape[0], 1) + 1e-300, products)
    return products


def solve_triangle(r: Array, free: int) -> tuple[Array, float]:
    """Return the coefficients, free ones first, shape (k - 1,), and the sum of squares; r: of [free, nn, y]."""
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
