"""The likelihood of readings: with normal noise, or with normal noise and then rounded to a lattice.

For a prediction mu of what an ideal instrument shows, a reading T with noise sigma has z = (T - mu) / sigma and
-log L = z^2 / 2. One that was rounded to a lattice of step q says only that mu + noise lay within T +- q/2:
-log L = -log(Phi(b) - Phi(a)), a, b = (T -+ q/2 - mu) / sigma. Derivatives by mu serve the descent; the residual of a
rounded reading is drawn at random within its interval (randomized quantile residuals: P. K. Dunn, G. K. Smyth,
J. Comput. Graph. Statist. 5 (1996) 236), so that it is normal and white where the model is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr, ndtr, ndtri

from compensator.hysteresis.functions import Array

LEAST_OF_STEP, SIZES_TRIED = 0.01, 12  # of a noise before the rounding
QUIET: Final = 1.0  # of the noise: what adds a sixth to its second differences at most
FEWEST, TURNS = 0.1, 3  # share of the rows that is needed for it; until what is quiet does not change
MAD: Final = 1.4826
FAR = 8.0  # standard deviations beyond a step's edge: there the tail's differences have no digits left


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Of each reading: minus the logarithm, -d/dmu times sigma, d2/dmu2 times sigma^2."""

    minus_log: Array
    pull: Array
    curvature: Array


def likelihood(reading: Array, mu: Array, sigma: float, step: float) -> Likelihood:
    """Of readings for their predictions; step 0: no lattice."""
    centre = np.clip((reading - mu) / sigma, -1e9, 1e9)  # a trial far off has a square
    if step == 0.0:
        return Likelihood(0.5 * centre * centre, centre, np.ones_like(centre))
    side = np.where(centre >= 0.0, 1.0, -1.0)
    near, far = side * centre - 0.5 * step / sigma, side * centre + 0.5 * step / sigma  # near < far, mirrored
    log_far, log_near = log_ndtr(-far), log_ndtr(-near)
    log_p = log_near + np.log(-np.expm1(np.minimum(log_far - log_near, -1e-300)))
    p_near = np.exp(-0.5 * near * near - 0.9189385332 - log_p)
    p_far = np.exp(-0.5 * far * far - 0.9189385332 - log_p)
    pull = side * (p_near - p_far)
    curvature = pull * pull - side * side * (near * p_near - far * p_far)
    return Likelihood(-log_p, pull, np.clip(curvature, 1e-6, 1.0))


def normal_residual(reading: Array, mu: Array, sigma: float, step: float) -> Array:
    """Residuals in units of the noise that are standard normal where the model is right."""
    centre = (reading - mu) / sigma
    if step == 0.0:
        return np.asarray(centre, dtype=np.float64)
    share = np.random.default_rng(0).random(reading.size)
    side = np.where(centre >= 0.0, 1.0, -1.0)
    near, far = side * centre - 0.5 * step / sigma, side * centre + 0.5 * step / sigma
    low, high = ndtr(-far), ndtr(-near)
    drawn = -ndtri(np.clip(low + share * (high - low), 1e-300, 1.0))
    beyond = near > FAR
    drawn[beyond] = near[beyond]
    return np.asarray(side * drawn, dtype=np.float64)


def origin_of(readings: Array, step: float) -> float:
    """Of the lattice that readings lie on: kelvins rounded to 0.25 K lie 0.1 K beside the degrees that are."""
    around = np.mean(np.exp(2j * np.pi * readings / step))
    return float(np.angle(around)) * step / (2.0 * np.pi)


def expected_reading(mu: Array, sigma: float, step: float, origin: float = 0.0) -> tuple[Array, Array]:
    """Mean and variance of readings on a lattice through `origin` for predictions of what an ideal instrument shows."""
    nearest = np.round((mu - origin) / step)
    reach = math.ceil(4.0 * sigma / step) + 1
    mean, square = np.zeros_like(mu), np.zeros_like(mu)
    for k in range(-reach, reach + 1):
        value = origin + (nearest + k) * step
        share = ndtr((value + 0.5 * step - mu) / sigma) - ndtr((value - 0.5 * step - mu) / sigma)
        mean += share * value
        square += share * (value - mu) ** 2
    return mean, np.maximum(square - (mean - mu) ** 2, 0.0)


def lattice_noise(reading: Array, mu: Array, step: float, most: float) -> float:
    """The noise before the rounding, of largest likelihood and at most so much: what the prediction is off by would
    pass for more. Looked for at a dozen sizes, and then to a thousandth."""

    def cost(log: float) -> float:
        return float(np.sum(likelihood(reading, mu, math.exp(log), step).minus_log))

    logs = np.log(np.geomspace(LEAST_OF_STEP * step, most, SIZES_TRIED))
    best = int(np.argmin([cost(float(log)) for log in logs]))
    low, high = logs[max(best - 1, 0)], logs[min(best + 1, logs.size - 1)]
    return math.exp(float(minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3}).x))


def quick_noise(residual: Array) -> float:
    """Standard deviation of what changes from reading to reading, from second differences; robust."""
    second = residual[2:] - 2.0 * residual[1:-1] + residual[:-2]
    return MAD * float(np.median(np.abs(second - np.median(second)))) / math.sqrt(6.0)


def noise_where_little_lies(lies: Array, residual: Array) -> float:
    """The same from rows in which next to nothing else lies. lies: the variance of that about each row but the ends,
    (rows - 2,); residual: (rows,)."""
    second = np.abs(np.diff(residual, 2))
    if not second.size:
        return 0.0
    found = MAD * float(np.median(second)) / math.sqrt(6.0)
    for _ in range(TURNS):
        quiet = lies < (QUIET * found) ** 2
        if np.sum(quiet) < FEWEST * second.size:
            break
        found = MAD * float(np.median(second[quiet])) / math.sqrt(6.0)
    return found
