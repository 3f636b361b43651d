"""Temperature profiles: damped cycles at several rates with dwells; steps and dithers; waves; one rate only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _along(pieces: list[tuple[float, float]], start: float, time: Array) -> Array:
    """Setpoints through pieces (temperature, seconds to get there)."""
    at = np.concatenate(([0.0], np.cumsum([seconds for _, seconds in pieces])))
    return np.interp(time, at, [start, *(value for value, _ in pieces)])


def damped_cycles(rng: np.random.Generator, time: Array, start: float, low: float, high: float,
                  rates: Array) -> Array:  # fmt: skip
    """Out to the ends of the transition, then ever smaller loops inside it, again and again, each side at one of the
    rates; dwells at the turning points and on the way. `rates` in K/s."""
    pieces, here, spent = [(start, float(rng.uniform(15.0, 40.0)))], start, 0.0
    centre, shrink = 0.5 * (low + high), 1.0
    top = high
    while spent < time[-1]:
        up = here < centre
        reach = 0.5 * (high - low) * shrink
        target = centre + float(rng.uniform(-0.1, 0.1)) * reach + (reach if up else -reach)
        target = min(top, max(low, target))
        rate = float(rng.choice(rates)) if shrink < 0.9 else float(rates[len(pieces) % rates.size])
        if rng.random() < 0.45:  # a stop on the way
            stop = here + float(rng.uniform(0.3, 0.7)) * (target - here)
            pieces.append((stop, abs(stop - here) / rate))
            pieces.append((stop, float(rng.uniform(8.0, 45.0))))
            here = stop
        pieces.append((target, max(abs(target - here) / rate, 1.0)))
        if rng.random() < 0.5:
            pieces.append((target, float(rng.uniform(5.0, 40.0))))
        here = target
        spent = sum(seconds for _, seconds in pieces)
        shrink *= float(rng.uniform(0.78, 0.93))
        if shrink < 0.12:
            shrink = 1.0
    return _along(pieces, start, time)


def steps_and_dithers(rng: np.random.Generator, time: Array, start: float, low: float, high: float) -> Array:
    """A staircase through the transition and back, with dwells, and a dither on some of them."""
    out, here, filled = np.empty(time.size), start, 0
    up, extreme, interval_s = True, high, float(time[1] - time[0])
    while filled < time.size:
        size = float(rng.uniform(1.0, 7.0))
        target = min(extreme, here + size) if up else max(low, here - size)
        if here < low and up:
            target = low
        if target in (extreme, low):
            up = target == low
            extreme = float(rng.uniform(0.5 * (low + high), high))
        ramp = max(abs(target - here) / float(rng.choice([0.3, 0.5, 0.6])), 1.0)
        dwell = float(rng.uniform(15.0, 60.0))
        n = int((ramp + dwell) / interval_s)
        local = np.arange(n) * interval_s
        piece = np.interp(local, [0.0, ramp], [here, target])
        if rng.random() < 0.5:
            period, size = float(rng.uniform(15.0, 45.0)), float(rng.uniform(0.4, 1.8))
            piece += np.where(local > ramp, size * np.sin(2.0 * np.pi * (local - ramp) / period), 0.0)
        taken = min(n, time.size - filled)
        out[filled : filled + taken] = piece[:taken]
        filled += taken
        here = float(piece[-1])
    return out


def triangles(time: Array, start: float, low: float, high: float, rates: tuple[float, ...]) -> Array:
    """Full loops whose corners lie outside the transition, at one rate or a few in turn."""
    pieces, here, side, turn = [(start, 20.0)], start, high, 0
    while sum(seconds for _, seconds in pieces) < time[-1]:
        rate = rates[(turn // 2) % len(rates)]
        pieces.append((side, abs(side - here) / rate))
        here, side, turn = side, (low if side == high else high), turn + 1
    return _along(pieces, start, time)


def waves(time: Array, start: float, low: float, high: float, period_s: float = 150.0) -> Array:
    """A sine through the transition whose amplitude rises and falls, seven periods each time."""
    swing = 0.45 + 0.55 * np.cos(2.0 * np.pi * (time - 60.0) / (7.3 * period_s)) ** 2
    out = 0.5 * (low + high) - 0.5 * (high - low) * swing * np.cos(2.0 * np.pi * (time - 60.0) / period_s)
    before = time < 60.0
    out[before] = np.interp(time[before], [0.0, 60.0], [start, low])
    return out


def meter_currents(rng: np.random.Generator, time: Array, high_A: float, factor: float = 3.0) -> Array:
    """The ohmmeter's test current: high and a third of it, in blocks of minutes."""
    out, at, up = np.empty(time.size), 0.0, bool(rng.random() < 0.5)
    while at < time[-1] + 1.0:
        length = float(rng.uniform(120.0, 420.0))
        out[(time >= at) & (time < at + length)] = high_A if up else high_A / factor
        at, up = at + length, not up
    return out
