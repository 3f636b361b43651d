"""How far a law has to look ahead: as long as the plate takes across the film's loop.

At a turning point of the wanted output the wanted temperature jumps across the loop, at most by its width, and the
plate has to leave before the jump. What lies further ahead than the crossing changes nothing of what to do now.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.thermal.plate import PlateModel

STEP_K: Final = 0.05  # of the grid on which the branches are compared; a loop is some kelvin wide
TAIL: Final = 0.02  # of the major loop's range at either end, where its branches run together and a width means nothing
POINTS: Final = 12  # targets over a crossing: with twice as many the error is 2 % less (`benchmark tracking`, slow)
POINTS_OF_A_LAG: Final = 20  # targets over a film's lag: half as many leave 1.3 times the error of 2 s, twice the same
LONGEST_S: Final = 120.0  # of a heater that cools by itself; a step of the law takes longer with each target


def crossing_s(film: FilmModel, plate: PlateModel, limit_A: float, low_degC: float, high_degC: float) -> float:
    """The longest that the plate takes (s), within its current limit, from one branch of the film's major loop to the
    other at the same output; 0 for a film without a loop between these temperatures."""
    grid = np.arange(low_degC, high_degC, STEP_K)
    if grid.size < 2:
        return 0.0
    rising, _ = film.simulate(grid, film.initial_memory(low_degC, "heated"))
    falling, _ = film.simulate(grid[::-1], film.initial_memory(high_degC, "cooled"))
    rising, falling = np.maximum.accumulate(rising), np.maximum.accumulate(falling[::-1])
    least, most = max(rising[0], falling[0]), min(rising[-1], falling[-1])
    inside = TAIL * (most - least)
    levels = np.linspace(least + inside, most - inside, 200)
    up, down = np.interp(levels, rising, grid), np.interp(levels, falling, grid)
    longest = 0.0
    for warm, cold in zip(up, down, strict=True):
        if warm > cold:
            cooling, heating = plate.rate_range_K_per_s(0.5 * float(warm + cold), limit_A)
            slower = min(-cooling, heating)
            longest = max(longest, float(warm - cold) / slower if slower > 0.0 else LONGEST_S)
    return min(longest, LONGEST_S)


def preview(horizon_s: float, period_s: float, lag_s: float = 0.0) -> tuple[int, float]:
    """(how many targets, how far apart in s) over a horizon: at least two, no closer than a period; lag_s: of the film
    behind the plate, which has to be told in time how its goals change their rate."""
    spacing_s = horizon_s / POINTS
    if lag_s > 0.0:
        spacing_s = min(spacing_s, lag_s / POINTS_OF_A_LAG)
    spacing_s = max(period_s, spacing_s)
    return max(2, math.ceil(horizon_s / spacing_s - 1e-9)), spacing_s
