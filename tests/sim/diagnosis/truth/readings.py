"""The ohmmeter's side, in its order: series, shunt, lag, (skew: where it is read), range error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit

Array = NDArray[np.float64]


@njit(error_model="numpy")
def lagged(time: Array, y: Array, tau_s: float) -> Array:
    """First-order lag of y, exact for straight pieces between the fine times."""
    out = np.empty(y.size)
    out[0] = y[0]
    for i in range(1, y.size):
        gap = time[i] - time[i - 1]
        if gap <= 0.0:
            out[i] = out[i - 1]
            continue
        ratio = gap / tau_s
        keep = np.exp(-ratio)
        weight = (1.0 - keep) / ratio
        out[i] = keep * out[i - 1] + y[i] * (1.0 - weight) + y[i - 1] * (weight - keep)
    return out


def at_the_terminals(log_ohm: Array, series_ohm: Array | float, leakage_ohm: float) -> Array:
    """log10 of what the meter has at its terminals: leads in series with the film, a shunt across both."""
    if not np.any(series_ohm) and not np.isfinite(leakage_ohm):
        return log_ohm
    ohm = 10.0**log_ohm + series_ohm
    return np.asarray(np.log10(1.0 / (1.0 / ohm + 1.0 / leakage_ohm)))


def ranged(log_ohm: Array, threshold_ohm: float, error: float) -> Array:
    """The gain error of the ranges above a threshold."""
    return log_ohm + np.where(log_ohm > np.log10(threshold_ohm), np.log10(1.0 + error), 0.0)


def rounded(reading: Array, step: float) -> Array:
    """Readings rounded to a step; a step of 0 leaves them."""
    return step * np.floor(reading / step + 0.5) if step > 0.0 else reading
