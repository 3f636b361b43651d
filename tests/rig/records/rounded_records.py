"""Records of films and plates as labs write them, with rounded readings; made apart from `sim`."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HEATING_DEGC, COOLING_DEGC = 63.0, 57.0


def log10_ohm(degC: Array, lag_rows: float = 0.0) -> Array:
    """A film's log10 R along a course of temperatures: two branches, and constant conduction between them."""
    width, decades = 2.0, 3.4
    shown, out = float(degC[0]), np.empty(degC.size)
    inside = float(1.0 / (1.0 + np.exp((degC[0] - HEATING_DEGC) / width)))  # 0: a metal, 1: an insulator
    for k, true in enumerate(degC):
        shown += (float(true) - shown) / (1.0 + lag_rows)
        least = 1.0 / (1.0 + np.exp((shown - COOLING_DEGC) / width))
        most = 1.0 / (1.0 + np.exp((shown - HEATING_DEGC) / width))
        inside = min(max(inside, least), most)
        out[k] = 2.1 + decades * inside - 0.003 * (shown - 27.0) - 0.009 * (shown - 27.0) * inside
    return out


def ramps(points: list[float], rate_K_per_row: float, hold_rows: int = 0) -> Array:
    """A course through the points (degC), with a hold at each."""
    course = [np.full(max(hold_rows, 1), points[0])]
    for before, after in itertools.pairwise(points):
        rows = max(int(abs(after - before) / rate_K_per_row), 1)
        course.append(np.linspace(before, after, rows + 1)[1:])
        course.append(np.full(hold_rows, after))
    return np.concatenate(course)


def plate_course(current_A: Array, step_s: float, tau_s: float = 60.0, K_per_A: float = 20.0) -> Array:
    """A plate of one mass at 25 degC that follows a current."""
    degC, out = 25.0, np.empty(current_A.size)
    for k, current in enumerate(current_A):
        out[k] = degC
        degC += (25.0 + K_per_A * current - degC) * step_s / tau_s
    return out


def slower(values: Array, times: int) -> Array:
    """Readings of an instrument that is so many times slower than the rows."""
    return np.asarray(values[np.arange(values.size) // times * times])


def clean(seed: int) -> dict[str, Any]:
    """One of many records in which nothing is wrong; what it is made of is drawn."""
    random = np.random.default_rng(seed)
    step_s = float(random.choice([0.1, 0.5, 1.0, 2.0, 10.0]))
    digit = float(random.choice([0.001, 0.01, 0.0625, 0.1, 0.25, 0.49, 0.5]))
    noise = float(random.choice([0.0, 0.2, 1.0, 4.0])) * min(digit, 0.05)
    rate = float(random.choice([0.01, 0.05, 0.2, 1.0])) * (1.0 if step_s < 10.0 else 5.0)
    kind = ("loop", "holds", "stairs", "steps", "dither", "loops")[seed % 6]
    lag_rows = float(random.choice([0.0, 1.0, 2.0] if kind == "stairs" else [0.0, 2.0, 10.0, 30.0]))
    current = None
    if kind == "loop":
        degC = ramps([27.0, 83.0, 27.0], max(rate, 0.05), int(random.integers(0, 60)))
    elif kind == "loops":
        degC = ramps([27.0, 83.0, 50.0, 66.0, 55.0, 70.0, 27.0], max(rate, 0.05), int(random.integers(0, 10)))
    elif kind == "holds":
        degC = ramps(
            [50.0, 60.0, 61.0, 70.0, 62.0, 58.0, 62.0, 50.0, 64.0], max(rate, 0.05), int(random.integers(40, 200))
        )
    elif kind == "stairs":  # the plate is faster than the rows
        levels = [*np.arange(45.0, 75.0, 1.5), *np.arange(75.0, 45.0, -3.0), 70.0, 50.0]
        degC = np.repeat(levels, int(random.integers(2, 25)))
    elif kind == "steps":
        current = np.repeat(random.uniform(0.3, 3.0, 12), int(random.integers(20, 120)))
        degC = plate_course(current, step_s, float(random.choice([20.0, 120.0])))
    else:  # a controller at rest, whose current dithers
        degC = ramps([30.0, 61.0], min(max(rate, 0.05), 0.2), 400)
        degC += 0.3 * digit * np.sin(np.arange(degC.size) / 7.0)
        current = 1.0 + 0.02 * (degC - 30.0) + random.normal(0.0, 0.3, degC.size)
    time = np.arange(degC.size) * step_s
    if random.random() < 0.3:  # late rows, with their own times
        late = random.uniform(0.0, 0.4, degC.size) * step_s
        degC, time = np.interp(time + late, time, degC), time + late
    log_R = log10_ohm(degC, lag_rows) + random.normal(0.0, 0.001, degC.size)
    log_R += float(random.choice([0.0, 0.0, 1e-4])) * np.arange(degC.size) / 50.0  # contacts drift
    read = degC + random.normal(0.0, 1.0, degC.size) * noise
    if random.random() < 0.25:
        read = slower(read, int(random.integers(2, 12)))
    record: dict[str, Any] = {
        "time_s": np.round(time, 3),
        "temperature_degC": np.round(np.round(read / digit) * digit, 6),
    }
    if current is None or random.random() < 0.5:
        record["resistance_ohm"] = np.array([float(f"{10.0**value:.6g}") for value in log_R])
    if current is not None:
        record["current_A"] = np.round(current, 3)
    return record


def film_loop(digit: float = 0.001, noise: float = 0.03, seed: int = 0) -> dict[str, Any]:
    """Two major loops of 300 rows each at 0.28 K/s, written every 2 s."""
    random = np.random.default_rng(seed)
    degC = ramps([27.0, 83.0, 27.0, 83.0, 27.0], 0.56)
    log_R = log10_ohm(degC) + random.normal(0.0, 0.002, degC.size)
    read = degC + random.normal(0.0, noise, degC.size)
    return {
        "time_s": 2.0 * np.arange(degC.size),
        "temperature_degC": np.round(np.round(read / digit) * digit, 6),
        "resistance_ohm": 10.0**log_R,
    }


def frozen(record: dict[str, Any], first: int, end: int) -> dict[str, Any]:
    """The same with a thermometer that stands still in rows first..end - 1."""
    return changed(record, lambda degC: degC.__setitem__(slice(first, end), degC[max(first - 1, 0)]))


def changed(record: dict[str, Any], change: Callable[[Array], None]) -> dict[str, Any]:
    """The same with other readings of the thermometer."""
    degC = record["temperature_degC"].copy()
    change(degC)
    return {**record, "temperature_degC": degC}


def plate_run(digit: float, noise: float, seed: int = 0) -> dict[str, Any]:
    """A plate that follows a slow wave of the current, a row a second."""
    random = np.random.default_rng(seed)
    time = np.arange(400.0)
    current = np.round(1.5 + 1.2 * np.sin(time / 30.0), 3)
    read = plate_course(current, 1.0) + random.normal(0.0, 1.0, time.size) * noise
    return {"time_s": time, "temperature_degC": np.round(np.round(read / digit) * digit, 6), "current_A": current}
