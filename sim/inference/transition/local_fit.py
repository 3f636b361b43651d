"""Value and slope of a curve behind scattered readings, and how surely they are known.

At each place a polynomial is fitted to the readings within `half_width`, with weights (1 - |u|^3)^3 that fade towards
the ends; its value and slope there are linear in the readings. On even rows this is what Savitzky and Golay tabulate; a
film's readings are not even in temperature. What is left over gives the noise: its size where it is (a thermometer's
noise shows most where the curve is steep), and its memory from row to row. Noise of that kind, drawn anew and put
through the same fit, gives the spread of whatever is read off the curve (a parametric bootstrap).

Sources: W. S. Cleveland, J. Am. Stat. Assoc. 74 (1979) 829 (local fits with these weights); S. Calonico, M. D.
Cattaneo, M. H. Farrell, J. Am. Stat. Assoc. 113 (2018) 767 (a polynomial of two degrees more than the window is made
for takes the bias out of the interval); C. R. Rao, J. Multivar. Anal. 1 (1971) 257 (shares of a variance from
quadratic forms of residuals).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from compensator.hysteresis.functions import Array

MEMORIES: Final = (0.0, 0.4, 0.7, 0.9, 0.97)  # of a row in the next: from none to some thirty rows
LAGS: Final = 30  # rows apart at which residuals are compared
TRIED: Final = 60  # draws that are put through the fit to know what it leaves of them
WARM_UP: Final = 200  # rows drawn and thrown away, until the noise has forgotten its beginning
TINY: Final = 1e-12  # of a fit's own scale, added so that a window with few rows still has a solution


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Matrices (places, rows): value @ readings and slope @ readings are the curve and its derivative there."""

    value: Array
    slope: Array


def local_fit(x: Array, places: Array, half_width: float, degree: int) -> LocalFit:
    """The fit of readings at x, shape (rows,), at places, shape (places,), all in one unit."""
    order = np.argsort(x, kind="stable")
    first = np.searchsorted(x[order], places - half_width)
    last = np.searchsorted(x[order], places + half_width, "right")
    value, slope = np.zeros((places.size, x.size)), np.zeros((places.size, x.size))
    for k, place in enumerate(places):
        rows = order[first[k] : last[k]]
        u = (x[rows] - place) / half_width
        powers = np.vander(u, degree + 1, increasing=True)
        weighted = powers.T * (1.0 - np.abs(u) ** 3) ** 3
        normal = weighted @ powers
        normal[np.diag_indices_from(normal)] += TINY * np.trace(normal) + 1e-300
        solved = np.linalg.solve(normal, weighted)
        value[k, rows], slope[k, rows] = solved[0], solved[min(1, degree)] / half_width
    return LocalFit(value, slope)


def draw_noise(residual: Array, scale: Array, left_over: Callable[[Array], Array], draws: int, seed: int) -> Array:
    """Noise that would leave residuals like these, shape (draws, rows). residual and its local scale: shape (rows,);
    left_over: what the fit leaves of readings, shape (draws, rows).

    A fit takes the slow part of the noise with it, so that residuals look as if they remembered nothing, or the
    opposite. So their covariances are not taken as they are: noise of each of MEMORIES is put through the same fit, and
    a mixture is found (weights >= 0) of which the fit leaves the covariances that it left.
    """
    random = np.random.default_rng(seed)
    kinds = [_autoregressive(random.standard_normal((draws, residual.size + WARM_UP)), k) * scale for k in MEMORIES]
    expected = np.stack([_covariances(left_over(kind[:TRIED]) / scale) for kind in kinds], axis=1)
    shares, _ = nnls(expected, _covariances(residual[None] / scale))
    return _mixed(kinds, shares)


def _mixed(kinds: list[Array], shares: Array) -> Array:
    """The sum of independent noises with these shares of the variance."""
    total = np.zeros_like(kinds[0])
    for kind, share in zip(kinds, shares, strict=True):
        total += np.sqrt(share) * kind
    return total


def _autoregressive(white: Array, memory: float) -> Array:
    """Noise of unit variance, each row `memory` times the row before and something new; shape (draws, rows)."""
    from scipy.signal import lfilter  # a second and a half of loading, which a run need not wait for

    found: Array = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=-1)[:, WARM_UP:]
    return found


def _covariances(values: Array) -> Array:
    """Mean products of rows 0, 1, ... LAGS apart, shape (LAGS + 1,); values: shape (draws, rows)."""
    n = values.shape[1]
    lags = range(min(LAGS, n // 4) + 1)
    return np.array([float(np.mean(values[:, : n - k] * values[:, k:])) for k in lags])
