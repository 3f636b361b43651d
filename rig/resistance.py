"""A resistance from the film's output, -log10(R / 1 ohm)."""

from __future__ import annotations

import math


def ohm(output: float) -> float:
    """R in ohm. A model may say more decades than a number has, far outside what it was fitted to: infinite then, where
    Python's own power would raise in the middle of a run."""
    try:
        return float(10.0**-output)
    except OverflowError:
        return math.inf
