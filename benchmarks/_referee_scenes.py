"""Rigs, films, instruments, profiles and logs of the referee's simulated records, drawn at random."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks._referee_rig import (
    LIMITING_LOOP,
    NOTHING_OUTSIDE,
    PI_FILM,
    RELAY_FILM,
    ZERO_K,
    Array,
    Film,
    Rig,
    Run,
    film_outputs,
    lagged,
    sigmoid,
    simulate,
)

Columns = dict[str, Array]

PROFILES = ("triangles", "damped", "steps", "staircase", "reversals", "mixed", "hand", "prbs")


class Log(NamedTuple):
    """Instruments and log file: the same for all records of a rig."""

    period: float  # s between rows
    jitter: float  # of the period
    every: int  # ticks of the controller to a row
    time_digits: int
    noise_K: float
    step_K: float  # the file's last digit
    noise_dec: float
    noise_ratio: float  # noise of the upper half of the decades to that of the lower
    counts: float  # of the ohmmeter's full scale
    top_ohm: float  # beyond this the meter reads inf
    fixed_A: float  # test current; 0: that of the meter's range
    switched: bool  # the test current changes by a factor of 3 now and then
    repeats: int  # rows to a reading of a slow meter
    offset_s: float  # time after a row at which its resistance is read, known if not 0
    tested: bool  # the test current is logged


class Scene(NamedTuple):
    """Conditions of a record: times, plan and noise by tick, the state at the first row, and the rows of the log."""

    ticks: Array
    plan: Array
    gains: Array
    noise: Array
    outside: Array
    meter: Array
    memory: Array
    at: Array
    start: Array
    rows: NDArray[np.int64]
    profile: str
    cause: str
    size: float


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(low * (high / low) ** rng.random())


def draw_rig(rng: np.random.Generator) -> Rig:
    """Draw a rig without effects."""
    return Rig(
        log_uniform(rng, 3, 60), rng.uniform(0.03, 0.06), rng.uniform(1, 3), rng.uniform(0.3, 0.8), rng.uniform(17, 29),
        rng.uniform(0.001, 0.003), rng.uniform(0.0035, 0.0045), rng.uniform(4, 6),
    )  # fmt: skip


def draw_film(rng: np.random.Generator, other: str) -> Film:
    """Draw a film of play operators, or one of another kind; it conducts better above 40 to 75 degC."""
    centre, width, decades = rng.uniform(40, 75), rng.uniform(3, 15), rng.uniform(1, 4)
    cold_ohm = log_uniform(rng, max(1e3, 20 * 10**decades), 2e6)
    slope = rng.uniform(0.05, 0.28) / (8.617e-5 * 298.15**2 * math.log(10))  # 0.05 to 0.28 eV, in dec/K
    scale = max(centre - 25, 10) * rng.uniform(0.7, 1.2)  # K; where a tanh for D flattens
    memoryless = np.array([float(rng.integers(3)), slope, scale, -math.log10(cold_ohm)])
    if other in ("", "limiting_loop"):
        steep = 1.76 / width  # FWHM of the derivative of tanh(a v) is 1.76 / a
        order = np.zeros(1, np.int64)
        if other:
            envelope = np.array([0, steep, centre, rng.uniform(1, 5), 0, centre, width])
            return Film(LIMITING_LOOP, np.zeros(1), np.zeros(1), np.ones(1), order, envelope, memoryless, 2, decades, 0)
        radii = np.sort(rng.beta(1, rng.uniform(1.5, 4), rng.integers(24, 41))) * rng.uniform(0.3, 0.85)
        weights = np.exp(-radii / rng.uniform(0.15, 1.5)) * rng.gamma(4, 0.25, radii.size)
        weights *= decades / (2 * weights * (1 - radii)).sum()
        gap = rng.uniform(0.5, 4)
        falling = steep * rng.uniform(0.9, 1.1)
        shape = float(rng.random() < 0.15)
        envelope = np.array([shape, steep, centre + gap / 2, falling, centre - gap / 2, centre, width])
        v = np.linspace(-30, 140, 1000)
        gamma = [np.array([sigmoid(a * (one - b), shape) for one in v]) for a, b in (envelope[1:3], envelope[3:5])]
        # keep the order condition: the lower wall is not above the upper one
        radii = np.maximum(radii, (gamma[0] - gamma[1]).max() / 2 + 1e-6)
        memoryless[3] += (weights * (1 - radii)).sum()
        return Film(PI_FILM, radii, np.zeros(1), weights, order, envelope, memoryless, 0, decades, 0)
    grains = int(rng.integers(25, 61) if other == "few_grains" else rng.integers(1000, 4001))
    middle = rng.normal(0, 1, grains)
    typical, spread = rng.uniform(2.5, 8), rng.uniform(0.3, 0.6)
    half = typical / 2 * np.exp(spread * rng.normal(0, 1, grains))
    if other == "bell_relays":
        half = np.abs(rng.normal(typical, typical / 4, grains)) / 2
    elif other == "wide_late_grains":
        half *= np.exp(0.5 * middle)
    up, down = centre + middle * width / 2.355 + half, centre + middle * width / 2.355 - half
    order = np.argsort(up)
    up, down = up[order], down[order]
    weights = rng.gamma(2, 0.5, grains)
    coupling = rng.uniform(0.3, 0.8) * width / 2.355 if other == "coupled_grains" else 0.0
    envelope = np.array([0, 1.76 / width, centre + typical / 2, 1.76 / width, centre - typical / 2, centre, width])
    mixing = int(other == "effective_medium")
    return Film(
        RELAY_FILM, up, down, weights / weights.sum(), np.argsort(down), envelope, memoryless, mixing, decades, coupling
    )


def conditioned(film: Film, rng: np.random.Generator, first_degC: float, inside: bool) -> tuple[Array, Array]:
    """Return the film's memory at the first row: cooled from the hot end, or inside the loop after some turns."""
    memory = np.zeros(film.first.size)
    at = np.array([-50.0, 0.0, 0.0, 0.0])
    if film.kind == PI_FILM:
        memory = np.minimum(-1 + film.first, 1 - film.first)
    elif film.kind == LIMITING_LOOP:
        memory = np.array([1.0, -50.0, 0.0])
    centre, width = film.envelope[5:7]
    turns = [-50.0, 150.0, *(rng.uniform(centre - width, centre + width, 4) if inside else [0.0]), first_degC]
    path = np.concatenate([np.linspace(a, b, 800) for a, b in pairwise(turns)])
    film_outputs(path, film, memory, at)
    return memory, at


def film_ends(film: Film) -> tuple[float, float]:
    """Return y before and after the transition."""
    centre, width = film.envelope[5:7]
    memory, at = conditioned(film, np.random.default_rng(0), centre - 1.5 * width, False)
    path = np.linspace(centre - 1.5 * width, centre + 1.5 * width, 500)
    outputs = film_outputs(path, film, memory, at)
    return float(outputs[0]), float(outputs[-1])


def draw_log(rng: np.random.Generator, rig: Rig, film: Film, heated: bool) -> Log:
    """Draw instruments and file; where a self-heating is hidden the test current changes and is logged."""
    cold = -film_ends(film)[0]
    longest = min(5.0, max(0.6, rig.capacity / rig.conductance / 5))
    period = log_uniform(rng, 0.5, longest)
    if rng.random() < 0.4:
        period = max(one for one in (0.5, 1.0, 2.0, 5.0) if one <= longest)
    noise_K = log_uniform(rng, 0.001, 0.03)
    mode = rng.choice(["ranges", "fixed", "switched"], p=[0.6, 0.0, 0.4] if heated else [0.45, 0.3, 0.25])
    # at most 0.1 mW in the cold film
    fixed = 0.0 if mode == "ranges" else 10.0 ** min(math.floor((-4 - cold) / 2), -3)
    repeats = int(rng.integers(2, 4)) if rng.random() < 0.05 else 1
    # a repeated reading, or one with a test current that heats, belongs to its row's time
    offset = 0.0 if heated or repeats > 1 or rng.random() > 0.1 else round(rng.uniform(0.1, 0.4) * period, 2)
    return Log(
        period=period,
        jitter=log_uniform(rng, 0.001, 0.03),
        every=int(rng.integers(2, 5)) if rng.random() < 0.08 else 1,
        time_digits=int(rng.choice([2, 3])),
        noise_K=noise_K,
        step_K=float(rng.choice([one for one in (1e-4, 1e-3, 1e-2) if one <= 3 * noise_K])),
        noise_dec=log_uniform(rng, 3e-4, 5e-3),
        noise_ratio=3.0 if rng.random() < 0.15 else 1.0,
        counts=float(rng.choice([5e4, 2e5, 2e6])),
        top_ohm=10 ** (cold - 0.2) if rng.random() < 0.06 else math.inf,
        fixed_A=fixed,
        switched=mode == "switched",
        repeats=repeats,
        offset_s=offset,
        tested=heated or rng.random() < 0.7,
    )


def draw_plan(
    rng: np.random.Generator, rig: Rig, film: Film, ticks: Array, first_degC: float, profile: str, delay: float
) -> tuple[Array, Array]:
    """Draw setpoint, feedforward, decisions and dither by tick, and the gains of the controller or of a hand."""
    centre, width = film.envelope[5:7]
    wide = rng.uniform(1.0, 1.7) * width + 4
    low, high = max(centre - wide, 20.0), min(centre + wide, 95.0)
    span, duration, period = high - low, ticks[-1] - ticks[0], float(np.median(np.diff(ticks)))
    slew = 0.35 * rig.seebeck * 310 * rig.current_limit / rig.capacity
    slowest = 6 * span / duration
    rate = log_uniform(rng, min(max(slowest, 0.03), slew), max(min(15 * slowest, 1.5, slew), slowest, 0.03))
    rate = min(rate, slew)
    rest, by_hand = rig.capacity / rig.conductance, profile in ("hand", "prbs")
    times, values = [0.0], [first_degC]

    def go(target: float, speed: float, dwell: float = 0.0) -> None:
        times.append(times[-1] + abs(target - values[-1]) / speed + 1e-3)
        values.append(target)
        times.append(times[-1] + dwell + 1e-3)
        values.append(target)

    pause = rng.uniform(0, 0.3) * span / rate
    go(high, rate, pause)
    go(low, rate, pause)
    while times[-1] < duration:
        form = str(rng.choice(PROFILES[:5])) if profile == "mixed" else profile
        if form == "triangles":
            speed = rate * rng.choice([0.5, 1.0, 2.0])
            go(high, min(speed, slew), pause)
            go(low, min(speed, slew), pause)
        elif form == "damped":
            middle, half, sign = rng.uniform(centre - width / 4, centre + width / 4), span / 2, 1
            while half > 0.06 * span:
                go(min(max(middle + sign * half, low), high), rate, pause / 2)
                half, sign = half * rng.uniform(0.75, 0.92), -sign
        elif form == "staircase":
            turn, steps = rng.uniform(centre, high), int(rng.integers(5, 15))
            for level in [*np.linspace(low, turn, steps), *np.linspace(turn, low, steps)]:
                go(level, slew, span / rate / steps)
        elif form == "reversals":
            go(high, rate, pause)
            go(rng.uniform(centre - 0.8 * width, centre + 0.6 * width), rate, pause)
        else:
            speed, hold = (rate, 2 * rest) if by_hand else (slew, span / rate / 3)
            go(rng.uniform(max(low, centre - width), min(high, centre + width)), speed, hold * rng.uniform(0.3, 1.5))
    setpoint = np.interp(ticks - ticks[0], times, values)
    # current of the steady state: S I T + R I^2 / 2 = G (T - T_a)
    a, b = rig.resistance / 2, rig.seebeck * (setpoint + ZERO_K)
    holding = rig.conductance * (setpoint - rig.room)
    feedforward = (np.sqrt(np.maximum(b * b + 4 * a * holding, 0.25 * b * b)) - b) / (2 * a)
    plan = np.stack([setpoint, feedforward, np.ones(ticks.size), np.zeros(ticks.size)], axis=1)
    lift = rig.seebeck * 320 / rig.capacity  # K/s per ampere
    bandwidth = min(0.3 / (period + delay), rng.uniform(3, 20) / rest)
    gains = np.array([bandwidth / lift, bandwidth**2 / lift / 6, float(rng.choice([1e-4, 1e-3, 0.01]))])
    if by_hand:
        every = min(max(rng.uniform(0.3, 1.0) * rest, 10.0), 90.0)
        plan[:, 2] = np.diff(np.floor(ticks / every), prepend=-1.0) > 0
        gains = np.array([0.4 / lift / (rest + delay), 0.0, float(rng.choice([0.02, 0.05, 0.1]))])
        if profile == "prbs":
            bits = np.floor(ticks / max(rng.uniform(0.1, 0.4) * rest, 2 * period)).astype(int)
            plan[:, 3] = rng.choice([-1, 1], bits.max() + 1)[bits] * rng.uniform(0.2, 0.6) * rig.conductance * 20
            plan[:, 3] /= rig.seebeck * 320
    return plan, gains


def draw_scene(
    rng: np.random.Generator, rig: Rig, film: Film, log: Log, rows: int, cause: tuple[str, float], delay: float
) -> Scene:
    """Draw times, profile, state and memory at the first row, missing rows, and when an outside cause acts."""
    n = rows * log.every
    period = log.period / log.every
    steps = period * (1 + log.jitter * rng.normal(0, 1, n).clip(-3, 3)) * np.where(rng.random(n) < 0.004, 1.25, 1)
    ticks: Array = np.round(np.cumsum(steps), log.time_digits).astype(np.float64)
    begin = rng.choice(["rest", "warm", "inside"], p=[0.45, 0.25, 0.3])
    centre, width = film.envelope[5:7]
    first = rig.room if begin == "rest" else rng.uniform(30, 60)
    if begin == "inside":
        first = rng.uniform(centre - width / 2, centre + width / 2)
    sink = rig.room + rng.uniform(0, 0.3) * (first - rig.room)
    profile = str(rng.choice(PROFILES))
    plan, gains = draw_plan(rng, rig, film, ticks, first, profile, delay)
    meter = np.append(np.ones(n), [log.fixed_A, float(log.every)])
    if log.switched:
        blocks = (np.arange(n) // log.every // int(rng.integers(40, 200))) % 2
        meter[:n] = np.where(blocks == 1, rng.choice([1 / 3, 3.0]), 1.0)
    memory, at = conditioned(film, rng, first, begin == "inside")
    kept = np.ones(n, bool)
    kept[np.arange(n) % log.every != 0] = False
    if rng.random() < 0.3:
        kept[1:] &= rng.random(n - 1) > 0.005
    if rng.random() < 0.3:
        for _ in range(int(rng.integers(1, 4))):
            gap = int(rng.integers(n // 10, n - 1))
            kept[gap : gap + int(rng.integers(5, 60)) * log.every] = False
    start = np.array([first, sink, first, first, first, 0.0])
    outside, start[5] = draw_cause(rng, *cause, ticks)
    noise = log.noise_K * rng.normal(0, 1, n)
    return Scene(ticks, plan, gains, noise, outside, meter, memory, at, start, np.flatnonzero(kept), profile, *cause)


def draw_cause(rng: np.random.Generator, name: str, size: float, ticks: Array) -> tuple[Array, float]:
    """Return what acts from outside by tick, and the latent heat (J) of water at the first row."""
    outside = np.tile(NOTHING_OUTSIDE, (ticks.size, 1))
    time = ticks - ticks[0]
    late = time > rng.uniform(0.3, 0.6) * time[-1]
    if name == "lost_commands":
        outside[:, 3] = rng.random(ticks.size) < size
    elif name == "draught":
        outside[:, 1] += size * (np.searchsorted(np.sort(rng.uniform(0, time[-1], 5)), time) % 2)
    elif name == "room_cycle":
        outside[:, 2] = size * np.sin(2 * math.pi * time / rng.uniform(300, 1200))
    elif name == "drying_water":
        # the plate is some 25 K above 25 degC on average, where water evaporates five times as fast
        return outside, 5 * size * rng.uniform(0.2, 0.6) * float(time[-1])
    elif name == "sun_patch":
        for _ in range(3):
            middle, long = rng.uniform(0, time[-1]), rng.uniform(0.03, 0.12) * time[-1]
            outside[:, 0] += size * np.exp(-(((time - middle) / long) ** 4))
    elif name == "loosened_thermometer":
        outside[:, 4] = size * late
    elif name == "film_slip":
        outside[:, 5] = size * rng.choice([-1, 1]) * late
    return outside, 0.0


def with_cause(rig: Rig, name: str, size: float) -> Rig:
    """Return the rig with an outside cause that is a constant of it."""
    if name == "holder_mass":
        return rig._replace(holder_coupling=size * rig.conductance, holder_capacity=2 * rig.capacity)
    if name == "asymmetric_driver":
        return rig._replace(cooling_gain=1 - size)
    if name == "drying_water":
        return rig._replace(evaporation=size)
    return rig._replace(pickup=size) if name == "thermometer_pickup" else rig


def run(scene: Scene, rig: Rig, film: Film, replay: Array | None = None, with_film: bool = True) -> Run:
    """Simulate a scene, or repeat its currents."""
    repeated = np.zeros(0) if replay is None else replay
    return Run(
        *simulate(
            scene.ticks, repeated, scene.plan, scene.gains, scene.noise, scene.outside, scene.meter,
            rig, film, scene.memory.copy(), scene.at.copy(), scene.start, with_film,
        )
    )  # fmt: skip


def meter_reading(scene: Scene, log: Log, rig: Rig, done: Run, caused: bool = True) -> Array:
    """Return log10 of the resistance in ohm that the meter reads at each tick, without noise and digits."""
    ohm = 1 / (1 / (10.0**-done.fine_y + rig.series) + 1 / rig.leakage)
    decades = np.log10(ohm)
    if rig.meter_tau > 0:
        decades = lagged(done.fine_s, decades, rig.meter_tau)
    read = scene.ticks + log.offset_s - rig.skew
    decades = np.interp(read, done.fine_s, decades)
    decades += np.log10(1 + rig.range_error * (10**decades > rig.range_threshold))
    time, cause = scene.ticks - scene.ticks[0], scene.cause if caused else ""
    if cause == "resistance_ageing":
        decades += scene.size * time / 3600
    elif cause == "mains_alias":
        period = 60 + 7 * scene.size
        decades += scene.size * log.noise_dec * np.sin(2 * math.pi * time / period)
    elif cause == "range_settling":
        changes = np.flatnonzero(np.diff(np.floor(decades))) + 1
        last = np.searchsorted(changes, np.arange(time.size), "right")
        since = np.where(last > 0, time - time[changes[last - 1]] if changes.size else np.inf, np.inf)
        decades += np.log10(1 + scene.size * np.exp(-since / (5 + 100 * scene.size)))
    elif cause == "thermoelectric_emf":
        volt = 1e-6 * scene.size * (done.plate - rig.room)
        decades = np.log10(np.maximum(10**decades + volt / done.meter_current, 0.1))
    return decades


def logged(rng: np.random.Generator, scene: Scene, log: Log, rig: Rig, done: Run) -> Columns:
    """Return the columns of the log file: with noise, digits, missing rows, now and then outliers."""
    rows, decades = scene.rows, meter_reading(scene, log, rig, done)
    uneven = np.where(decades > np.median(decades), log.noise_ratio, 1.0)
    ohm = 10 ** (decades + log.noise_dec * uneven * rng.normal(0, 1, decades.size))
    digit = 1.2 * 10.0 ** np.ceil(np.log10(ohm / 1.2)) / log.counts
    ohm = np.where(ohm > log.top_ohm, np.inf, np.round(ohm / digit) * digit)
    columns = {
        "time_s": scene.ticks[rows],
        "temperature_degC": np.round(np.round(done.reading[rows] / log.step_K) * log.step_K, 6),
        "resistance_ohm": np.array([float(f"{one:.7g}") for one in ohm[rows]]),
        "current_A": done.current[rows],
    }
    if log.repeats > 1:
        columns["resistance_ohm"] = columns["resistance_ohm"][np.arange(rows.size) // log.repeats * log.repeats]
    elif rng.random() < 0.08:
        for row in rng.integers(50, rows.size, int(rng.integers(1, 5))):
            columns["resistance_ohm"][row] *= 10 ** rng.uniform(-0.4, 0.4)
    if log.tested:
        columns["meter_current_A"] = done.meter_current[rows]
    if log.offset_s:
        columns["resistance_time_s"] = np.round(columns["time_s"] + log.offset_s, log.time_digits)
    if scene.profile not in ("hand", "prbs"):
        columns["setpoint_degC"] = np.round(scene.plan[rows, 0], 3)
    return columns


def passes(scene: Scene, film: Film, done: Run) -> bool:
    """Return True if the plate stays within -15 to 115 degC and the record shows most of the transition."""
    cold, hot = film_ends(film)
    y = np.interp(scene.ticks[scene.rows], done.fine_s, done.fine_y)
    bodies = float(done.plate.min()) > -15 and float(done.plate.max()) < 115
    return bodies and bool(np.isfinite(y).all()) and float(np.ptp(y)) > 0.75 * (hot - cold)
