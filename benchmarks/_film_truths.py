"""Simulated films with hysteresis, measured over temperature, whose truth is known.

`case_of` measures one film over one profile, with a
thermometer and a meter, all drawn from a seed. Numpy only: nothing of the program that is judged is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import NormalDist

import numpy as np

from tests.truth import Array, Film

Rng = np.random.Generator
KINDS = ("play", "preisach", "grains", "moment", "other", "steep")
EV_KELVIN = 8.617e-5 * np.log(10.0)  # Boltzmann's constant, eV/K, for decades


@dataclass(frozen=True, eq=False)
class Case:
    """A measured film and its truth. An ambiguous number of the transition is None."""

    seed: int
    kind: str
    words: str
    film: Film
    ends: Array  # lowest and highest temperature; the loop is closed there
    column: str  # name of the output
    columns: dict[str, Array]  # the record
    outputs: Array  # the truth in each row
    off: Array  # what was added to make outliers; nan where nothing was read
    noise: float  # RMS of what the true film leaves of the readings when it follows the thermometer
    fresh: dict[str, Array]  # another profile, from saturation, without noise
    initial: str  # which saturation
    asked: float  # RMS error that a model may have there
    transition: dict[str, tuple[float, float] | None]  # lowest and highest value, by the window through which one looks
    branches: tuple[bool, bool]  # whether the record holds the major branches of heating and of cooling
    inner: bool  # whether it turns at ten temperatures or more inside the loop, which fixes the minor loops


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Return a number between low and high, its logarithm uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def play_film(rng: Rng, centre: float, width: float, height: float) -> tuple[Film, str]:
    """Return a generalized Prandtl-Ishlinskii film with tanh envelopes, and its words; width of its branches in K."""
    number = int(rng.integers(8, 41))
    a = 2.0 / width * rng.uniform(0.85, 1.18, 2)  # heating, cooling
    c = centre + np.array([1.0, -1.0]) * rng.uniform(0.0, 0.2, 2) * width
    wide = centre + np.linspace(-15.0, 15.0, 4001) * width
    least = max(0.0, float(np.max(np.tanh(a[0] * (wide - c[0])) - np.tanh(a[1] * (wide - c[1]))))) / 2.0
    radii = least + (0.95 - least) * np.sort(rng.beta(1.0, rng.uniform(1.0, 4.0), number))  # low <= high everywhere
    weights = rng.gamma(rng.uniform(0.5, 3.0), size=number)
    weights *= height / np.sum(2.0 * (1.0 - radii) * weights)
    low, high = (lambda v: np.tanh(a[0] * (v - c[0])) - radii), (lambda v: np.tanh(a[1] * (v - c[1])) + radii)
    return Film(low, high, weights, wide), f"{number} plays"


def relay_film(rng: Rng, centre: float, width: float, height: float, grains: bool) -> tuple[Film, str]:
    """Return a film of relays that switch at middle +- half, and its words."""
    number = int(rng.integers(20, 61)) if grains else int(rng.integers(500, 2001))
    density = str(rng.choice(["bell-shaped", "lognormal widths", "two populations", "correlated"]))
    typical = width * rng.uniform(0.15, 0.6)
    points = rng.random((number, 2))
    if not grains:  # spread evenly (Roberts' R2 sequence)
        points = (points[0] + np.outer(np.arange(number), [0.7548776662, 0.5698402910])) % 1.0
    z, x = np.vectorize(NormalDist().inv_cdf)(np.clip(points, 1e-9, 1.0 - 1e-9)).T
    middle, half = centre + 0.4 * width * z, typical * np.abs(1.0 + 0.4 * x)
    if density == "lognormal widths":
        half = typical * np.exp(rng.uniform(0.3, 0.7) * x)
    elif density == "two populations":
        second = np.arange(number) < number * rng.uniform(0.2, 0.5)
        middle = np.where(second, centre + rng.uniform(0.5, 1.2) * width + 0.25 * width * z, middle)
        half = np.where(second, rng.uniform(0.3, 2.0) * half, half)
    elif density == "correlated":
        half = typical * np.exp(0.4 * (rng.uniform(0.5, 0.9) * rng.choice([-1.0, 1.0]) * z + 0.5 * x))
    weights = rng.lognormal(0.0, 0.5, number) if grains else np.ones(number)
    up, down = middle + half, middle - half
    soft = width * (rng.uniform(0.003, 0.02) if grains else rng.uniform(0.05, 0.15))  # each step's, K
    low, high = (lambda v: np.clip((v - up) / soft, 0.0, 1.0)), (lambda v: np.clip((v - down) / soft + 1.0, 0.0, 1.0))
    wide = np.linspace(down.min() - 0.5 * width, up.max() + 0.5 * width, 4001)
    words = f"{number} grains" if grains else f"{number} relays, {density}"
    return Film(low, high, height / np.sum(weights) * weights, wide), words


def background(rng: Rng, form: str, centre: float, reach: float, size: float) -> Callable[[Array], Array]:
    """Return D(v), which changes by about size within reach (K) of the centre; size in eV if the form is arrhenius."""
    bend, flat = rng.uniform(0.3, 0.8) * rng.choice([-1.0, 1.0]), rng.random() < 0.5
    if form == "arrhenius":
        return lambda v: size / EV_KELVIN * (1.0 / (centre + 273.15) - 1.0 / (v + 273.15))
    if form == "curved" and flat:
        return lambda v: size * np.tanh((v - centre) / reach + bend)
    one, two = {"none": (0.0, 0.0), "straight": (size, 0.0), "curved": (size, bend * size)}[form]
    return lambda v: one * (v - centre) / reach + two * ((v - centre) / reach) ** 2


def steepest(film: Film, low: float, high: float, heating: bool) -> tuple[float, float] | None:
    """Return between which temperatures the steepest point of a major branch lies, None if there is no single one.

    Relays and plays begin to move one after the other: each has a step or a kink, and which point is steepest depends
    on the window. Here these have a standard deviation of 8 to 25 % of the branch's width.
    """
    grid = np.linspace(low, high, 6001)
    slope = np.diff(film.branch(grid, heating))
    risen = np.cumsum(slope - np.diff(film.background(grid)))
    width = int(np.searchsorted(risen, 0.85 * risen[-1]) - np.searchsorted(risen, 0.15 * risen[-1]))  # rows
    found = []
    for share in (0.08, 0.12, 0.25, 0.17):
        seen = np.abs(smoothed(slope, share * width))
        at = int(np.argmax(seen))
        found.append(float(grid[at]))
    peaks = np.r_[True, seen[1:] >= seen[:-1]] & np.r_[seen[:-1] >= seen[1:], True]
    peaks[max(0, at - int(0.4 * width)) : at + int(0.4 * width)] = False
    single = 0 < at < seen.size - 1 and not np.any(seen[peaks] > 0.9 * seen[at])
    return (min(found), max(found)) if single else None


def smoothed(values: Array, deviation: float) -> Array:
    """Return a Gaussian average with this standard deviation in rows."""
    reach = int(4 * deviation) + 1
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    return np.convolve(np.pad(values, reach, mode="edge"), kernel / kernel.sum(), mode="valid")


def turns_of(rng: Rng, shape: str, ends: Array, loop: Array, count: int) -> list[float]:
    """Return where a profile turns: from the first end to the other, then some `count` times inside the loop."""
    first, last = ends
    inside = rng.uniform(min(loop), max(loop), max(2, count - 3))
    if shape == "major":
        inside = [first, last] if rng.random() < 0.5 else []
    elif shape == "decaying":
        middle = 0.5 * (np.mean(loop) + inside[0])
        decay = np.exp(-np.arange(1, count) / (0.4 * count)) * (-1.0) ** np.arange(1, count)
        inside = np.r_[middle + (last - middle) * decay, middle]
    elif shape == "reversal curves":
        inside = np.ravel([[first, one] for one in np.linspace(*loop, max(3, count // 2))])
    elif shape == "two rates":
        half = inside[: count // 2 + 1]
        inside = np.r_[half, first, last, half]
    return [float(one) for one in (first, last, *inside, first)]


def course(rng: Rng, shape: str, turns: list[float]) -> tuple[Callable[[Array], Array], Array]:
    """Return the temperature as a function of time, in which the profile takes 1, and the times of its turns."""
    lengths = np.maximum(np.abs(np.diff(turns)), 1e-3)
    if shape == "two rates":
        lengths[lengths.size // 2 :] /= rng.uniform(2.0, 5.0)
    if shape == "afternoon":
        lengths *= np.exp(rng.normal(0.0, 0.4, lengths.size))
    corners = np.r_[0.0, np.cumsum(lengths)] / np.sum(lengths)
    rounded = rng.choice([0.0, 0.3, 1.0])  # 0: straight ramps; 1: half cosines

    def at(time: Array) -> Array:
        part = np.clip(np.searchsorted(corners, time, side="right") - 1, 0, lengths.size - 1)
        share = (time - corners[part]) / np.diff(corners)[part]
        share = (1.0 - rounded) * share + rounded * 0.5 * (1.0 - np.cos(np.pi * share))
        return np.asarray(turns)[part] + share * np.diff(turns)[part]

    return at, corners


def times_of(rng: Rng, sampling: str, rows: int, corners: Array) -> Array:
    """Return the times of the rows, 0 to 1. No gap hides a turn."""
    steps = rng.gamma(3.0, size=rows - 1) if sampling == "uneven, gaps" else np.ones(rows - 1)
    times = np.r_[0.0, np.cumsum(steps)] / np.sum(steps)
    if sampling == "jittered":
        times[1:-1] += rng.uniform(-0.35, 0.35, rows - 2) / rows
    for _ in range(int(rng.integers(1, 4)) if sampling == "uneven, gaps" else 0):
        ramp = int(rng.integers(corners.size - 1))
        length = corners[ramp + 1] - corners[ramp]
        gap = corners[ramp] + length * rng.uniform(0.1, 0.5)
        times = times[(times < gap) | (times > gap + min(0.4 * length, 0.03))]
    return times


def film_of(rng: Rng, kind: str) -> tuple[Film, str, str, bool]:
    """Return a film, its words, the column of its output, and whether that rises with temperature."""
    column, centre, width, height = "resistance_ohm", rng.uniform(50, 75), log_uniform(rng, 4, 15), rng.uniform(0.6, 3)
    material = str(rng.choice(["rising", "NdNiO3", "V2O3", "strain_percent", "polarization_uC_per_cm2"]))
    material = {"moment": "moment_uemu", "other": material}.get(kind, "VO2")
    if material == "NdNiO3":
        centre, width = rng.uniform(-95, -75), rng.uniform(25, 40)
    elif material == "V2O3":
        centre, width, height = rng.uniform(-125, -100), rng.uniform(3, 10), rng.uniform(3.5, 6)
    elif material not in ("VO2", "rising"):
        column, height = material, log_uniform(rng, 0.2, 100)
    if kind == "moment":
        centre, width = rng.uniform(-5, 5), log_uniform(rng, 8, 30)
    if kind in ("preisach", "grains") or (kind != "play" and bool(rng.random() < 0.5)):
        film, words = relay_film(rng, centre, width, height, kind == "grains")
    else:
        film, words = play_film(rng, centre, width, height)

    resistance, sign = column == "resistance_ohm", rng.choice([-1.0, 1.0])
    form = str(rng.choice(["none", "straight", "arrhenius" if resistance else "straight", "curved"]))
    size = height * sign * rng.uniform(0.03, 0.25)
    if kind == "moment":
        form, size = "straight", height * rng.uniform(0.2, 0.8) * (1.0 if rng.random() < 0.3 else -1.0)
    elif kind == "steep":
        form, size = str(rng.choice(["straight", "curved"])), height * sign * rng.uniform(0.4, 1.5)
    elif form == "arrhenius":
        size = rng.uniform(0.05, 0.3) * (0.3 if centre < -50 else 1.0)
    back, rises = background(rng, form, centre, 3.0 * width, float(size)), not resistance or material == "rising"
    offset = height * rng.uniform(-2, 2) if not resistance else (1.5 if rises else -2.0 - height)
    words += f", {material}, D {form}{'' if form == 'none' else ' falls' if size < 0 else ' rises'}"
    return replace(film, background=lambda v: back(v) + offset), words, column, rises


def case_of(seed: int, kind: str | None = None) -> Case:
    """Return the case of a seed, which decides everything; kind: one of KINDS, in turn without."""
    kind = kind or KINDS[seed % len(KINDS)]
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    film, words, column, rises = film_of(rng, kind)
    decades = column == "resistance_ohm"
    unit = 1.0 if decades else 0.5 * float(film.weights @ (film.saturated(True) - film.saturated(False)))  # as a decade
    loop, ends = film.open_between(0.05), film.open_between(1e-3)
    ends = ends + np.ptp(ends) * rng.uniform(*((0.5, 1.2) if kind == "moment" else (0.05, 0.3)), 2) * [-1.0, 1.0]

    shape = str(rng.choice(["major", "decaying", "decaying", "reversal curves", "two rates", "afternoon"]))
    start, rows = str(rng.choice(["cold", "hot", "mid"])), int(log_uniform(rng, 300, 8000))
    hot = start == "hot" or (start == "mid" and bool(rng.random() < 0.5))
    way, memory = -1 if hot else 1, film.saturated(hot)
    turns = turns_of(rng, shape, ends[::way], loop[::way], int(np.clip(rows / 60, 4, 30)))
    if start == "mid":  # after a history that nobody has recorded
        history = rng.uniform(*loop, int(rng.integers(3, 12)))
        memory, turns = film.follow(history, memory)[1], [float(history[-1]), *turns]
    at, corners = course(rng, shape, turns)
    sampling = str(rng.choice(["even", "jittered", "uneven, gaps", "slow meter" if rows > 1500 else "even"]))
    times = times_of(rng, sampling, rows, corners)
    union = np.union1d(times, corners)  # the film goes through each turn, whether a row shows it or not
    outputs = film.follow(at(union), memory)[0][np.searchsorted(union, times)]

    thermometer, digit = log_uniform(rng, 1e-3, 50e-3), float(rng.choice([0.0, 0.0, 0.0, 0.01, 0.05]))
    degC = at(times) + thermometer * rng.normal(size=times.size)
    degC = np.round(degC / digit) * digit if digit else degC
    meter, share = unit * log_uniform(rng, 0.3e-3, 8e-3), float(rng.choice([0.0, 0.0, 0.0, 0.6]))  # share: what is slow
    white, slow = rng.normal(size=times.size), smoothed(rng.normal(size=times.size), 5.0)
    readings = outputs + meter * (np.sqrt(1.0 - share**2) * white + share * slow / np.std(slow))
    good = np.ones(times.size, dtype=bool)
    if sampling == "slow meter":
        taken = np.arange(times.size) // int(rng.integers(2, 7))
        good = np.diff(taken, prepend=-1) > 0
        readings, held = readings[good][taken], bool(rng.random() < 0.5)
        readings[~good] = np.where(held, readings, np.nan)[~good]
        sampling += ", readings repeated" if held else ", rows empty between"
    left = [film.follow(smoothed(degC, one), memory)[0] - readings for one in (0.1, 0.7, 1.5, 3.0, 6.0)]
    noise = float(min(np.sqrt(np.mean(one[good] ** 2)) for one in left))
    wild = bool(rng.random() < 0.25)
    off = meter * rng.choice([-1.0, 1.0], times.size) * rng.uniform(10, 100, times.size)
    off = np.where(good, off * (rng.random(times.size) < 0.005 * wild), np.nan)
    readings = readings + np.nan_to_num(off)

    def as_read(time_s: Array, temperature: Array, output: Array) -> dict[str, Array]:
        output = 10.0 ** (output if rises else -output) if decades else output
        return {"time_s": time_s, "temperature_degC": temperature, column: output}

    fresh_hot = bool(rng.random() < 0.5)
    path = np.interp(np.arange(1501) / 1500 * 16, range(17), [ends[int(fresh_hot)], *rng.uniform(*loop, 16)])
    fresh = as_read(np.arange(1501.0), path, film.follow(path, film.saturated(fresh_hot))[0])
    columns = as_read(times * np.sum(np.abs(np.diff(turns))) / log_uniform(rng, 0.02, 0.5), degC, readings)
    words += f"; {shape} from {start}, {times.size} rows, {sampling}; thermometer {1e3 * thermometer:.0f} mK"
    words += f"{f', digit {digit:g} K' if digit else ''}; meter {1e3 * meter:.2g} m"
    words += f"{', coloured' if share else ''}{', outliers' if wild else ''}"
    branches = tuple(ends) in pairwise(turns), tuple(ends[::-1]) in pairwise(turns)
    inner = int(sum(loop[0] < one < loop[1] for one in set(turns[1:]))) >= 10
    asked, initial = 1.5 * max(noise, 0.002 * unit), "cooled" if fresh_hot else "heated"
    up, down = (steepest(film, *ends, heating) for heating in (True, False))
    both = (up[0] - down[1], up[1] - down[0]) if up and down else None
    numbers = {"heating_degC": up, "cooling_degC": down, "hysteresis_K": both}
    measured = (seed, kind, words, film, ends, column, columns, outputs, off, noise)
    return Case(*measured, fresh, initial, asked, numbers, branches, inner)
