"""How many rows of a residual say as much as one row of independent noise.

What a model of a real plate leaves hangs together from row to row. A mean over n rows of it is known as well as one
over n / tau independent ones, tau = 1 + 2 (rho_1 + rho_2 + ...), rho_k the autocorrelation (G. E. P. Box, G. M.
Jenkins, Time Series Analysis, on the variance of a mean); with its mean square over the noise's, as well as one over
n / (tau z^2) of noise.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array

FAR: Final = 6.0  # robust standard deviations: what is beyond is a reading that went astray, and no misfit

FEWEST: Final = 30.0  # independent rows at least: fewer would say nothing of three bodies and the heat between them


def misfit_of(z: Array) -> float:
    """z: residual over the noise, (rows,), in order; at least 1."""
    if z.size < 3:
        return 1.0
    return max(min(float(np.mean(_astray_clipped(z) ** 2)) * correlated_rows(z), z.size / FEWEST), 1.0)


def correlated_rows(z: Array) -> float:
    """For how many rows a residual hangs together; at least 1. z: (rows,), in order."""
    if z.size < 3:
        return 1.0
    z = _astray_clipped(z)
    square = float(np.mean(z * z))
    if square <= 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(z, 2 * z.size)) ** 2
    rho = np.fft.irfft(spectrum)[1 : z.size] / (square * z.size)
    until = int(np.argmax(rho <= 0.0)) if np.any(rho <= 0.0) else rho.size
    return 1.0 + 2.0 * float(np.sum(rho[:until]))


def _astray_clipped(z: Array) -> Array:
    """Without what is no misfit."""
    scale = 1.4826 * float(np.median(np.abs(z)))
    return np.clip(z, -FAR * scale, FAR * scale)
