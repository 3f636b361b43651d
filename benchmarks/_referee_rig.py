"""The referee's simulation of a Peltier rig with a VO2 film; nothing here is taken from the program.

The plate is integrated in steps of 0.05 s (Runge-Kutta of fourth order), which end at every tick of the controller and
wherever the current changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])
compiled = cast(Callable[[F], F], njit(cache=True))

STEP_S = 0.05
ZERO_K = 273.15
PI_FILM, RELAY_FILM, LIMITING_LOOP = 0, 1, 2
# heat W, factor of the conductance, room K, 1 where a command is lost, looseness, film K
NOTHING_OUTSIDE = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


class Rig(NamedTuple):
    """Plate, thermometer, driver, film temperature and meter; what is 0 is switched off."""

    capacity: float  # J/K
    seebeck: float  # V/K at 25 degC
    resistance: float  # ohm at 25 degC
    conductance: float  # W/K
    room: float  # degC at the first row
    seebeck_slope: float  # 1/K
    resistance_slope: float
    current_limit: float  # A
    delay: float = 0.0
    deadband: float = 0.0
    cooling_gain: float = 1.0
    sink_capacity: float = 0.0  # J/K
    sink_conductance: float = 0.0  # W/K
    radiation: float = 0.0  # W/K^4
    room_drift: float = 0.0  # K/s
    holder_coupling: float = 0.0  # W/K
    holder_capacity: float = 1.0  # J/K
    evaporation: float = 0.0  # W at 25 degC
    sensor_tau: float = 0.0
    sensor_step: float = 0.0
    pickup: float = 0.0  # K/A
    film_tau: float = 0.0
    film_drift: float = 0.0  # K/s
    theta: float = 0.0  # K/W
    creep_share: float = 0.0
    creep_tau: float = 1.0
    meter_tau: float = 0.0
    skew: float = 0.0
    series: float = 0.0
    leakage: float = math.inf
    range_threshold: float = math.inf
    range_error: float = 0.0


class Film(NamedTuple):
    """Film: y = D(T) + H, with H of play operators (first radii, then weights) or of relays (up, down, weights)."""

    kind: int
    first: Array
    second: Array
    weights: Array
    by_second: NDArray[np.int64]  # relays in the order of their lower threshold
    envelope: Array  # shape (0 tanh, 1 erf), steepness and centre on heating, on cooling; centre and width of the film
    memoryless: Array  # form (0 Arrhenius, 1 tanh, 2 line), slope, scale, offset
    mixing: int  # 0 log R adds up, 1 effective medium in two dimensions, 2 in series
    decades: float
    coupling: float  # K by which all grains metallic ease the others


class Run(NamedTuple):
    """Result of a simulation: at the ticks, and -log10 of the film's resistance at fine times."""

    reading: Array
    current: Array
    meter_current: Array
    plate: Array
    film: Array
    fine_s: Array
    fine_y: Array


@compiled
def sigmoid(x: float, shape: float) -> float:
    """Return an envelope's value."""
    return math.tanh(x) if shape == 0 else math.erf(x)


@compiled
def memoryless_part(v: float, d: Array) -> float:
    """Return D at a temperature in degC; its slope at 25 degC (room) is d[1] dec/K, except for the tanh."""
    if d[0] == 0:
        return float(d[3] + d[1] * 298.15**2 * (1 / 298.15 - 1 / (v + 273.15)))
    if d[0] == 1:
        return float(d[3] + d[1] * d[2] * math.tanh((v - 25) / d[2]))
    return float(d[3] + d[1] * (v - 25))


@compiled
def film_step(v: float, film: Film, memory: Array, at: Array) -> float:
    """Bring the film to a temperature, from the last one in at[0], and return its hysteretic part H."""
    if film.kind == 0:
        e = film.envelope
        up, down = sigmoid(e[1] * (v - e[2]), e[0]), sigmoid(e[3] * (v - e[4]), e[0])
        total, rises, falls = 0.0, v > at[0], v < at[0]
        for j in range(memory.size):
            if rises and up - film.first[j] > memory[j]:
                memory[j] = up - film.first[j]
            elif falls and down + film.first[j] < memory[j]:
                memory[j] = down + film.first[j]
            total += film.weights[j] * memory[j]
        at[0] = v
        return total
    if film.kind == 1:
        # at[1]: metallic share, at[2], at[3]: relays whose upper, lower threshold is below the temperature.
        # An avalanche of coupled grains ends within the step: its duration would else be that of the steps
        plate, before = v, math.nan
        while at[1] != before:
            before = at[1]
            v = plate + film.coupling * (at[1] - 0.5)
            while at[2] < memory.size and film.first[int(at[2])] <= v:
                j = int(at[2])
                if memory[j] == 0:
                    memory[j] = 1
                    at[1] += film.weights[j]
                at[2] += 1
            while at[2] > 0 and film.first[int(at[2]) - 1] > v:
                at[2] -= 1
            while at[3] < memory.size and film.second[film.by_second[int(at[3])]] < v:
                at[3] += 1
            while at[3] > 0 and film.second[film.by_second[int(at[3]) - 1]] >= v:
                at[3] -= 1
                j = film.by_second[int(at[3])]
                if memory[j] == 1:
                    memory[j] = 0
                    at[1] -= film.weights[j]
        metal = min(max(at[1], 0.0), 1.0)
    else:
        # limiting-loop proximity, L. A. L. de Almeida et al., Opt. Eng. 41 (2002) 2582; memory: direction, turning
        # point, proximity temperature
        beta, centre, half = film.envelope[1], film.envelope[2], film.envelope[3]
        if (v - at[0]) * memory[0] < 0:
            share = min(max(1 - at[1], 1e-9), 1 - 1e-9)
            memory[0] = -memory[0]
            memory[1] = at[0]
            memory[2] = memory[0] * half + centre - math.atanh(2 * share - 1) / beta - at[0]
        near = 0.0
        if abs(memory[2]) > 1e-9:
            x = (v - memory[1]) / memory[2]
            near = memory[2] * 0.5 * (1 - math.sin(0.956 * min(x, 3.0))) * (1 + math.tanh(math.pi**2 - 2 * math.pi * x))
        metal = 0.5 - 0.5 * math.tanh(beta * (memory[0] * half + centre - v - near))
        at[0], at[1] = v, metal
    if film.mixing == 0:
        return float(film.decades * metal)
    ratio = math.pow(10.0, film.decades)
    if film.mixing == 1:
        b = ratio * (2 * metal - 1) + (1 - 2 * metal)
        return math.log10((b + math.sqrt(b * b + 4 * ratio)) / 2)
    return -math.log10(1 - metal + metal / ratio)


@compiled
def rates(x: Array, current: float, rig: Rig, room: float, conductance: float, heat: float, out: Array) -> None:
    """Write the rates of plate, sink, thermometer, film, holder (K/s) and of the water's latent heat (W) to out."""
    plate, kelvin = x[0], x[0] + ZERO_K
    # Seebeck coefficient and resistance are those at the plate's temperature, at the sink too
    seebeck = rig.seebeck * (1 + rig.seebeck_slope * (plate - 25))
    joule = 0.5 * rig.resistance * (1 + rig.resistance_slope * (plate - 25)) * current * current
    far = x[1] if rig.sink_capacity > 0 else room
    flow = conductance * (plate - far)
    # Magnus: the saturation pressure of water, as a multiple of that at 25 degC
    vapour = math.exp(17.62 * plate / (243.12 + plate) - 17.62 * 25 / (243.12 + 25))
    wet = rig.evaporation * vapour * x[5] / (abs(x[5]) + 5.0)
    loss = flow + rig.radiation * (kelvin**4 - (room + ZERO_K) ** 4) + rig.holder_coupling * (plate - x[4]) + wet
    out[0] = (seebeck * current * kelvin + joule - loss + heat) / rig.capacity
    out[1] = 0.0
    if rig.sink_capacity > 0:
        pumped = joule - seebeck * current * (x[1] + ZERO_K)
        out[1] = (pumped + flow - rig.sink_conductance * (x[1] - room)) / rig.sink_capacity
    out[2] = (plate - x[2]) / rig.sensor_tau if rig.sensor_tau > 0 else out[0]
    out[3] = (plate - x[3]) / rig.film_tau if rig.film_tau > 0 else out[0]
    out[4] = rig.holder_coupling * (plate - x[4]) / rig.holder_capacity
    out[5] = -wet


@compiled
def film_at(
    warm: float, now: float, y: float, creeping: float, heating: float, rounds: int,
    rig: Rig, film: Film, memory: Array, at: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Return film temperature, hysteretic part and y of a film whose substrate is at a temperature.

    heating: theta I^2 in K/ohm. R falls as T rises: steps no longer than Newton's at the steepest slope approach
    without overshoot.
    """
    steep = film.decades / film.envelope[6] * 1.5 + 0.03
    hysteretic = 0.0
    for _ in range(rounds if heating > 0 else 1):
        warmer = heating * 10.0**-y
        now = warm if heating == 0 else now + (warm + warmer - now) / (1 + 2.3026 * steep * warmer)
        hysteretic = film_step(now, film, memory, at)
        y = memoryless_part(now, film.memoryless) + hysteretic + rig.creep_share * (creeping - hysteretic)
    return now, hysteretic, y


@compiled
def simulate(
    ticks: Array, replay: Array, plan: Array, gains: Array, noise: Array, outside: Array, meter: Array,
    rig: Rig, film: Film, memory: Array, at: Array, start: Array, with_film: bool,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Run the rig over its controller's ticks.

    replay: currents to repeat, or none. plan: setpoint, feedforward current, 1 where the operator decides, dither, by
    tick. gains: proportional, integral, step of the current. outside: heat, conductance's factor, room's offset, 1
    where a command is lost, looseness, film's offset, by tick. meter: factor of the test current by tick, 0 for the
    fixed current meter[-2], rows between two decisions meter[-1].
    """
    n = ticks.size
    reading, current, tested = np.zeros(n), np.zeros(n), np.zeros(n)
    plates, films = np.zeros(n), np.zeros(n)
    room_for = int((ticks[-1] - ticks[0] + 14) / STEP_S) + 6 * n
    fine_s, fine_y = np.zeros(room_for), np.zeros(room_for)
    x, trial, total, d = start.copy(), start.copy(), start.copy(), start.copy()
    integral, base, applied, driven = 0.0, 0.0, 0.0, -1
    arrived = np.zeros(n)
    t, count, meter_exponent = ticks[0], 0, 3
    test, now = meter[-2], start[3]
    hysteretic = film_step(now, film, memory, at) if with_film else 0.0
    creeping = hysteretic
    y = memoryless_part(now, film.memoryless) + hysteretic
    for k in range(n):
        if with_film and k % int(meter[-1]) == 0:
            ohm = 10.0 ** min(-y, 9.0)
            while ohm > 1.2 * 10.0**meter_exponent and meter_exponent < 9:
                meter_exponent += 1
            while ohm < 0.1 * 10.0**meter_exponent and meter_exponent > 0:
                meter_exponent -= 1
        room = rig.room + rig.room_drift * (t - ticks[0]) + outside[k, 2]
        effective = applied if abs(applied) >= rig.deadband else 0.0
        value = x[2] + rig.pickup * effective - outside[k, 4] * (x[0] - room) + noise[k]
        if rig.sensor_step > 0:
            value = round(value / rig.sensor_step) * rig.sensor_step
        reading[k], plates[k], films[k], tested[k] = value, x[0], now, test
        if meter[k] > 0:
            test = meter[k] * min(max(10.0**-meter_exponent, 1e-7), 1e-3) if meter[-2] == 0 else meter[k] * meter[-2]
        if k == 0:
            tested[0] = test
            if with_film:
                # the test current has heated the film before the first row
                warm = x[3] + outside[0, 5]
                now, hysteretic, y = film_at(warm, now, y, creeping, rig.theta * test * test, 80, rig, film, memory, at)
                y += rig.creep_share * (hysteretic - creeping)
                creeping, films[0] = hysteretic, now
            fine_s[0], fine_y[0] = t, y
            count = 1
        if replay.size > 0:
            current[k] = replay[k]
        else:
            if plan[k, 2] > 0:
                error = plan[k, 0] - value
                span = ticks[k] - ticks[k - 1] if k > 0 else 0.0
                base = plan[k, 1] + gains[0] * error + integral
                if abs(base) < rig.current_limit:
                    integral += gains[1] * error * span
            wanted = min(max(base + plan[k, 3], -rig.current_limit), rig.current_limit)
            current[k] = round(round(wanted / gains[2]) * gains[2], 6)
        arrived[k] = arrived[k - 1] if outside[k, 3] > 0 and k > 0 else current[k]
        end = ticks[k + 1] if k + 1 < n else ticks[k] + 9.0
        while t < end - 1e-9:
            while driven < k and ticks[driven + 1] + rig.delay <= t + 1e-9:
                driven += 1
                applied = arrived[driven]
            until = min(t + STEP_S, end)
            if driven < k:
                until = min(until, ticks[driven + 1] + rig.delay)
            h = until - t
            effective = applied if abs(applied) >= rig.deadband else 0.0
            if effective < 0:
                effective *= rig.cooling_gain
            total[:] = 0.0
            trial[:] = x
            for stage in range(4):
                ahead = 0.0 if stage == 0 else (h if stage == 3 else h / 2)
                room = rig.room + rig.room_drift * (t + ahead - ticks[0]) + outside[k, 2]
                rates(trial, effective, rig, room, rig.conductance * outside[k, 1], outside[k, 0], d)
                total += d * (h / 6 if stage in (0, 3) else h / 3)
                trial[:] = x + d * (h / 2 if stage < 2 else h)
            x += total
            t = until
            if rig.sensor_tau == 0:
                x[2] = x[0]
            if rig.film_tau == 0:
                x[3] = x[0]
            if with_film:
                hysteretic_before = hysteretic
                warm = x[3] + rig.film_drift * (t - ticks[0]) + outside[k, 5]
                now, hysteretic, y = film_at(warm, now, y, creeping, rig.theta * test * test, 8, rig, film, memory, at)
                # the lag's exact answer to a line; Euler's step would show in a film that switches fast
                slope = (hysteretic - hysteretic_before) / h
                slow = hysteretic_before - creeping - slope * rig.creep_tau
                followed = hysteretic - slope * rig.creep_tau - slow * math.exp(-h / rig.creep_tau)
                y += rig.creep_share * (followed - creeping)
                creeping = followed
            fine_s[count], fine_y[count] = t, y
            count += 1
    return reading, current, tested, plates, films, fine_s[:count], fine_y[:count]


@compiled
def lagged(times: Array, values: Array, tau: float) -> Array:
    """Filter values by a first-order lag; between two times they are a line."""
    out = values.copy()
    for k in range(1, values.size):
        h = times[k] - times[k - 1]
        slope = (values[k] - values[k - 1]) / h
        out[k] = values[k] - slope * tau + (out[k - 1] - values[k - 1] + slope * tau) * math.exp(-h / tau)
    return out


@compiled
def film_outputs(temperature: Array, film: Film, memory: Array, at: Array) -> Array:
    """Return y along a sequence of film temperatures; memory and at are changed."""
    out = np.zeros(temperature.size)
    for k in range(temperature.size):
        out[k] = film_step(temperature[k], film, memory, at) + memoryless_part(temperature[k], film.memoryless)
    return out
