"""A resistance from the film's output: -log10(R / 1 ohm), or log10(R / 1 ohm) of a film whose resistance rises."""

from __future__ import annotations

import math

from rig.files.film_output import FALLING_RESISTANCE, sign_of


def ohm(output: float, name: str = FALLING_RESISTANCE) -> float:
    """R in ohm of an output of that name. A model may say more decades than a number has, far outside what it was
    fitted to: infinite then, where Python's own power would raise in the middle of a run."""
    try:
        return float(10.0 ** (sign_of(name) * output))
    except OverflowError:
        return math.inf
