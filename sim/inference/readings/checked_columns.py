"""What every record has to be, whatever is made of it: columns of one length, and seconds that increase."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array


def checked_columns(columns: Mapping[str, ArrayLike], record: str = "") -> dict[str, Array]:
    """Return the columns as numbers, each of shape (samples,); "time_s" (s) is among them. record: whose, for the
    error.

    Raises ValueError with one line: which column, what it is, what is expected. Rows count from 1.
    """
    where = f"{record}: " if record else ""
    found = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    time = found["time_s"]
    if any(values.ndim != 1 or values.shape != time.shape for values in found.values()):
        shapes = ", ".join(f"{name} {values.shape}" for name, values in found.items())
        raise ValueError(f"{where}{shapes}: expected arrays of the same length")
    unknown = int(np.sum(~np.isfinite(time)))
    if unknown:
        raise ValueError(f"{where}time_s: {unknown} are not finite, expected finite seconds")
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        k = int(back[0]) + 1
        raise ValueError(f"{where}time_s: row {k + 1}: {time[k]:g} after {time[k - 1]:g}, expected increasing seconds")
    return found


def check_noise(temperature_noise_K: float | None) -> None:
    """Raises ValueError with one line for a noise that no thermometer has; None: it is estimated."""
    if temperature_noise_K is not None and not 0.0 <= temperature_noise_K < math.inf:
        text = "expected K, 0 (readings as they are) or more, or None (estimated)"
        raise ValueError(f"temperature_noise_K: {temperature_noise_K}: {text}")
