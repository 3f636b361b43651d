"""What a second run on the same target gains over the first: errors of both, in decades or in K, and the reduction.

The errors are those of `rig.analysis.score`: of what the instruments show, over the whole target. The reduction's
interval comes from blocks of the target drawn with replacement, as that of a diagnosis' gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.score import Rows, largest, profile_error, rms, tracking_error
from rig.config.target import Target
from sim.inference.gain import gain

SAME = 1e-6  # of a target's values: what their writing as resistances and back may change
FEWEST = 60  # rows that both runs have, one for each block


@dataclass(frozen=True, eq=False)
class Followed:
    """How a run followed its target. unit: "dec" or "K"; time_s: of the target, and the error there, (rows,)."""

    unit: str
    time_s: Array
    error: Array

    @property
    def rms(self) -> float:
        return rms(self.error)

    @property
    def largest(self) -> float:
        return largest(self.error)

    def document(self) -> dict[str, float]:
        """As JSON has it."""
        return {f"rms_{self.unit}": self.rms, f"max_{self.unit}": self.largest}


@dataclass(frozen=True)
class Gained:
    """reduction: 1 - RMS of the second over RMS of the first; ci95: its 95 % interval."""

    reduction: float
    ci95: tuple[float, float]

    @property
    def in_words(self) -> str:
        low, high = (100.0 * value for value in self.ci95)
        if low > 0.0:
            return f"{100.0 * self.reduction:.0f} % less ({low:.0f} to {high:.0f} %)"
        if high < 0.0:
            return f"{-100.0 * self.reduction:.0f} % more ({-high:.0f} to {-low:.0f} %): nothing is gained"
        return f"no difference that shows ({low:.0f} to {high:.0f} % less)"


def followed(run: Rows) -> Followed | None:
    """None where no row of the run followed a target with a reading."""
    for unit, error_of in (("dec", tracking_error), ("K", profile_error)):
        time, error = error_of(run)
        if np.any(np.isfinite(error)):
            return Followed(unit, time, error)
    return None


def same_target(one: Target, other: Target) -> bool:
    """Whether two runs followed the same course."""
    if one.quantity != other.quantity or one.times_s.shape != other.times_s.shape:
        return False
    return bool(
        np.allclose(one.times_s, other.times_s, rtol=SAME, atol=SAME)
        and np.allclose(one.values, other.values, rtol=SAME, atol=SAME)
    )


def gained(first: Followed | None, second: Followed | None) -> Gained | None:
    """None where one has no error, or they are too short for an interval."""
    if first is None or second is None or first.unit != second.unit or second.time_s.size < FEWEST:
        return None
    before, after = first.error, _at_the_rows_of(first, second)
    both = np.isfinite(before) & np.isfinite(after)
    if int(np.sum(both)) < FEWEST:
        return None
    found = gain(before, after, both)
    return Gained(1.0 - found.rmse_after / found.rmse_before, found.reduction_ci95)


def _at_the_rows_of(first: Followed, second: Followed) -> Array:
    """The second's errors at the times of the first's rows: a tick that one of them missed is nan, and shifts no other
    row."""
    times = second.time_s
    after = np.clip(np.searchsorted(times, first.time_s), 1, times.size - 1)
    nearest = np.where(first.time_s - times[after - 1] < times[after] - first.time_s, after - 1, after)
    near = np.abs(times[nearest] - first.time_s) <= 0.5 * float(np.median(np.diff(times)))
    return np.where(near, second.error[nearest], np.nan)


def news(effects: Sequence[Mapping[str, Any]], known: Sequence[Mapping[str, Any]]) -> list[str]:
    """Of the effects that a diagnosis names (as its JSON has them) those that a model does not have, or with a value
    that the record does not bear out: its own estimate may be as far off as the one found, so that it is held against
    an interval twice as wide."""
    has = {str(table["name"]): table for table in known}
    return [str(e["name"]) for e in effects if not _has(has.get(str(e["name"])), e["parameters"])]


def as_effects(candidate: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The effects of a candidate, each as one that is named."""
    return [{"name": name, "parameters": candidate["parameters"][name]} for name in candidate["names"]]


def _has(table: Mapping[str, Any] | None, parameters: Mapping[str, Any]) -> bool:
    if table is None:
        return False
    for name, found in parameters.items():
        if found["ci95"] is not None:
            low, high = found["ci95"]
            if abs(float(table[name]) - 0.5 * (low + high)) > high - low:
                return False
    return True
