"""A film's range of resistance, and films that somebody has left somewhere in it: for runs of an unknown memory."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

HOT_DEGC, COLD_DEGC = 85.0, 35.0  # of a calibration
LEFT_TURNS = 4


def span(film: Any) -> tuple[float, float]:
    """The film's range of log10 R over the calibration's temperatures: of its major loop."""
    up = [film.log_ohm(t) for t in np.arange(COLD_DEGC, HOT_DEGC, 0.1)]
    down = [film.log_ohm(t) for t in np.arange(HOT_DEGC, COLD_DEGC, -0.1)]
    return max(min(up), min(down)), min(max(up), max(down))


def middle_of(film: Any) -> tuple[float, float]:
    """The middle 80 % of it."""
    low, high = span(film)
    return low + 0.1 * (high - low), high - 0.1 * (high - low)


def up_to(end_s: float, times: list[float], values: list[float]) -> tuple[list[float], list[float]]:
    """The beginning of a course."""
    rows = [(t, y) for t, y in zip(times, values, strict=True) if t < end_s]
    rows.append((end_s, float(np.interp(end_s, times, values))))
    return [t for t, _ in rows], [y for _, y in rows]


def leave_behind(film: Any, seed: int, left: str) -> float:
    """Somebody takes the film into its loop and leaves it there. The temperature there, degC.

    left: "turns": from an end, turning round at random levels of its middle 80 %. "other branch": straight from the
    cold to a level, where a model that says `initial = "cooled"`, as the format has it by default, has every operator
    elsewhere.
    """
    low, high = middle_of(film)
    chance = random.Random(1000 + seed)
    degC = chance.choice((25.0, HOT_DEGC)) if left == "turns" else 25.0
    log_ohm = film.log_ohm(degC)
    for _ in range(LEFT_TURNS if left == "turns" else 1):
        level = chance.uniform(low, high)
        way = 1.0 if log_ohm > level else -1.0  # heating lowers the resistance
        while way * (log_ohm - level) > 0.0:
            degC += way * 0.02
            log_ohm = film.log_ohm(degC)
    return degC
