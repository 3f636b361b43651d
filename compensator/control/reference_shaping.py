"""The temperature reference: the inverse looked up ahead, and shaped to what the plate can do.

A turning point of the wanted resistance makes the wanted temperature jump across the loop, and a plate has limited
rates: it must leave before the jump, or arrive after it. How early is decided by the film: several departure times
are run through the model, and the one with the smallest squared error over the preview is taken.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from compensator.hysteresis import play
from compensator.hysteresis.film import Packed
from compensator.hysteresis.functions import Array, memoryless_value
from compensator.inverse.branch import workspace
from compensator.inverse.solve import HIGH, LEAST_SLOPE, LOW, arrive, no_point, solve, solve_monotone

DEPARTURES: Final = 5  # departure times that are tried, between now and just in time


@njit(cache=True)
def wanted_temperatures(
    targets: Array,
    band: float,
    toward: float,
    v_now: float,
    memory: Array,
    film: Packed,
    limits: Array,
    table: Array,
    temperatures: Array,
) -> bool:
    """Temperatures (degC) for the coming targets from the present memory; `memory` is used up.

    toward: the sign of the output's last move. To go on that way the film needs little; to turn round it has to cross
    the loop, so that noise on the output would become degrees: a target within `band` of the present output on the
    other side asks for no move. Returns whether the first target can be reached; where one cannot,
    the temperature stays, or goes to the limit on whose side the target lies. limits, table: of `Inverse.settings`.
    """
    first_reached = True
    v = v_now
    envelopes, radii, weights, code, par = film
    points, gammas, slopes, held, parts = workspace(film)
    here, root = no_point(), np.empty(1)
    monotone = limits[LEAST_SLOPE] >= 0.0 and envelopes.shape[0] == 1
    for i in range(targets.size):
        output = play.weighted_sum(weights, memory) + memoryless_value(code, par, v)
        wanted = targets[i]
        gap = wanted - output
        if gap == 0.0 or (gap * toward <= 0.0 and abs(gap) <= band):
            temperatures[i] = v
            continue
        toward = math.copysign(1.0, gap)
        if monotone:
            found, v_next, _, _ = solve_monotone(
                wanted, v, envelopes, radii, weights, code, par, limits, memory, points, held, parts, here
            )
        else:
            found, v_next, _, _ = solve(
                wanted,
                v,
                envelopes,
                radii,
                weights,
                code,
                par,
                limits,
                table,
                memory,
                points,
                gammas,
                slopes,
                held,
                parts,
                here,
                root,
            )
        if found:
            arrive(v_next, v, envelopes, radii, memory, points, here)
        else:
            first_reached = first_reached and i > 0
            v_next = limits[HIGH] if wanted > output else limits[LOW]
            play.advance(v_next, v, envelopes, radii, memory)
        v = v_next
        temperatures[i] = v
    return first_reached


@njit(cache=True)
def limited(value: float, low: float, high: float) -> float:
    """The value held within [low, high]."""
    return min(max(value, low), high)


@njit(cache=True)
def latest_departures(wanted: Array, spacing_s: float, slowest: float, fastest: float, departures: Array) -> None:
    """Where the plate has to be at each moment to arrive in time: the wanted temperatures limited backwards."""
    last = wanted.size - 1
    departures[last] = wanted[last]
    for i in range(last - 1, -1, -1):
        after = departures[i + 1]
        departures[i] = limited(wanted[i], after - fastest * spacing_s, after - slowest * spacing_s)


@njit(cache=True)
def next_temperature(
    wanted: Array, spacing_s: float, first_s: float, reference: float, slowest: float, fastest: float
) -> float:
    """The reference after first_s where temperatures themselves are wanted: half-way between now and in time."""
    departures = np.empty(wanted.size)
    latest_departures(wanted, spacing_s, slowest, fastest, departures)
    step = 0.5 * (wanted[0] + departures[0]) - reference
    return reference + limited(step, slowest * first_s, fastest * first_s)


@njit(cache=True)
def next_reference(
    targets: Array,
    band: float,
    toward: float,
    v_now: float,
    plays: Array,
    film: Packed,
    limits: Array,
    table: Array,
    spacing_s: float,
    first_s: float,
    reference: float,
    slowest: float,
    fastest: float,
) -> tuple[bool, float, float]:
    """(whether the first target can be reached, the reference after first_s, the output's move until then).

    The targets lie first_s, first_s + spacing_s, ... ahead; slowest < 0 < fastest are the plate's rates (K/s). Of
    several departure times, from `now` to `just in time`, the one is taken whose course, limited to the plate's
    rates and run through the film model, keeps the smallest squared error over the preview.
    """
    count = targets.size
    wanted, departures = np.empty(count), np.empty(count)
    reached = wanted_temperatures(targets, band, toward, v_now, plays.copy(), film, limits, table, wanted)
    latest_departures(wanted, spacing_s, slowest, fastest, departures)
    envelopes, radii, weights, code, par = film
    best, cheapest, best_move = reference, math.inf, 0.0
    before = memoryless_value(code, par, v_now) + play.weighted_sum(weights, plays)
    for choice in range(DEPARTURES):
        share = choice / (DEPARTURES - 1.0)
        memory = plays.copy()
        temperature, v, cost, first, move = reference, v_now, 0.0, reference, 0.0
        for i in range(count):
            dt = first_s if i == 0 else spacing_s
            step = wanted[i] + share * (departures[i] - wanted[i]) - temperature
            temperature += limited(step, slowest * dt, fastest * dt)
            play.advance(temperature, v, envelopes, radii, memory)
            v = temperature
            error = memoryless_value(code, par, v) + play.weighted_sum(weights, memory) - targets[i]
            cost += dt * error * error
            if i == 0:
                first, move = temperature, error + targets[i] - before
        if cost < cheapest:
            best, cheapest, best_move = first, cost, move
    return reached, best, best_move
