"""Standard errors that survive residuals with structure: the sandwich over blocks of rows.

    cov = H^-1 (sum over blocks b of g_b g_b') H^-1 B / (B - k),     H = J'J,  g_b = sum over rows i in b of J_i e_i

Residuals of a fit that is not quite the truth hang together over many rows, so that s^2 H^-1 promises far too much;
blocks longer than they hang together count what the rows really tell. Sources: W. K. Newey, K. D. West, Econometrica
55 (1987) 703; A. C. Cameron, D. L. Miller, J. Human Resources 50 (2015) 317 (the factor for few blocks).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.functions import Array

MOST_BLOCKS: Final = 200
FEWEST_BLOCKS: Final = 12
UNKNOWN: Final = 1e-9  # relative size of a singular value below which a combination is not determined


def correlation_rows(residual: Array) -> float:
    """How many rows hang together: 1 + 2 sum of the autocorrelation up to its first crossing of 0.05."""
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
    """Blocks of about four correlation lengths, between `FEWEST_BLOCKS` and `MOST_BLOCKS`."""
    count = int(residual.size / (4.0 * correlation_rows(residual)))
    return max(min(count, MOST_BLOCKS, residual.size), min(FEWEST_BLOCKS, residual.size))


def block_sandwich(jacobian: Array, residual: Array, blocks: int | None = None) -> Array:
    """Covariance of the parameters, shape (k, k); inf on the diagonal where the rows do not determine one.

    jacobian: d fit / d parameters, shape (rows, k); residual: shape (rows,), rows in sequence.
    """
    rows, k = jacobian.shape
    count = block_count(residual) if blocks is None else blocks
    size = np.sqrt(np.sum(jacobian**2, axis=0)) + 1e-300
    u, s, vt = np.linalg.svd(jacobian / size, full_matrices=False)
    known = s > UNKNOWN * s[0]
    place = np.minimum(np.arange(rows) * count // max(rows, 1), count - 1)
    score = np.zeros((count, k))
    np.add.at(score, place, u * residual[:, None])
    meat = score.T @ score * (count / max(count - k, 1))
    floor = float(residual @ residual) / max(rows - k, 1)  # never less than white residuals would give
    inner = np.where(known, 1.0 / np.where(known, s, 1.0), 0.0)
    white = floor * np.eye(k)
    spread = np.linalg.eigvalsh(meat)
    bread = vt.T * inner
    covariance = bread @ (meat if spread[-1] > 0.0 else white) @ bread.T
    least = bread @ white @ bread.T
    raise_to = np.sqrt(np.maximum(np.diag(least) / np.maximum(np.diag(covariance), 1e-300), 1.0))
    covariance = covariance * np.outer(raise_to, raise_to) / np.outer(size, size)
    lost = np.any(np.abs(vt[~known]) > 1e-4, axis=0) if not np.all(known) else np.zeros(k, dtype=np.bool_)
    covariance[lost, :] = 0.0
    covariance[:, lost] = 0.0
    covariance[lost, lost] = np.inf
    return np.asarray(covariance, dtype=np.float64)


def correlation(covariance: Array) -> Array:
    """Correlation matrix; 0 beside an undetermined parameter."""
    size = np.sqrt(np.diag(covariance))
    finite = np.isfinite(size) & (size > 0.0)
    safe = np.where(finite, size, 1.0)
    result = np.where(np.outer(finite, finite), covariance / np.outer(safe, safe), 0.0)
    np.fill_diagonal(result, 1.0)
    return np.asarray(result, dtype=np.float64)
