"""Where the minor loops of a calibration turn: between the ends of the transition, which the major loop has shown."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.outcome import Unsuitable
from rig.records.run_folder import RunFolder
from sim.inference.readings.output_sense import output_falls

MEAN_ROWS = 17  # of a lagging thermometer, before its slope is taken
LEAST_LOOP_DEC = 0.02  # between heating and cooling, for there to be a transition
ASIDE = 0.15  # of the transition's width, by which a nested loop's middle lies off its middle: no two about one point
LEAST_STEP = 0.15  # of the transition's width, between two turns: less moves few play operators


def transition_range(folder: RunFolder, lag_s: float = 0.0) -> tuple[float, float]:
    """Where the heating and the cooling branch of the major loop part: by more than 4 % of their largest distance.

    In degC. lag_s: of the thermometer behind the plate; a plain mean over some rows does here, where a current flows
    and nothing may be waited for. Raises Unsuitable where the film shows no loop in the range.
    """
    major = folder.column("phase") == "major"
    temperature = folder.column("temperature_degC")[major]
    if lag_s > 0.0:
        known = np.isfinite(temperature)
        time = folder.column("time_s")[major]
        filled = np.interp(time, time[known], temperature[known])
        smooth = np.convolve(np.pad(filled, MEAN_ROWS // 2, "edge"), np.ones(MEAN_ROWS) / MEAN_ROWS, "valid")
        temperature = smooth + lag_s * np.gradient(smooth, time)
    resistance = folder.column("resistance_ohm")[major]
    good = np.isfinite(resistance) & (resistance > 0.0) & np.isfinite(temperature)
    temperature, output = temperature[good], -np.log10(resistance[good])
    grid = np.linspace(temperature.min(), temperature.max(), 400)
    rising = np.gradient(temperature) > 0.0
    distance = _branch(temperature, output, ~rising, grid) - _branch(temperature, output, rising, grid)
    if output_falls([(temperature, output)]):  # a film whose resistance rises
        distance = -distance
    if float(np.max(distance)) < LEAST_LOOP_DEC:
        text = (
            f"heating and cooling differ by less than {LEAST_LOOP_DEC:g} decades anywhere between {grid[0]:.1f} and "
            f"{grid[-1]:.1f} degC: is the film connected, and does calibration.temperature_degC span its transition?"
        )
        raise Unsuitable("no_transition", text)
    inside = grid[distance > 0.04 * float(np.max(distance))]
    return float(inside[0]), float(inside[-1])


def _branch(temperature: Array, output: Array, rows: Array, grid: Array) -> Array:
    """Mean output of the chosen rows over the grid."""
    order = np.argsort(temperature[rows], kind="stable")
    found: Array = np.interp(grid, temperature[rows][order], output[rows][order])
    return found


def minor_turning_points(span: tuple[float, float], within: tuple[float, float], loops: int, seed: int) -> list[float]:
    """Turning points of minor loops about the transition, high and low by turns, from the cold end.

    Nested loops first, shrinking as the damped oscillations of the paper's figure 2; then random ones, so that loops
    begin and end everywhere. The widest may turn beyond an end of the transition, by `ASIDE` of its width, but none
    outside of `within`, where the plate is let go: a film of relays told by loops that all end inside was predicted
    two to three times worse by feedforward.
    """
    low, high = span
    width = high - low
    random = np.random.default_rng(seed)
    points: list[float] = []
    nested = max(2, loops // 3)
    for k in range(nested):
        share = 1.0 - k / nested
        middle = low + width * (0.5 + ASIDE * float(random.uniform(-1.0, 1.0)))
        points += [min(middle + 0.5 * share * width, within[1]), max(middle - 0.5 * share * width, within[0])]
    for _ in range(loops - nested):
        for sign in (1.0, -1.0):
            room = (high - points[-1]) if sign > 0.0 else (points[-1] - low)  # the step before left its own length
            points.append(points[-1] + sign * float(random.uniform(min(LEAST_STEP * width, room), room)))
    return points


def fitted_and_checked(turns: list[float]) -> tuple[list[float], list[float]]:
    """The turning points of the loops that film and plate are fitted to, three quarters of all, and of those after them
    that no fit sees."""
    fitted = max(2, (3 * len(turns)) // 4)
    return turns[:fitted], turns[fitted:]
