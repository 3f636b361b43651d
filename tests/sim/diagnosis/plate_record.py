"""A plate's record without a film, for tests of the plate's numbers: its own balance, no code of the simulator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Columns = dict[str, NDArray[np.float64]]
SEEBECK, JOULE, LOSS = 2e-3, 0.07, 0.02
STEPS = 200  # of the balance in a row


def record(
    room_degC: float,
    levels: NDArray[np.float64],
    seed: int,
    noise_K: float = 0.01,
    acts_after_s: float = 0.0,
    joule_per_K: float = 0.0,
) -> Columns:
    """A plate driven by currents that are held for 20 s each; one row a second, its current acting so much later.
    joule_per_K: by how much of itself the module's resistance grows, from 25 degC."""
    rng = np.random.default_rng(seed)
    current = np.repeat(levels, 20)
    degC, plate = np.empty(current.size), 25.0
    for k in range(current.size):
        degC[k] = plate
        for step in range(STEPS):
            amperes = current[k] if step >= acts_after_s * STEPS else current[max(k - 1, 0)]
            joule = JOULE * (1.0 + joule_per_K * (plate - 25.0))
            heat = SEEBECK * amperes * (plate + 273.15) + 0.5 * joule * amperes**2 - LOSS * (plate - room_degC)
            plate += heat / STEPS
    time = np.arange(float(current.size))
    return {"time_s": time, "temperature_degC": degC + noise_K * rng.standard_normal(degC.size), "current_A": current}


def levels(seed: int, count: int = 40) -> NDArray[np.float64]:
    """Currents in both directions, each fourth of them 0."""
    return np.random.default_rng(seed).uniform(-1.0, 1.5, count) * (np.arange(count) % 4 > 0)
