"""Evidence that does not mistake any structure for an effect: residuals whitened by what else may be going on.

Where a fit leaves something, the plain likelihood rewards an effect for taking up part of it, whatever it is. So the
residual is given a discrepancy of its own, z = noise + sum over bands of cosines in time with coefficients
~ N(0, width_b^2), the width of each band at its largest marginal likelihood, and the effect has to be worth more than
this (M. C. Kennedy, A. O'Hagan, J. R. Statist. Soc. B 63 (2001) 425, on model discrepancy).
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from compensator.hysteresis.functions import Array

SHORTEST_ROWS = 24.0  # half a period, rows
BANDS = 3
MOST_COSINES = 260  # a fit costs their third power
TURNS = 12  # of widths and coefficients in turn


def cosines(place: Array, rows: int) -> list[Array]:
    """Cosines over the record in bands of their frequency, each (samples, k); place: the row of each sample."""
    count = int(min(rows / SHORTEST_ROWS, MOST_COSINES))
    if count < BANDS:  # a cosine in each
        return []
    k = np.arange(1, count + 1)
    columns = np.sqrt(2.0) * np.cos(np.pi * np.outer((place + 0.5) / rows, k))
    edges = np.unique(np.round(np.geomspace(1, count + 1, BANDS + 1)).astype(np.int64))
    return [columns[:, (k >= a) & (k < b)] for a, b in itertools.pairwise(edges)]


def whitened_score(z: Array, free: Array, bands: list[Array]) -> float:
    """The marginal log-likelihood of residuals z (rows,) with unknowns moving along `free` (rows, k) and a
    discrepancy."""
    norm = np.linalg.norm(free, axis=0)
    keep = norm > 1e-9  # what moves
    free = free[:, keep] / norm[keep] * np.sqrt(z.size)
    columns = np.concatenate([free, *bands], axis=1)
    sizes = [free.shape[1], *[band.shape[1] for band in bands]]
    gram, right, square = columns.T @ columns, columns.T @ z, float(z @ z)
    widths = [10.0, *[0.05] * len(bands)]  # unknowns next to free; a discrepancy that begins far below the noise
    score, best = -np.inf, -np.inf
    for _ in range(TURNS):
        prior = np.concatenate([np.full(n, w**-2) for n, w in zip(sizes, widths, strict=True)])
        normal = gram.copy()
        normal[np.diag_indices_from(normal)] += prior
        factor = cho_factor(normal, lower=True, check_finite=False)
        c = cho_solve(factor, right, check_finite=False)
        logdet = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
        score = -0.5 * (square - float(right @ c)) - 0.5 * logdet + 0.5 * float(np.sum(np.log(prior)))
        variance = np.diag(cho_solve(factor, np.eye(c.size), check_finite=False))
        place = sizes[0]
        for b, size in enumerate(sizes[1:], 1):
            part = slice(place, place + size)
            power = float(np.sum(c[part] ** 2))
            known = max(size - float(np.sum(variance[part])) * widths[b] ** -2, 1e-2)  # > 0
            widths[b] = float(np.clip(np.sqrt(power / known), 1e-4, 100.0))  # of the noise: nothing, and everything
            place += size
        if score < best + 0.05:  # log-likelihood: settled
            break
        best = score
    return max(score, best)
