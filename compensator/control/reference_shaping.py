"""The temperature reference: the inverse looked up ahead, and shaped to what the plate can do.

A turning point of the wanted resistance makes the wanted temperature jump across the loop, and a plate has limited
rates: it must leave before the jump, or arrive after it. Which, the film decides: to make for the wanted temperature
now, and to leave just in time, are both run through the model, and the one with the smaller squared error over the
preview is taken.

A film that lags the plate, tau dT_f/dt = T_p - T_f, is taken along by T_p = T_f + tau dT_f/dt. The plate's rates then
limit the film's acceleration, and a film at rate u needs the distance

    tau (u - s ln(1 + u / s))        s: the plate's rate the other way

to come to rest: it is never faster than what stops it at its goal. Where the wanted temperature changes its rate, the
plate has to run ahead of the film by tau times the new rate, which takes it a while. So a lagging film makes for where
it will be wanted a little later; several such leads are run through the model, and the best one is taken.

How far ahead: as long as the plate takes across the film's loop, at most by whose width the wanted temperature jumps
(`crossing_s`). What lies further ahead than the crossing changes nothing of what to do now.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis import play
from compensator.hysteresis.film import FilmModel, Packed
from compensator.hysteresis.functions import Array
from compensator.inverse.branch import workspace
from compensator.inverse.search import HIGH, LOW, Settings, arrive, solve
from compensator.thermal.plate import PlateModel

LEADS: Final = 9  # of a lagging film: twice as many leave 0.93 of the error, half as many 1.3 times it
LONGEST_LEAD: Final = 0.6  # of the film's lag: the longest lead that is tried
CAUTION: Final = 1.0  # standard deviations of the output, by which a film stops short of a target that stays
CLOSES_S: Final = 0.3  # in which it then goes the rest of the way: some readings


class FilmNow(NamedTuple):
    """Film at this moment: temperature (degC), play operators, shape (operators,), its model and inverse's settings."""

    degC: float
    plays: Array
    model: Packed
    settings: Settings


class Turn(NamedTuple):
    """Condition for a reversal of the output: band, in its unit, and the sign of its last move; stays_degC: temperature
    until then."""

    band: float
    toward: float
    stays_degC: float


class Reach(NamedTuple):
    """Limits of the plate, and the times of the targets.

    The targets lie first_s, first_s + spacing_s, ... ahead; slowest < 0 < fastest are the plate's rates (K/s); lag_s:
    of the film behind the plate.
    """

    spacing_s: float
    first_s: float
    slowest: float
    fastest: float
    lag_s: float


class Reference(NamedTuple):
    """Reference of film and plate, degC; of the plate without the film's warming above it."""

    film_degC: float
    plate_degC: float


class Planned(NamedTuple):
    """Next reference.

    reference: at the first target's time. output: of the film model there; move: from its present output. reached: True
    if the first target can be reached.
    """

    reference: Reference
    output: float
    move: float
    reached: bool


@njit
def held_temperature(target: float, film: FilmNow, reference_degC: float) -> float:
    """Return the temperature (degC) of a film that need not move.

    It is the reference so far, unless that leads away from the target; then the film's own temperature. A reference
    that followed the film would take every drift of the plate for its own.
    """
    memory, envelopes, radii = film.plays.copy(), film.model[0], film.model[1]
    here = play.output_of(film.model, film.degC, memory)
    play.advance(reference_degC, film.degC, envelopes, radii, memory)
    there = play.output_of(film.model, reference_degC, memory)
    return reference_degC if (there - here) * (target - here) >= 0.0 else film.degC


@njit
def wanted_temperatures(targets: Array, turn: Turn, film: FilmNow, temperatures: Array) -> bool:
    """Fill the temperatures (degC) for the coming targets from the present memory; return True if the first is
    reachable.

    To go on the way of its last move the film needs little; to turn round it has to cross the loop, so that noise on
    the output would become degrees: a target within the band of the present output on the other side asks for no move.
    If a target cannot be reached, the temperature goes to the limit on its side.
    """
    first_reached, toward, band = True, turn.toward, turn.band
    held = held_temperature(targets[0], film, turn.stays_degC)
    v, memory, settings = film.degC, film.plays.copy(), film.settings
    limits = settings[0]
    envelopes, radii, _, _, _ = film.model
    work = workspace(film.model)
    for i in range(targets.size):
        output = play.output_of(film.model, v, memory)
        wanted = targets[i]
        gap = wanted - output
        if gap == 0.0 or (gap * toward <= 0.0 and abs(gap) <= band):
            temperatures[i] = held if v == film.degC else v
            continue
        toward = math.copysign(1.0, gap)
        found, v_next, _, _ = solve(wanted, v, film.model, settings, memory, work)
        if found:
            arrive(v_next, v, envelopes, radii, memory, work.points, work.here)
        else:
            first_reached = first_reached and i > 0
            v_next = limits[HIGH] if wanted > output else limits[LOW]
            play.advance(v_next, v, envelopes, radii, memory)
        v = v_next
        temperatures[i] = v
    return first_reached


@njit
def stop_short_by(targets: Array, doubt: float, film: FilmNow, toward: float, period_s: float) -> float:
    """Return the part of the way to a constant target that is left for later periods, signed, in the output's unit.

    It is the standard deviation of the output, and closes in `CLOSES_S`: to arrive late costs a moment; to arrive
    beyond costs an unplanned turning point. doubt: the variance of the output. toward: the sign of its last move. 0 if
    the target moves, or if the output has to turn round.
    """
    gap = targets[0] - play.output_of(film.model, film.degC, film.plays)
    if gap * toward <= 0.0 or np.max(targets) > np.min(targets):
        return 0.0
    later = math.exp(-period_s / CLOSES_S) * abs(gap)
    return math.copysign(min(later, CAUTION * math.sqrt(doubt)), gap)


@njit
def limited(value: float, low: float, high: float) -> float:
    """Return the value held within [low, high]."""
    return min(max(value, low), high)


@njit
def latest_departures(wanted: Array, reach: Reach, departures: Array) -> None:
    """Fill the latest temperatures that arrive in time: the wanted ones limited backwards by the plate's rates."""
    slowest, fastest = reach.slowest * reach.spacing_s, reach.fastest * reach.spacing_s
    last = wanted.size - 1
    departures[last] = wanted[last]
    for i in range(last - 1, -1, -1):
        after = departures[i + 1]
        departures[i] = limited(wanted[i], after - fastest, after - slowest)


@njit
def stopping_rate(distance: float, braking: float, lag_s: float) -> float:
    """Return the fastest rate (K/s, > 0) from which a lagging film comes to rest within a distance (K, >= 0)."""
    share = distance / (lag_s * braking)
    r = share + math.sqrt(2.0 * share)  # u / s, between its limits for short and long distances
    for _ in range(2):  # Newton: right to a thousandth
        if r > 0.0:
            r -= (r - math.log1p(r) - share) * (1.0 + r) / r
    return max(r, 0.0) * braking


@njit
def moved(now: Reference, goal: float, ahead_s: float, dt: float, reach: Reach) -> Reference:
    """Return the reference dt later on its way to a goal that is wanted ahead_s from now, at the plate's rates."""
    slowest, fastest, lag = reach.slowest * dt, reach.fastest * dt, reach.lag_s
    if lag == 0.0:
        degC = now.film_degC + limited(goal - now.film_degC, slowest, fastest)
        return Reference(degC, degC)
    gap = goal - now.film_degC
    most = stopping_rate(abs(gap), -reach.slowest if gap > 0.0 else reach.fastest, lag)
    rate = limited(gap / ahead_s, -most, most)
    step = limited(now.film_degC + (lag + dt) * rate - now.plate_degC, slowest, fastest)
    a = -math.expm1(-dt / lag)
    film = now.film_degC + a * (now.plate_degC - now.film_degC) + step * (1.0 - lag * a / dt)
    return Reference(film, now.plate_degC + step)


@njit
def first_goal(i: int, reach: Reach) -> tuple[int, float]:
    """Return (which goal the i-th step of the reference aims at, how far ahead it lies, s).

    A lagging film aims at the second one first: a rate over a single period would be noise, times the lag.
    """
    if i > 0:
        return i, reach.spacing_s
    return (0, reach.first_s) if reach.lag_s == 0.0 else (1, reach.first_s + reach.spacing_s)


@njit
def lead_of(choice: int, reach: Reach) -> int:
    """Return a lead, in targets: more of them are short than long."""
    share = choice / (LEADS - 1.0)
    return round(share * share * LONGEST_LEAD * reach.lag_s / reach.spacing_s)


@njit
def next_temperature(wanted: Array, now: Reference, reach: Reach) -> Reference:
    """Return the reference after first_s for wanted temperatures: half-way between now and just in time."""
    departures = np.empty(wanted.size)
    latest_departures(wanted, reach, departures)
    k, ahead_s = first_goal(0, reach)
    return moved(now, 0.5 * (wanted[k] + departures[k]), ahead_s, reach.first_s, reach)


@njit
def next_reference(targets: Array, turn: Turn, film: FilmNow, now: Reference, reach: Reach) -> Planned:
    """Return the reference after first_s. targets: outputs, shape (targets,).

    Of both departures, at once and just in time, or of several leads of a lagging film, the one is taken whose course,
    limited to the plate's rates and run through the film model, has the smallest squared error over the preview.
    """
    count, lagging = targets.size, reach.lag_s > 0.0
    wanted, departures = np.empty(count), np.empty(count)
    reached = wanted_temperatures(targets, turn, film, wanted)
    latest_departures(wanted, reach, departures)
    envelopes, radii, _, _, _ = film.model
    before = play.output_of(film.model, film.degC, film.plays)
    best, cheapest, best_output = now, math.inf, before
    choices = LEADS if lagging else 2
    if not lagging and np.array_equal(wanted, departures):  # nothing has to leave early: all courses are the same one
        choices, count = 1, 1
    for choice in range(choices):
        share = 0.0 if lagging else float(choice)
        lead = lead_of(choice, reach) if lagging else 0
        memory = film.plays.copy()
        at, v, cost, first, output = now, film.degC, 0.0, now, before
        for i in range(count):
            dt = reach.first_s if i == 0 else reach.spacing_s
            k, ahead_s = first_goal(i, reach)
            further = min(lead, count - 1 - k)
            goal = wanted[k + further] + share * (departures[k] - wanted[k])
            at = moved(at, goal, ahead_s + further * reach.spacing_s, dt, reach)
            play.advance(at.film_degC, v, envelopes, radii, memory)
            v = at.film_degC
            error = play.output_of(film.model, v, memory) - targets[i]
            cost += dt * error * error
            if i == 0:
                first, output = at, error + targets[i]
        if cost < cheapest:
            best, cheapest, best_output = first, cost, output
    return Planned(best, best_output, best_output - before, reached)


@njit
def direction_after(toward: float, before: Reference, plan: Planned) -> float:
    """Return the sign of the output's last move, with this plan's."""
    if plan.move != 0.0 and plan.reference.film_degC != before.film_degC:
        return math.copysign(1.0, plan.move)
    return toward


STEP_K: Final = 0.05  # of the grid on which the branches are compared; a loop is some kelvin wide
TAIL: Final = 0.02  # of the major loop's range at either end, where its branches run together and a width means nothing
POINTS: Final = 12  # targets over a crossing: with twice as many the error is 2 % less (`benchmark tracking`, slow)
POINTS_OF_A_LAG: Final = 20  # targets over a film's lag: half as many leave 1.3 times the error of 2 s, twice the same
LONGEST_S: Final = 120.0  # of a heater that cools by itself; a step of the law takes longer with each target


def crossing_s(film: FilmModel, plate: PlateModel, limit_A: float, low_degC: float, high_degC: float) -> float:
    """Return the longest time (s) in which the plate, within its current limit, crosses the film's major loop.

    A crossing leads from one branch to the other at the same output; 0 for a film without a loop in this range.
    """
    grid = np.arange(low_degC, high_degC, STEP_K)
    if grid.size < 2:
        return 0.0
    rising, _ = film.simulate(grid, film.initial_memory(low_degC, "heated"))
    falling, _ = film.simulate(grid[::-1], film.initial_memory(high_degC, "cooled"))
    rising, falling = np.maximum.accumulate(rising), np.maximum.accumulate(falling[::-1])
    least, most = max(rising[0], falling[0]), min(rising[-1], falling[-1])
    inside = TAIL * (most - least)
    levels = np.linspace(least + inside, most - inside, 200)
    up, down = np.interp(levels, rising, grid), np.interp(levels, falling, grid)
    longest = 0.0
    for warm, cold in zip(up, down, strict=True):
        if warm > cold:
            cooling, heating = plate.rate_range_K_per_s(0.5 * float(warm + cold), limit_A)
            slower = min(-cooling, heating)
            longest = max(longest, float(warm - cold) / slower if slower > 0.0 else LONGEST_S)
    return min(longest, LONGEST_S)


def preview(horizon_s: float, period_s: float, lag_s: float = 0.0) -> tuple[int, float]:
    """Return (how many targets, how far apart in s) over a horizon: at least two, no closer than a period.

    lag_s: of the film behind the plate, which must know in time how its goals change their rate.
    """
    spacing_s = horizon_s / POINTS
    if lag_s > 0.0:
        spacing_s = min(spacing_s, lag_s / POINTS_OF_A_LAG)
    spacing_s = max(period_s, spacing_s)
    return max(2, math.ceil(horizon_s / spacing_s - 1e-9)), spacing_s
