"""Repetitions of a tracking run: what the film model lacks of the output goes from one run into the next.

It is taken off the readings and off the target, so that the law goes by a film that its model describes
(`compensator.control.estimator`).

    correction.csv   in a run's folder: what was used (time_s, model_lacks_dec: on -log10 R)
    learned.csv      what the next repetition would use

If a correction makes the error larger it is given up: the one with the smallest error is then used to the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from compensator.control.estimator import model_error
from compensator.hysteresis.functions import Array
from rig.analysis.error import TRACK, rms, tracking_error
from rig.config.configuration import ConfigurationFile
from rig.config.model_file import Model
from rig.config.target import Target
from rig.core.faults import fault
from rig.records.record_file import read_record, write_columns
from rig.records.run_folder import RunFolder

USED, LEARNED, COLUMN = "correction.csv", "learned.csv", "model_lacks_dec"
LARGEST_DEC: Final = 0.2  # a model that is off by more is wrong in kind: learning would drive the film elsewhere
WORSE: Final = 1.05  # of the smallest error: two runs with the same correction differ by a few per cent by their noise


def read_correction(path: Path) -> Target:
    """Read what a run has learned. Raises Faults."""
    record = read_record(path, needs=(), options=False)
    if not record.has(COLUMN):
        raise fault(path, COLUMN, "missing; expected what a run has learned")
    values = np.clip(np.nan_to_num(record[COLUMN]), -LARGEST_DEC, LARGEST_DEC)
    return Target("model_lacks", record["time_s"], values)


def write_correction(path: Path, correction: Target) -> None:
    """Write a correction for `read_correction`."""
    write_columns(path, {"time_s": correction.times_s, COLUMN: correction.values})


def check_repeatable(file: ConfigurationFile, model: Model | None) -> None:
    """Raise Faults if nothing can be learned from run to run: only the error of a film model that the law goes by."""
    e = file.content.experiment
    if e.repeat == 1 and e.learned is None:
        return
    what = None
    if e.kind != "track_resistance":
        what = f"kind {e.kind!r}; expected 'track_resistance': a resistance is what repetitions learn"
    elif e.law == "pid":
        what = "law 'pid'; expected one with a film model, whose error is what repetitions learn"
    elif model is not None and (effects := [each.name for each in model.switched() if each.effect.link == "ohmmeter"]):
        what = f"the model has {effects[0]}, an effect on the ohmmeter; expected none, as its film is not what is read"
    if what is not None:
        raise fault(file.path, "experiment.repeat" if e.repeat > 1 else "experiment.learned", what)
    if e.learned is not None:
        read_correction(file.beside(e.learned) / LEARNED)


def next_correction(run: RunFolder, target: Target, used: Target, period_s: float) -> Target:
    """Return the correction of the next repetition, from a run with `used`."""
    grid: Array = np.arange(0.0, target.duration_s, period_s)
    time, found = lacked(run, target, used)
    after = used.at(grid) + (np.interp(grid, time, found) if time.size else 0.0)
    return Target("model_lacks", grid, np.clip(after, -LARGEST_DEC, LARGEST_DEC))


def lacked(run: RunFolder, target: Target, used: Target) -> tuple[Array, Array]:
    """Return when the ohmmeter was read (s of the target), and what the model lacked then beyond what was known."""
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
    """What the repetitions so far have taught. best_rms_dec: the smallest error, with `best`; over: nothing more is
    learned."""

    next: Target | None = None
    best: Target | None = None
    best_rms_dec: float = math.inf
    over: bool = False

    def take(self, run: RunFolder, target: Target, used: Target | None, period_s: float) -> None:
        """Learn from a repetition that has ended, which used this correction."""
        used = used if used is not None else Target("model_lacks", np.zeros(1), np.zeros(1))
        error = rms(tracking_error(run)[1])
        if error > WORSE * self.best_rms_dec:
            self.over, self.next = True, self.best
            return
        if error < self.best_rms_dec:
            self.best, self.best_rms_dec = used, error
        self.next = self.best if self.over else next_correction(run, target, used, period_s)
