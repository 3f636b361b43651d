"""The temperature reference: the inverse looked up ahead, and shaped to what the plate can do.

A turning point of the wanted resistance makes the wanted temperature jump across the loop. A plate with limited
rates must start before the jump to split the error about it: the reference is the mean of where the plate should be
now (the inverse), and where it has to be to arrive in time (the same, limited backwards from the end of the preview).
"""

from __future__ import annotations

import math

from numba import njit

from compensator import play
from compensator.film import Packed
from compensator.functions import Array, memoryless
from compensator.inverse import solve


@njit(cache=True)
def wanted_temperatures(
    targets: Array,
    band: float,
    v_now: float,
    memory: Array,
    film: Packed,
    low: float,
    high: float,
    least_slope: float,
    tolerance: float,
    temperatures: Array,
) -> bool:
    """Temperatures (degC) for the coming targets from the present memory; `memory` is used up.

    A target within `band` of the present output asks for no move: near a turning point the loop is so flat that
    noise on the output would become degrees. Returns whether the first target can be reached; where one cannot,
    the temperature stays, or goes to the limit on whose side the target lies.
    """
    first_reached = True
    v = v_now
    for i in range(targets.size):
        output = play.weighted_sum(film[2], memory) + _memoryless_value(film, v)
        wanted = min(max(output, targets[i] - band), targets[i] + band)
        found, v_next, _, _ = solve(wanted, v, film, memory, low, high, least_slope, tolerance)
        if not found:
            first_reached = first_reached and i > 0
            v_next = high if wanted > output else low
        play.advance(v_next, v, film[0], film[1], memory)
        v = v_next
        temperatures[i] = v
    return first_reached


@njit(cache=True)
def _memoryless_value(film: Packed, v: float) -> float:
    return memoryless(film[3], film[4], v)[0]


def shaped(
    wanted_degC: Array, spacing_s: float, first_s: float, reference_degC: float, slowest: float, fastest: float
) -> float:
    """The reference after first_s, from the one now and the wanted temperatures at first_s, first_s + spacing_s, ...

    slowest < 0 < fastest: the rates (K/s) that the plate can do here.
    """
    backwards = float(wanted_degC[-1])
    for i in range(len(wanted_degC) - 2, -1, -1):
        value = float(wanted_degC[i])
        backwards = min(max(value, backwards - fastest * spacing_s), backwards - slowest * spacing_s)
    middle = 0.5 * (float(wanted_degC[0]) + backwards)
    step = middle - reference_degC
    if not math.isfinite(step):
        return reference_degC
    return reference_degC + min(max(step, slowest * first_s), fastest * first_s)
