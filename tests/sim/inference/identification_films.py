"""Films and profiles that identification is tried on: of the model's class, and a relay film that is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless

Array = NDArray[np.float64]


def is_prandtl_ishlinskii(seed: int) -> FilmModel:
    """An extended generalized PI film with radii that lie on no grid and keep the order condition."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(8, 14))
    places = np.sort(rng.uniform(0.03, 0.85, count))
    weights = np.exp(0.5 * rng.normal(size=count) - 2.0 * places)
    weights *= rng.uniform(0.6, 1.1) / np.sum(weights * (1.0 - places))
    slope_r, slope_l = rng.uniform(0.12, 0.25, 2)
    centre_l = 60.0 + rng.uniform(-1.0, 1.0)
    centre_r = max(60.0 + rng.uniform(-1.0, 1.0), centre_l - 0.5)
    rising = Envelope("tanh", slope_r, -slope_r * centre_r)
    falling = Envelope("tanh", slope_l, -slope_l * centre_l)
    memoryless = Memoryless("tanh", 0.3, 0.03, -1.6, -3.26)
    trial = FilmModel(places, weights, rising, falling, memoryless)
    floor = max(0.0, 0.5 * float(np.max(2.0 * places - trial.order_margin())))
    return FilmModel(floor + (1.0 - floor) * places, weights, rising, falling, memoryless)


def through(turning_degC: list[float], samples: int) -> Array:
    """Temperatures at a constant speed through turning points, shape (samples,)."""
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(turning_degC)))))
    return np.interp(np.linspace(0.0, travel[-1], samples), travel, turning_degC)


def decaying_profile(samples: int, loops: int = 16) -> Array:
    """From 90 degC in ever smaller loops around 62 degC, then out to 30 degC."""
    turning, low, high = [90.0], 35.0, 88.0
    for k in range(loops):
        turning.append(low if k % 2 == 0 else high)
        low, high = low + 1.6, high - 1.5
    return through([*turning, 30.0], samples)


def random_profile(samples: int, seed: int) -> Array:
    """From 90 degC through fifty random turning points between 40 and 80 degC."""
    rng = np.random.default_rng(seed)
    return through([90.0, *rng.uniform(40.0, 80.0, 50), 30.0], samples)


def relay_film(
    temperature_degC: Array,
    relays: int = 4000,
    seed: int = 1,
    *,
    spread_K: float = 3.2,
    half_width_K: float = 2.8,
    width_spread: float = 0.4,
    centre: float = 61.0,
) -> Array:
    """-log10 R of a film of relays, first all switched up: means N(centre, spread_K) degC, half-widths lognormal with
    median half_width_K and sigma width_spread, 1.5 decades in all, and 0.35 tanh(0.03 (T - 55)); shape (samples,)."""
    rng = np.random.default_rng(seed)
    mean = rng.normal(centre, spread_K, relays)
    half_width = half_width_K * np.exp(width_spread * rng.normal(size=relays))
    up, down = mean + half_width, mean - half_width
    state = np.ones(relays)
    share = np.empty(temperature_degC.size)
    for k, v in enumerate(temperature_degC):
        state[v > up] = 1.0
        state[v < down] = -1.0
        share[k] = np.mean(state)
    return 0.75 * share + 0.35 * np.tanh(0.03 * (temperature_degC - 55.0)) - 3.2
