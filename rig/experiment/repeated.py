"""Repetitions of a tracking run: what one missed is added to the target of the next (`compensator.control.learning`).

    correction.csv   in a run's folder: what was added to its target (time_s, correction_dec, on -log10 R)
    learned.csv      what the next repetition would add

A correction that made the error larger is given up: the one with the smallest error is then used to the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from compensator.control.learning import learned
from compensator.hysteresis.functions import Array
from rig.analysis.score import Rows, rms, tracking_error
from rig.core.faults import fault
from rig.files.record_file import read_record, write_columns
from rig.files.target import Target

USED, LEARNED, COLUMN = "correction.csv", "learned.csv", "correction_dec"
LARGEST_DEC: Final = 0.2  # a model that is off by more is wrong in kind: learning would drive the film elsewhere
WORSE: Final = 1.05  # of the smallest error: two runs with the same correction differ by a few per cent by their noise


def read_correction(path: Path) -> Target:
    """Raises Faults."""
    record = read_record(path, needs=(), flags=False)
    if not record.has(COLUMN):
        raise fault(path, COLUMN, "missing; expected what a run has learned")
    return Target("correction", record["time_s"], np.clip(np.nan_to_num(record[COLUMN]), -LARGEST_DEC, LARGEST_DEC))


def write_correction(path: Path, correction: Target) -> None:
    """As `read_correction` reads it."""
    write_columns(path, {"time_s": correction.times_s, COLUMN: correction.values})


def nothing_learned(target: Target, period_s: float) -> Target:
    """Zero all along the target: a run without a correction was the best, and whoever begins from it begins there."""
    grid: Array = np.arange(0.0, target.duration_s, period_s)
    return Target("correction", grid, np.zeros(grid.size))


def next_correction(run: Rows, target: Target, used: Target | None, period_s: float) -> Target:
    """What the next repetition adds to the target, out of a run that added `used`."""
    used = used if used is not None else nothing_learned(target, period_s)
    grid: Array = np.arange(0.0, target.duration_s, period_s)
    before = used.at(grid)
    time, error = tracking_error(run)
    good = np.isfinite(error)
    if not np.any(good):
        return Target("correction", grid, before)
    missed = np.interp(grid, time[good], error[good])  # log10 of measured over wanted: what -log10 R lacks
    return Target("correction", grid, np.clip(learned(before, missed), -LARGEST_DEC, LARGEST_DEC))


@dataclass
class Learning:
    """What the repetitions so far have taught. best_rms_dec: the smallest error, with `best`; over: nothing more is
    learned."""

    next: Target | None = None
    best: Target | None = None
    best_rms_dec: float = math.inf
    over: bool = False

    def take(self, run: Rows, target: Target, used: Target | None, period_s: float) -> None:
        """A repetition has ended that added `used` to the target."""
        error = rms(tracking_error(run)[1])
        if error > WORSE * self.best_rms_dec:
            self.over, self.next = True, self.best
            return
        if error < self.best_rms_dec:
            self.best, self.best_rms_dec = used if used is not None else nothing_learned(target, period_s), error
        self.next = self.best if self.over else next_correction(run, target, used, period_s)
