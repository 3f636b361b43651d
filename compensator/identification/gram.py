"""Gram matrices and their triangles, compiled, in one thread.

A fit calls them thousands of times on small blocks, where a threaded linear-algebra library spends its time waiting
for its own threads as soon as another process wants a core (twenty times slower was seen).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from compensator.hysteresis.functions import Array

JITTER: Final = 1e-13  # of the mean diagonal: what rank deficiency may cost


@njit(cache=True)
def _gram(m: Array, out: Array) -> None:
    """out = m' m for a row-major m, four rows at a time."""
    rows, k = m.shape
    out[:, :] = 0.0
    whole = rows - rows % 4
    for r in range(0, whole, 4):
        a, b, c, d = m[r], m[r + 1], m[r + 2], m[r + 3]
        for i in range(k):
            ai, bi, ci, di = a[i], b[i], c[i], d[i]
            line = out[i]
            for j in range(i, k):
                line[j] += (ai * a[j] + bi * b[j]) + (ci * c[j] + di * d[j])
    for r in range(whole, rows):
        for i in range(k):
            for j in range(i, k):
                out[i, j] += m[r, i] * m[r, j]
    for i in range(k):
        for j in range(i):
            out[i, j] = out[j, i]


@njit(cache=True)
def _triangle(gram: Array, jitter: float, out: Array) -> None:
    """Upper triangle with out' out = gram; a column that depends on others counts as nothing."""
    k = gram.shape[0]
    for i in range(k):
        for j in range(k):
            out[i, j] = gram[i, j] if j >= i else 0.0
    for i in range(k):
        line = out[i]
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


def gram(columns: Array) -> Array:
    """columns' columns, shape (k, k), of a matrix (rows, k)."""
    out = np.empty((columns.shape[1], columns.shape[1]))
    _gram(np.ascontiguousarray(columns), out)
    return out


def triangle(gram_matrix: Array) -> Array:
    """R, shape (k, k), upper triangular with R'R = gram, up to a jitter of `JITTER` on the diagonal."""
    out = np.empty_like(gram_matrix)
    _triangle(gram_matrix, JITTER * float(np.trace(gram_matrix)) / max(out.shape[0], 1) + 1e-300, out)
    return out
