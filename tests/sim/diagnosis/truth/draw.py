"""Rigs from seeds: films of three kinds, plates of the typical sizes, noise, profiles and test currents."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.films import Film
from tests.sim.diagnosis.truth.hysteresis import MEDIUM, MIXED, MOVING, PLAY, PREISACH, REVERSAL
from tests.sim.diagnosis.truth.manner import USUAL, Manner, setpoints
from tests.sim.diagnosis.truth.profiles import meter_currents, steps_and_dithers
from tests.sim.diagnosis.truth.rig import Plate, Rig, Schedule, feedforward, simulate

Array = NDArray[np.float64]
Random = np.random.Generator
ROWS_ELSEWHERE = 3000
SIZES_DIFFER = 0.5  # standard deviation of the logarithm of a domain's size
AT_ONCE_K = 1e-6
BOLTZMANN_EV_PER_K = 8.617e-5


def memoryless_part(rng: Random, form: int, decades: float) -> Array:
    """[a, b, c, offset] of a rising D(T) that changes by `decades` between 20 and 90 degC (tanh: about that)."""
    if form == 1:
        return np.array([decades / 70.0, 0.0, 0.0, 0.0])
    if form == 2:
        return np.array([-decades / (1.0 / 293.15 - 1.0 / 363.15), 0.0, 0.0, 0.0])
    if form == 3:
        b, centre = rng.uniform(0.02, 0.045), rng.uniform(40.0, 75.0)
        return np.array([0.55 * decades, b, -b * centre, 0.0])
    return np.zeros(4)


def order_floor(a_r: float, c_r: float, a_l: float, c_l: float) -> float:
    """The smallest radius that keeps the order condition between two tanh envelopes."""
    v = np.linspace(-20.0, 160.0, 3601)
    return 0.5 * float(np.max(np.tanh(a_r * (v - c_r)) - np.tanh(a_l * (v - c_l)))) + 0.005


def operators(
    envelopes: tuple[float, float, float, float], radii: Array, weights: Array, decades: float
) -> tuple[Array, float]:
    """The table of operators whose weights come to so many decades, and the width of the loop, K."""
    a_r, c_r, a_l, c_l = envelopes
    weights = weights * (decades / np.sum(2.0 * weights * (1.0 - radii)))
    share = weights * (1.0 - radii) / np.sum(weights * (1.0 - radii))
    width = (c_r - c_l) + float(np.sum(share * np.arctanh(radii) * (1.0 / a_r + 1.0 / a_l)))
    table = np.zeros((3, radii.size))
    table[0], table[1] = radii, weights
    table[2, :4] = a_r, -a_r * c_r, a_l, -a_l * c_l
    return table, width


def play_table(rng: Random, centre: float, decades: float) -> Array:
    """12 to 40 operators with tanh envelopes that keep the order condition; loops 2 to 10 K wide."""
    while True:
        n = int(rng.integers(12, 41))
        a_r, a_l = rng.uniform(0.09, 0.24) * np.exp(rng.uniform(-0.2, 0.2, 2))
        apart = rng.uniform(-0.5, 5.0)
        envelopes = (a_r, centre + 0.5 * apart, a_l, centre - 0.5 * apart)
        floor = order_floor(*envelopes)
        shape = rng.uniform(0.5, 2.0)
        places = np.sort(rng.random(n) ** shape)
        radii = max(floor, 0.0) + (rng.uniform(0.6, 0.9) - max(floor, 0.0)) * places
        bump = np.exp(-0.5 * ((radii - rng.uniform(0.0, 0.6)) / rng.uniform(0.1, 0.5)) ** 2)
        weights = np.exp(0.5 * rng.standard_normal(n)) * (bump + rng.uniform(0.0, 0.3))
        table, width = operators(envelopes, radii, weights, decades)
        if floor < 0.3 and 2.0 < width < 10.0:
            return table


def few_operators_table(rng: Random, centre: float, decades: float) -> Array:
    """4 to 11 operators at equal distances, with weights that fall off as exp(-tau r); loops 1 to 14 K wide."""
    while True:
        n = int(rng.integers(4, 12))
        a_r, a_l = rng.uniform(0.08, 0.35) * np.exp(rng.uniform(-0.3, 0.3, 2))
        apart = rng.uniform(0.0, 8.0)
        envelopes = (a_r, centre + 0.5 * apart, a_l, centre - 0.5 * apart)
        floor = max(order_floor(*envelopes), 0.0)
        radii = floor + (rng.uniform(0.5, 0.95) - floor) * np.arange(n) / n
        table, width = operators(envelopes, radii, np.exp(-rng.uniform(0.0, 6.0) * radii), decades)
        if floor < 0.35 and 1.0 < width < 14.0:
            return table


def preisach_table(rng: Random, centre: float, decades: float) -> Array:
    """Relays with half-widths normal or lognormal, centres normal; centre and spread may go with the width."""
    n = 64
    place = (np.arange(n) + 0.5) / n
    from scipy.special import ndtri

    median = rng.uniform(1.2, 4.0)
    if rng.random() < 0.5:
        widths = median * np.exp(rng.uniform(0.25, 0.6) * ndtri(place))
    else:
        widths = np.abs(median * (1.0 + rng.uniform(0.2, 0.4) * ndtri(place)))
    table = np.zeros((4, n))
    table[0], table[1] = widths, decades / n
    table[2] = centre + rng.uniform(-0.4, 0.4) * (widths - median)
    table[3] = rng.uniform(2.2, 5.0) * (1.0 + rng.uniform(-0.05, 0.1) * (widths - median))
    return table


def in_domains(rng: Random, film: Film, count: int) -> Film:
    """So many relays drawn from the density of a film of relays, each of a size of its own, that switch at once."""
    smooth = film.table
    of = rng.choice(film.count, count, p=smooth[1] / np.sum(smooth[1]))
    sizes = np.exp(SIZES_DIFFER * rng.standard_normal(count))
    table = np.repeat(smooth[:, :1], count, axis=1)  # how the film mixes is the same for all
    table[0] = np.interp(of + rng.uniform(-0.5, 0.5, count), np.arange(film.count), smooth[0])
    table[1] = sizes * (np.sum(smooth[1]) / np.sum(sizes))
    table[2] = smooth[2, of] + smooth[3, of] * rng.standard_normal(count)
    table[3] = AT_ONCE_K
    return replace(film, table=table, name="domains")


def moving_table(rng: Random, centre: float, decades: float) -> Array:
    """Relays in a mean field of 0.5 to 3 K from the one end to the other, less than switches them all at once."""
    table = preisach_table(rng, centre, decades)
    field = rng.uniform(0.5, min(3.0, float(np.min(table[3]))))
    return np.vstack((table, np.full(table.shape[1], field)))


def medium_table(rng: Random, centre: float, decades: float) -> Array:
    """Grains in a film (two dimensions) or in a thick one."""
    table = preisach_table(rng, centre, decades)
    return np.vstack((table, np.full(table.shape[1], float(rng.integers(2, 4)))))


def mixed_table(rng: Random, centre: float, decades: float) -> Array:
    """Domains in parallel, in series, or in between; an insulator of 0.1 to 0.3 eV."""
    table = preisach_table(rng, centre, decades)
    exponent, activation_K = rng.uniform(-1.0, 1.0), rng.uniform(0.1, 0.3) / BOLTZMANN_EV_PER_K
    both = np.array([[exponent], [activation_K / np.log(10.0)]])
    return np.vstack((table, np.repeat(both, table.shape[1], axis=1)))


def reversal_table(rng: Random, centre: float, decades: float) -> Array:
    """Two major branches, each of two steps, and reversal curves that start flatter than the branch they join."""
    width = rng.uniform(3.0, 9.0)
    table = np.zeros((3, 5))
    k = rng.uniform(0.10, 0.2)
    for row, side in ((0, 0.5), (1, -0.5)):
        k1 = k * np.exp(rng.uniform(-0.15, 0.15))
        c = centre + side * width
        table[row] = c, k1, c + rng.uniform(-3.0, 3.0), 0.75 * k1, rng.uniform(0.5, 0.9)
    table[2, :3] = decades, rng.uniform(0.3, 0.9), rng.uniform(-0.4, 0.4)
    return table


def draw_film(rng: Random, kind: str = "of_class", form: int | None = None, few_operators: bool = False) -> Film:
    """A film: transition at 45 to 75 degC, 1.5 to 4 decades in all, between some 1e2 and 1e6 ohm."""
    total = rng.uniform(1.5, 3.9)
    centre = rng.uniform(47.0, 73.0)
    form = int(rng.integers(0, 4)) if form is None else form
    slow = rng.uniform(0.12, 0.35) * min(total, 2.5) if form else 0.0
    play = few_operators_table if few_operators else play_table
    make = {
        "of_class": (PLAY, play),
        "preisach": (PREISACH, preisach_table),
        "forc": (REVERSAL, reversal_table),
        "moving": (MOVING, moving_table),
        "medium": (MEDIUM, medium_table),
        "mixed": (MIXED, mixed_table),
    }
    code, table = make[kind]
    parts = table(rng, centre, total - slow)
    d = memoryless_part(rng, form, slow)
    before = [(105.0,), (5.0, 105.0), (5.0, 92.0, centre - 6.0, centre + 5.0)][int(rng.integers(0, 3))]
    film = Film(code, parts, form, d, before, kind)
    cold = float(film.log_ohm(np.array([25.0]))[0])
    d[3] = cold - rng.uniform(max(4.0, total + 1.7), max(5.8, total + 2.0))
    return film


def draw_plate(rng: Random) -> Plate:
    """A plate of the typical sizes, at room temperature before the first row."""
    while True:
        capacity = float(np.exp(rng.uniform(np.log(3.0), np.log(60.0))))
        s, r, g = rng.uniform(0.03, 0.06), rng.uniform(1.0, 3.0), rng.uniform(0.3, 0.8)
        ambient, limit = rng.uniform(19.0, 28.0), rng.uniform(4.0, 6.0)
        start = ambient + rng.uniform(-0.3, 0.3)
        plate = Plate(s / capacity, r / capacity, g / capacity, ambient, start, capacity, limit)
        time = np.array([0.0, 0.5])
        fits = [
            np.max(np.abs(feedforward(plate, time, at + 0.5 * rate * np.array([0.0, 1.0])))) < 0.85 * limit
            for at, rate in ((95.0, 0.6), (35.0, -0.6))
        ]
        if all(fits):
            return plate


@dataclass(frozen=True)
class Bench:
    """A rig with what is done with it: setpoints of the record and of the one elsewhere, both with test currents."""

    rig: Rig
    schedule: Schedule
    elsewhere: Schedule
    low_degC: float
    high_degC: float


def transition(film: Film) -> tuple[float, float]:
    """Temperatures between which the major loop is open: 2 % above its foot to 2 % below its top, within the plate."""
    flat = Film(film.kind, film.table, 0, np.zeros(4), (105.0,), film.name)
    v = np.concatenate([np.linspace(105.0, -10.0, 1150), np.linspace(-10.0, 105.0, 1150)])
    y = -flat.log_ohm(v)
    share = (y - y.min()) / (y.max() - y.min())
    down, up = share[:1150], share[1150:]
    low, high = float(v[:1150][np.argmin(np.abs(down - 0.03))]), float(v[1150:][np.argmin(np.abs(up - 0.97))])
    return max(low, 32.0), min(high, 90.0)


def draw_bench(
    rng: Random, kind: str = "of_class", form: int | None = None, rows: int | None = None, manner: Manner = USUAL
) -> Bench:
    """A rig without effects, and its schedules. rows: in place of the manner's."""
    film = draw_film(rng, kind, form, manner.few_operators)
    low, high = transition(film)
    plate = draw_plate(rng)
    noise = np.exp(rng.uniform(*np.log(manner.noise)))
    rig = Rig(plate, film, float(noise[0]), float(noise[1]))
    time = np.arange(rows or manner.rows) * manner.interval_s
    ohm = 10.0 ** float(film.log_ohm(np.array([25.0]))[0])
    test_A = float(np.sqrt(rng.uniform(2e-4, 1e-3) / ohm))
    rates = manner.speed * rng.permutation(np.array([0.15, 0.25, 0.4, 0.6])) * np.exp(rng.uniform(-0.05, 0.05, 4))
    meter_A = meter_currents(rng, time, test_A)
    if manner.one_current:
        meter_A = np.full(time.size, test_A)
    schedule = Schedule(time, meter_A, setpoints(manner, rng, time, plate.start_degC, low, high, rates))
    time = np.arange(ROWS_ELSEWHERE) * manner.interval_s
    elsewhere = Schedule(
        time, meter_currents(rng, time, test_A), steps_and_dithers(rng, time, plate.start_degC, low, high)
    )
    return Bench(rig, schedule, elsewhere, low, high)


def follows(bench: Bench, rig: Rig) -> bool:
    """Whether the rig with its effects still gets through the transition: the loop is stable, the film is switched."""
    coarse = Rig(rig.plate, rig.film, rig.noise_K, rig.noise_dec, rig.effects, rig.outside, 5, 0.1)
    run = simulate(coarse, bench.schedule)
    assert bench.schedule.setpoint is not None
    error = run.temperature - bench.schedule.setpoint
    full = float(np.mean(np.abs(run.current) >= 0.999 * rig.plate.limit_A))
    return bool(np.sqrt(np.mean(error**2)) < 5.0 and np.max(run.temperature) < 100.0 and full < 0.1)
