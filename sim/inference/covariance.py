"""Standard errors that survive residuals with structure: the jackknife over blocks of rows.

    cov = H^-1 (sum over blocks b of g_b g_b') H^-1,    H = J'J + P,   g_b = J_b' (I - J_b H^-1 J_b')^-1 e_b

H^-1 g_b is by how much the parameters move when block b is left out (P: precision of normal priors). Residuals of a fit
that is not quite the truth correlate over many rows, so that s^2 H^-1 promises far too much; blocks longer than the
correlation count what the rows really tell. A fit follows its own rows most closely where few rows determine most
parameters, in the transition of a film: residuals are too small there, and what (I - ...)^-1 makes of them is the error
in predicting the block from all others. Sources: W. K. Newey, K. D. West, Econometrica 55 (1987) 703; A. C. Cameron,
D. L. Miller, J. Human Resources 50 (2015) 317 (this variant is their CR3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

NORMAL_95: Final = 1.959963984540054  # standard deviations to either side hold 95 % of a normal distribution
MOST_BLOCKS: Final = 200  # these tell a spread to 5 %: 1 / sqrt(2 blocks)
FEWEST_BLOCKS: Final = 12  # these tell a spread to 20 %
UNKNOWN: Final = 3e-7  # relative size of a singular value below which a combination is not determined
ALONE: Final = 0.02  # share of a block's leverage that is not taken off: where a block alone determines a combination,
# no other row can say how wrongly, and all of it taken off would leave nothing to divide by


def correlation_rows(residual: Array) -> float:
    """Return how many rows hang together: 1 + 2 sum of the autocorrelation up to its first crossing of 0.05."""
    n = residual.size
    e = residual - np.mean(residual)
    size = 1 << int(2 * n - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(e, size)) ** 2
    auto = np.fft.irfft(spectrum, size)[:n]
    if auto[0] <= 0.0:
        return 1.0
    rho = auto / auto[0]
    below = np.flatnonzero(rho < 0.05)
    last = int(below[0]) if below.size else n
    return float(1.0 + 2.0 * np.sum(rho[1:last]))


def block_count(residual: Array) -> int:
    """Return blocks of about four correlation lengths, between `FEWEST_BLOCKS` and `MOST_BLOCKS`."""
    count = int(residual.size / (4.0 * correlation_rows(residual)))
    return max(min(count, MOST_BLOCKS, residual.size), min(FEWEST_BLOCKS, residual.size))


@dataclass(frozen=True, eq=False)
class Covariance:
    """matrix: of the parameters, shape (k, k), over the combinations that the rows determine; undetermined: shape
    (k,), the parameters with a share in another combination, whose standard error is therefore infinite."""

    matrix: Array
    undetermined: NDArray[np.bool_]

    @property
    def standard_errors(self) -> Array:
        """Shape (k,); inf where undetermined."""
        errors = np.sqrt(np.maximum(np.diag(self.matrix), 0.0))
        return np.where(self.undetermined, np.inf, errors)

    @property
    def correlation(self) -> Array:
        """Shape (k, k); 0 beside an undetermined parameter."""
        size = np.sqrt(np.maximum(np.diag(self.matrix), 0.0))
        known = ~self.undetermined & (size > 0.0)
        safe = np.where(known, size, 1.0)
        result = np.where(np.outer(known, known), self.matrix / np.outer(safe, safe), 0.0)
        np.fill_diagonal(result, 1.0)
        return np.asarray(result, dtype=np.float64)


def block_sandwich(
    jacobian: Array, residual: Array, blocks: int | None = None, precision: Array | None = None
) -> Covariance:
    """Return the covariance of the parameters of a least-squares fit.

    jacobian: d fit / d parameters, shape (rows, k); residual: shape (rows,), rows in sequence. blocks: default, by the
    residual's correlation. precision: of normal priors, over that of the residual, shape (k, k).
    """
    rows = residual.size
    count = block_count(residual) if blocks is None else blocks
    normal = jacobian.T @ jacobian
    if precision is not None:
        normal = normal + precision
    size = np.sqrt(np.diag(normal))
    size = np.where(size > 0.0, size, 1.0)
    square, vectors = np.linalg.eigh(normal / np.outer(size, size))
    s = np.sqrt(np.maximum(square, 0.0))
    known = s > UNKNOWN * max(s[-1], 1e-150)
    bread = vectors * np.where(known, 1.0 / np.where(known, s, 1.0), 0.0)
    scaled = (jacobian / size) @ bread
    edges = np.linspace(0, rows, count + 1).round().astype(np.int64)
    scores = np.stack([_score(scaled[a:b], residual[a:b]) for a, b in pairwise(edges)])
    values, axes = np.linalg.eigh(scores.T @ scores)
    white = float(residual @ residual) / max(rows - float(np.sum(scaled**2)), 1.0)
    meat = (axes * _spread(values, white, count)) @ axes.T
    matrix = bread @ meat @ bread.T / np.outer(size, size)
    lost = np.any(np.abs(vectors[:, ~known]) > 1e-3, axis=1)
    return Covariance(np.asarray(matrix, dtype=np.float64), np.asarray(lost, dtype=np.bool_))


def _spread(values: Array, white: float, blocks: int) -> Array:
    """Return how much the blocks' scores spread along each axis. values: eigenvalues of their sum of squares, (k,);
    white: what white residuals give.

    Eigenvalues of so few blocks lie on both sides of a common spread, up to (1 + sqrt(k / blocks))^2 of it, though it
    is the same along all axes (V. Marchenko, L. Pastur, Math. USSR Sb. 1 (1967) 457). Only what lies beyond is a larger
    spread along an axis of its own, and is too large by a known factor (D. Donoho, M. Gavish, I. Johnstone, Ann.
    Statist. 46 (2018) 1742). In no direction is the spread taken smaller than that of white residuals.
    """
    share = values.size / blocks
    common, edge = max(float(np.mean(values)), white), (1.0 + math.sqrt(share)) ** 2
    while np.any(own := values > edge * common) and (less := max(float(np.mean(values[~own])), white)) < common:
        common = less
    half = 0.5 * (values / common + 1.0 - share)
    alone = half + np.sqrt(np.maximum(half**2 - values / common, 0.0))
    return np.asarray(common * np.where(own, alone, 1.0))


def _score(columns: Array, residual: Array) -> Array:
    """Return what a block of rows adds to the estimate, beside all others. columns: in which H is the identity."""
    share = 1.0 - ALONE
    if residual.size > columns.shape[1]:
        other = np.eye(columns.shape[1]) - share * columns.T @ columns
        return np.asarray(np.linalg.solve(other, columns.T @ residual), dtype=np.float64)
    other = np.eye(residual.size) - share * columns @ columns.T
    return np.asarray(columns.T @ np.linalg.solve(other, residual), dtype=np.float64)
