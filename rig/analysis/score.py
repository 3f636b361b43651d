"""How well a target was followed: one definition, of what `run` prints, what run.json keeps and what the report says.

The error of a row is log10 of measured over wanted resistance, in decades; of a temperature measured less wanted, K.
Counted is the whole target, from its first row to its last, its steps and turning points among them. What comes before
it is not: conditioning, the way to the first value, and `experiment.settle_s` on that value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from compensator.hysteresis.functions import Array

COUNTED = "over the whole target, its first row to its last"
TRACK, PROFILE = "track", "profile"  # the phases that follow a target


class Rows(Protocol):
    """Rows of a run, by column."""

    def column(self, name: str) -> Any: ...


@dataclass(frozen=True)
class Score:
    """How well a law tracked, over the whole target: errors in decades.

    max_at_s: when the largest error was, s of the target. p95_dec: 95 % of the rows are within it. current_at_limit:
    share of the time that the current was at its limit. samples: rows counted; missing: rows without a reading.
    """

    law: str
    rms_dec: float
    max_dec: float
    max_at_s: float
    p95_dec: float
    current_at_limit: float
    samples: int
    missing: int

    def table(self) -> dict[str, Any]:
        return dict(self.__dict__)

    def in_words(self) -> str:
        """For a line on the terminal."""
        largest = f"largest {self.max_dec:.3f} dec, at {self.max_at_s:.1f} s"
        return f"RMS error {self.rms_dec:.4f} dec, {largest} ({COUNTED})"


def error_dec(resistance_ohm: Array, target_ohm: Array) -> Array:
    """log10 of measured over wanted resistance; nan where either is none."""
    error = np.full(resistance_ohm.shape, math.nan)
    good = np.isfinite(resistance_ohm) & (resistance_ohm > 0.0) & np.isfinite(target_ohm)
    error[good] = np.log10(resistance_ohm[good]) - np.log10(target_ohm[good])
    return error


def rms(error: Array) -> float:
    """Root mean square of the finite ones; nan where there is none."""
    counted = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(counted**2))) if counted.size else math.nan


def largest(error: Array) -> float:
    """The largest of the finite ones, without its sign; nan where there is none."""
    counted = error[np.isfinite(error)]
    return float(np.max(np.abs(counted))) if counted.size else math.nan


def tracking_error(run: Rows) -> tuple[Array, Array]:
    """Time of the target (s) and error (decades) of the rows that followed a resistance; both empty where none did."""
    inside = run.column("phase") == TRACK
    time = run.column("time_s")[inside]
    error = error_dec(run.column("resistance_ohm")[inside], run.column("target_ohm")[inside])
    return time - time[:1].sum(), error


def profile_error(run: Rows) -> tuple[Array, Array]:
    """Time of the target (s) and error (K) of the rows that followed a temperature; all nan where none was wanted."""
    inside = run.column("phase") == PROFILE
    time = run.column("time_s")[inside]
    return time - time[:1].sum(), (run.column("temperature_degC") - run.column("setpoint_degC"))[inside]


def score(run: Rows, law: str, limit_A: float) -> Score | None:
    """The score of a run; None where no row of the target has a reading."""
    time, error = tracking_error(run)
    good = np.isfinite(error)
    if not np.any(good):
        return None
    current = run.column("current_A")[run.column("phase") == TRACK]
    size = np.abs(error[good])
    known = bool(np.all(np.isfinite(current)))
    return Score(
        law=law,
        rms_dec=rms(error),
        max_dec=largest(error),
        max_at_s=float(time[good][int(np.argmax(size))]),
        p95_dec=float(np.quantile(size, 0.95)),
        current_at_limit=float(np.mean(np.abs(current) >= 0.999 * limit_A)) if known else math.nan,
        samples=int(good.sum()),
        missing=int(good.size - good.sum()),
    )
