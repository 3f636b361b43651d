"""A term of the heat balance as machine code at an address, so that one compiled loop serves all effects."""

from __future__ import annotations

from typing import Any

from numba import types

from compensator.compiled import cfunc

ARGUMENTS = 10  # p0, p1, s, r, g, ambient_degC, time_s, plate_degC, own_degC, current_A
SIGNATURE = types.float64(*[types.float64] * ARGUMENTS)


def heat_term(function: Any) -> Any:
    """Decorator: the function of `sim.effects.effect.HeatFlow`, compiled; it may call mathematics, no Python.

    What it divides by zero is infinite: an exception has no way out of machine code, and the term would be 0 unseen.
    """
    return cfunc(SIGNATURE, error_model="numpy")(function)
