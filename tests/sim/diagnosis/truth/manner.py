"""How a record is taken: sampling, noise, rates, profile, test currents. As the issue's cases are, and unlike them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.sim.diagnosis.truth.profiles import damped_cycles, steps_and_dithers, triangles, waves

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Manner:
    """noise: least and largest of thermometer (K) and ohmmeter (decades); speed: of the rates, times the usual ones;
    profile: as in `profiles`; one_current: the test current never changes; told_current: it is in the record;
    few_operators: the film has 4 to 11, with weights that fall off."""

    interval_s: float = 0.5
    rows: int = 6000
    noise: tuple[tuple[float, float], tuple[float, float]] = ((0.005, 0.001), (0.02, 0.004))
    speed: float = 1.0
    profile: str = "damped_cycles"
    one_current: bool = False
    told_current: bool = True
    few_operators: bool = False


USUAL = Manner()
UNLIKE = {
    "rows_of_0.2_s": Manner(interval_s=0.2, rows=9000),
    "rows_of_1_s": Manner(interval_s=1.0, rows=4000),
    "2000_rows": Manner(rows=2000),
    "little_noise": Manner(noise=((0.002, 0.0004), (0.002, 0.0004))),
    "much_noise": Manner(noise=((0.05, 0.01), (0.05, 0.01))),
    "slow": Manner(speed=0.4),
    "steps": Manner(profile="steps_and_dithers"),
    "triangles": Manner(profile="triangles"),
    "waves": Manner(profile="waves"),
    "one_current": Manner(one_current=True),
    "current_not_told": Manner(told_current=False),
    "few_operators": Manner(few_operators=True),
}


def setpoints(
    manner: Manner, rng: np.random.Generator, time: Array, start: float, low: float, high: float, rates: Array
) -> Array:
    """The temperatures asked for."""
    if manner.profile == "damped_cycles":
        return damped_cycles(rng, time, start, low, high, rates)
    if manner.profile == "steps_and_dithers":
        return steps_and_dithers(rng, time, start, low, high)
    if manner.profile == "triangles":
        return triangles(time, start, low - 5.0, min(high + 5.0, 92.0), (0.2, 0.4, 0.6))
    if manner.profile == "waves":
        return waves(time, start, low, high)
    raise ValueError(f"profile {manner.profile!r}")
