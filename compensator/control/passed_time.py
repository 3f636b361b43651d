"""What a step of the law makes of the time that has passed since the command before: a period, more, or several."""

from __future__ import annotations

import math
from typing import Final

from compensator.compiled import njit
from compensator.control.reference_shaping import Reference

STALLED: Final = 2.1  # periods from one command to the next beyond which some were missed, not one late


@njit
def passed_s(period_s: float, elapsed_s: float) -> float:
    """Time since the command before acted. elapsed_s: nan: a period."""
    return period_s if math.isnan(elapsed_s) else elapsed_s


@njit
def led(period_s: float, elapsed_s: float, left: Reference, reference: Reference, here: Reference) -> Reference:
    """Where film and plate should be as a command acts: on the way from where they were to be at the command before,
    `left`, to where they were led in a period, `reference`; where they are, `here`, after periods without a command:
    nobody led them in those. elapsed_s: nan: a period."""
    if math.isnan(elapsed_s):
        return reference
    if elapsed_s > STALLED * period_s:
        return here
    share = elapsed_s / period_s
    film_K, plate_K = reference.film_degC - left.film_degC, reference.plate_degC - left.plate_degC
    return Reference(left.film_degC + share * film_K, left.plate_degC + share * plate_K)
