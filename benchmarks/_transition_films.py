"""Records of films whose transition is known: three kinds of film, with a thermometer's and an ohmmeter's noise.

Nothing here is `compensator`'s. The films are those of `tests/sim/diagnosis/truth`: play operators with tanh envelopes
("of_class"), a Preisach plane with a bell-shaped density ("preisach"), and reversal curves by interpolation between
two measured-like branches of two smooth steps each ("forc"). What is true is read off the film's own curve without
noise, along the way that the record took.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.sim.diagnosis.truth.draw import draw_film

Array = NDArray[np.float64]
KINDS = ("of_class", "preisach", "forc")
FINE_K = 0.005  # of the truth's grid


@dataclass(frozen=True)
class Known:
    """A record (s, degC, log10 ohm), the film's kind, and its curve without noise on heating and on cooling: (degC,
    log10 ohm) on an even grid of FINE_K."""

    kind: str
    time_s: Array
    temperature_degC: Array
    log_ohm: Array
    heating: tuple[Array, Array]
    cooling: tuple[Array, Array]
    activation_eV: float | None


def _profile(rng: np.random.Generator, low: float, high: float) -> tuple[list[float], bool]:
    """Turning points: a major loop from either end, at times with a second one or with minor loops after it."""
    from_cold = bool(rng.random() < 0.5)
    ends = [low, high] if from_cold else [high, low]
    points = [ends[0], ends[1], ends[0]]
    more = rng.random()
    if more < 0.25:
        points += [ends[1], ends[0]]
    elif more < 0.5:
        points += list(rng.uniform(low + 0.3 * (high - low), high - 0.3 * (high - low), 6))
    return points, from_cold


def draw_known(seed: int) -> Known:
    """The record of a seed; the kind of film goes by turns."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % 3]
    film = draw_film(rng, kind, form=int(rng.choice([0, 1, 2, 2, 3])))
    low, high = rng.uniform(10.0, 22.0), rng.uniform(98.0, 108.0)
    points, from_cold = _profile(rng, low, high)
    film = replace(film, before=(5.0,) if from_cold else (115.0,))
    step_K = np.exp(rng.uniform(np.log(0.03), np.log(0.6)))  # a row
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(points)))))
    rows = np.arange(0.0, travel[-1], step_K)
    rows += rng.uniform(-0.3, 0.3, rows.size) * step_K * float(rng.random() < 0.5)  # sampling need not be even
    rows = np.concatenate([-step_K * np.arange(int(rng.integers(1, 20)), 0.5, -1.0), np.maximum(rows, -0.3 * step_K)])
    plate = np.interp(rows, travel, points)
    clean = film.log_ohm(plate)
    noise_dec = np.exp(rng.uniform(np.log(3e-4), np.log(8e-3)))
    memory = float(rng.choice([0.0, 0.5, 0.8]))
    noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], rng.standard_normal(plate.size + 200))[200:]
    noise_K = np.exp(rng.uniform(np.log(0.002), np.log(0.05)))
    shown = plate + noise_K * rng.standard_normal(plate.size)
    last_digit_K = float(rng.choice([1e-4, 0.01, 0.1, 0.25]))
    shown = last_digit_K * np.round(shown / last_digit_K)
    rate = np.exp(rng.uniform(np.log(0.02), np.log(0.5)))
    time = rows / rate
    start, end = (points[0], points[1])
    there = np.arange(start, end, FINE_K * np.sign(end - start))
    way = np.concatenate([there, np.arange(end, start, FINE_K * np.sign(start - end))])
    curve = film.log_ohm(way)
    runs = [(there, curve[: there.size]), (way[there.size :][::-1], curve[there.size :][::-1])]
    if not from_cold:
        runs = [(there[::-1], curve[: there.size][::-1]), (way[there.size :], curve[there.size :])][::-1]
    energy = None
    if film.form == 2:
        energy = float(-film.d[0] * 8.617333262e-5 * np.log(10.0))
    return Known(kind, time, shown, clean + noise_dec * noise, runs[0], runs[1], energy)


def steepest_degC(degC: Array, log_ohm: Array) -> float:
    """Where |d log10 R / dT| of the curve itself is largest."""
    return float(degC[np.argmax(np.abs(np.gradient(log_ohm, degC)))])


def steepest_over_window_degC(degC: Array, log_ohm: Array, window_K: float) -> float:
    """Where the derivative over a window is largest: of polynomials of the fifth degree, with weights (1 - |u|^3)^3
    that reach zero `window_K` to either side."""
    degC, log_ohm = degC[::8], log_ohm[::8]

    def slope(place: float) -> float:
        u = (degC - place) / window_K
        inside = np.abs(u) < 1.0
        weight = (1.0 - np.abs(u[inside]) ** 3) ** 1.5  # polyfit squares it
        return abs(float(np.polynomial.polynomial.polyfit(u[inside], log_ohm[inside], 5, w=weight)[1]))

    low, high, step = degC[0] + window_K, degC[-1] - window_K, 0.5
    while True:
        places = np.arange(low, high, step)
        best = float(places[np.argmax([slope(place) for place in places])])
        if step < 0.01:
            return best
        low, high, step = best - 1.5 * step, best + 1.5 * step, 0.2 * step


def full_width_K(degC: Array, log_ohm: Array) -> float:
    """Full width at half maximum of |d log10 R / dT| about its largest place."""
    slope = np.abs(np.gradient(log_ohm, degC))
    k = int(np.argmax(slope))
    below = slope < 0.5 * slope[k]
    return float(degC[k + np.argmax(below[k:])] - degC[k - np.argmax(below[k::-1])])


def halfway_degC(degC: Array, log_ohm: Array, ends_degC: tuple[float, float]) -> float:
    """Where the curve is halfway between what it is at both ends."""
    half = 0.5 * float(np.sum(np.interp(ends_degC, degC, log_ohm)))
    k = int(np.argmax(log_ohm < half))
    return float(degC[k] - FINE_K * (half - log_ohm[k]) / (log_ohm[k - 1] - log_ohm[k]))
