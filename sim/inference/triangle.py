"""The triangle to which least-squares columns are reduced, compiled: Cholesky's, of columns that may depend on others.

LAPACK's Cholesky refuses such columns and its QR leaves rounding in their place, on which the coefficients' signs would
hang. The square of the columns is BLAS'; whoever calls this keeps it to one thread (`threadpool_limits`), because on
small blocks a threaded one spends its time waiting for its own threads as soon as another process wants a core (twenty
times slower was seen).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

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


def triangle(columns: Array) -> Array:
    """Return R, shape (k, k), upper triangular with R'R = columns' columns, up to a jitter of `JITTER` on the diagonal.

    columns: shape (rows, k).
    """
    return reduced(np.ascontiguousarray(columns.T @ columns))


def reduced(products: Array) -> Array:
    """Return the same of the columns' products, shape (k, k), in their place."""
    _reduce(JITTER * float(np.trace(products)) / max(products.shape[0], 1) + 1e-300, products)
    return products
