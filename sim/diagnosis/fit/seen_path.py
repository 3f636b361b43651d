"""What a film shows of the error of the path that drives it: its slope there, and what it remembers of each turn."""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.path_error import PathError, SeenPathError
from sim.diagnosis.fit.path_estimate import straight_path
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit

STEEPNESS_ROWS: Final = 15  # about a row
LEAST_MOVED_K: Final = 0.01  # over them: a plate that stands tells no slope
NOTHING: Final = 1e-4  # of a deviation
AT_THE_TURN: Final = 2.0  # standard deviations from where the path turned: rows that may be where it did


def seen_path(channel: ResistanceChannel, fit: ResistanceFit, error: PathError) -> SeenPathError:
    """What a film that is as the fit has it shows of the error."""
    return SeenPathError(error, steepness(channel, fit), _of_turns(channel, fit, error))


def _of_turns(channel: ResistanceChannel, fit: ResistanceFit, error: PathError) -> Array:
    """What is shown where the path turned a standard deviation later, (rows, turns): half of the difference to one that
    turned as much earlier."""
    time, degC, off_K = channel.record.time_s, channel.path.at(channel.record.time_s), error.deviation_K
    columns = np.zeros((time.size, error.turns.size))
    for k, turn in enumerate(error.turns):
        near = np.exp(-0.5 * ((degC - degC[turn]) / (AT_THE_TURN * off_K[turn])) ** 2)
        away = np.flatnonzero(near < NOTHING)
        before, after = away[away < turn], away[away > turn]  # the path may come by there again
        near[: before[-1] + 1 if before.size else 0] = 0.0
        near[after[0] if after.size else time.size :] = 0.0
        both = [
            channel.on(straight_path(time, degC + side * off_K[turn] * near)).predict_from(fit.parameters, fit)[0]
            for side in (1.0, -1.0)
        ]
        columns[:, k] = 0.5 * (both[0] - both[1])
    return columns


def steepness(channel: ResistanceChannel, fit: ResistanceFit) -> Array:
    """By how much what is shown changes with the plate's temperature about each row, decades / K, (rows,)."""
    around = np.ones(STEEPNESS_ROWS)
    moved = np.abs(np.gradient(channel.path.at(channel.record.time_s)))
    shown = np.abs(np.gradient(fit.shown))
    per = np.convolve(shown, around, "same") / np.maximum(np.convolve(moved, around, "same"), LEAST_MOVED_K)
    return np.asarray(per, dtype=np.float64)
