"""Repetitions of a tracking run: each uses the errors that earlier ones measured along the target.

    model_lacks   error of the film model over time (`compensator.control.repetition`), subtracted from readings and
                  target, so that the law controls a film that its model describes
    correction    tracking error over time, added to the target: for a law without a film model, and for a model with
                  effects on the ohmmeter, whose output is not the reading

    correction.csv   in a run's folder: the correction that was used (time_s, and model_lacks_dec or correction_dec, on
                     -log10 R)
    learned.csv      the correction for the next repetition

If a correction makes the error larger, the one with the smallest error is used for all further repetitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from compensator.control.law_step import LawName
from compensator.control.repetition import corrected_reference, model_error
from compensator.hysteresis.functions import Array
from rig.analysis.error import TRACK, rms, tracking_error
from rig.config.model_file import Model
from rig.config.target import Target
from rig.control.policies import MODEL_LACKS
from rig.core.faults import fault
from rig.records.record_file import read_record, write_columns
from rig.records.run_folder import RunFolder

USED, LEARNED, CORRECTION = "correction.csv", "learned.csv", "correction"
LARGEST_DEC: Final = 0.2  # a model that is off by more is wrong in kind: learning would drive the film elsewhere
WORSE: Final = 1.05  # of the smallest error: two runs with the same correction differ by a few per cent by their noise


def read_correction(path: Path) -> Target:
    """Read the correction that a run has learned. Raises Faults."""
    record = read_record(path, needs=(), options=False)
    for quantity in (MODEL_LACKS, CORRECTION):
        if record.has(f"{quantity}_dec"):
            values = np.nan_to_num(record[f"{quantity}_dec"])
            return Target(quantity, record["time_s"], np.clip(values, -LARGEST_DEC, LARGEST_DEC))
    raise fault(path, f"{MODEL_LACKS}_dec", "missing; expected a file learned.csv of a run")


def write_correction(path: Path, correction: Target) -> None:
    """Write a correction for `read_correction`."""
    write_columns(path, {"time_s": correction.times_s, f"{correction.quantity}_dec": correction.values})


def learns_of(law: LawName, model: Model) -> str:
    """Return the kind of correction of a law with this model: `MODEL_LACKS` or `CORRECTION`."""
    by_its_film = law != "pid" and all(e.effect.link != "ohmmeter" for e in model.switched())
    return MODEL_LACKS if by_its_film else CORRECTION


def nothing_learned(quantity: str, target: Target, period_s: float) -> Target:
    """Return a correction of zero along the target."""
    grid: Array = np.arange(0.0, target.duration_s, period_s)
    return Target(quantity, grid, np.zeros(grid.size))


def next_correction(run: RunFolder, target: Target, used: Target, period_s: float) -> Target:
    """Return the correction of the next repetition, from a run with `used`."""
    grid: Array = np.arange(0.0, target.duration_s, period_s)
    before = used.at(grid)
    if used.quantity == MODEL_LACKS:
        time, found = lacked(run, target, used)
        after = before + np.interp(grid, time, found) if time.size else before
    else:
        time, error = tracking_error(run)
        good = np.isfinite(error)
        if not np.any(good):
            return Target(used.quantity, grid, before)
        # log10 of measured over wanted: what -log10 R lacks
        after = corrected_reference(before, np.interp(grid, time[good], error[good]))
    return Target(used.quantity, grid, np.clip(after, -LARGEST_DEC, LARGEST_DEC))


def lacked(run: RunFolder, target: Target, used: Target) -> tuple[Array, Array]:
    """Return the times of the ohmmeter's readings (s of the target), and the model's error beyond the correction."""
    inside = run.column("phase") == TRACK
    time, read_s, acts_s, ohm, model_ohm = (
        run.column(name)[inside]
        for name in ("time_s", "resistance_time_s", "acts_after_s", "resistance_ohm", "predicted_ohm")
    )
    told_s = time + np.nan_to_num(acts_s)  # the law says where the model is when its command acts
    rows = np.isfinite(read_s)
    good = rows & np.isfinite(model_ohm)
    if not np.any(good):
        return np.empty(0), np.empty(0)
    at_s = read_s[rows] - run.begun_s[TRACK]
    with np.errstate(invalid="ignore", divide="ignore"):
        off = -np.log10(ohm[rows]) + np.interp(read_s[rows], told_s[good], np.log10(model_ohm[good]))
    off[~np.isfinite(off)] = math.nan
    return at_s, model_error(off - used.at(at_s), np.abs(np.diff(target.at(at_s), prepend=target.values[0])))


@dataclass
class Learning:
    """The corrections of the repetitions so far.

    quantity: their kind (`learns_of`). best_rms_dec: the smallest error, with `best`. over: True if no more is learned.
    """

    quantity: str = MODEL_LACKS
    next: Target | None = None
    best: Target | None = None
    best_rms_dec: float = math.inf
    over: bool = False

    def take(self, run: RunFolder, target: Target, used: Target | None, period_s: float) -> None:
        """Learn from a repetition that has ended, which added `used` to the target."""
        used = used if used is not None else nothing_learned(self.quantity, target, period_s)
        error = rms(tracking_error(run)[1])
        if error > WORSE * self.best_rms_dec:
            self.over, self.next = True, self.best
            return
        if error < self.best_rms_dec:
            self.best, self.best_rms_dec = used, error
        self.next = self.best if self.over else next_correction(run, target, used, period_s)
