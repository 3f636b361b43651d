"""How well a target was followed: one definition, of what `run` prints, what run.json keeps and what the report says.

The error of a row is log10 of measured over wanted resistance, in decades; of another quantity that the meter reads,
and of a temperature, measured less wanted in its unit.
Counted is the whole target, from its first row to its last, its steps and turning points among them. What comes before
it is not: conditioning, the way to the first value, and `experiment.settle_s` on that value.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.residual import residual_dec
from rig.records.film_output import unit_of

COUNTED = "over the whole target, its first row to its last"
TRACK, PROFILE = "track", "profile"  # the phases that follow a target


class Rows(Protocol):
    """Rows of a run, by column."""

    @property
    def columns(self) -> Iterable[str]: ...
    def column(self, name: str) -> Any: ...


@dataclass(frozen=True)
class Tracked:
    """What a run follows: the columns of the readings and of the target, and the unit of an error."""

    measured: str = "resistance_ohm"
    wanted: str = "target_ohm"
    unit: str = "dec"

    @property
    def in_ohm(self) -> bool:
        """Whether it is a resistance, with errors in decades."""
        return self.unit == "dec"

    @property
    def name(self) -> str:
        """For people."""
        return self.measured.partition("_")[0]


def tracked(run: Rows) -> Tracked:
    """A resistance, or the other quantity that the run has a target of."""
    for name in run.columns:
        if name.startswith("target_") and name != "target_ohm":
            quantity = name.removeprefix("target_")
            return Tracked(quantity, name, unit_of(quantity))
    return Tracked()


@dataclass(frozen=True)
class Score:
    """How well a law tracked, over the whole target: errors in `unit`, decades of a resistance.

    max_at_s: when the largest error was, s of the target. p95: 95 % of the rows are within it. current_at_limit:
    share of the time that the current was at its limit. samples: rows counted; missing: rows without a reading.
    """

    law: str
    unit: str
    rms: float
    max: float
    max_at_s: float
    p95: float
    current_at_limit: float
    samples: int
    missing: int

    def table(self) -> dict[str, Any]:
        """As plain values, the unit in the names: rms_dec."""
        return {
            f"{key}_{self.unit}" if key in ("rms", "max", "p95") else key: value
            for key, value in self.__dict__.items()
            if key != "unit"
        }

    def in_words(self) -> str:
        """For a line on the terminal."""
        return (
            f"RMS error {shown_error(self.rms, self.unit, 4)}, largest {shown_error(self.max, self.unit, 3)}, "
            f"at {self.max_at_s:.1f} s ({COUNTED})"
        )


def shown_error(error: float, unit: str, digits: int) -> str:
    """An error for people; digits: after the point, of decades."""
    return f"{error:.{digits}f} dec" if unit == "dec" else f"{error:.3g} {unit}"


def rms(error: Array) -> float:
    """Root mean square of the finite ones; nan where there is none."""
    counted = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(counted**2))) if counted.size else math.nan


def largest(error: Array) -> float:
    """The largest of the finite ones, without its sign; nan where there is none."""
    counted = error[np.isfinite(error)]
    return float(np.max(np.abs(counted))) if counted.size else math.nan


def tracking_error(run: Rows) -> tuple[Array, Array]:
    """Time of the target (s) and error, as `tracked`, of the rows that followed what the meter reads; both empty where
    none did."""
    inside, what = run.column("phase") == TRACK, tracked(run)
    time, measured, wanted = (run.column(name)[inside] for name in ("time_s", what.measured, what.wanted))
    error = residual_dec(measured, wanted) if what.in_ohm else measured - wanted
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
        unit=tracked(run).unit,
        rms=rms(error),
        max=largest(error),
        max_at_s=float(time[good][int(np.argmax(size))]),
        p95=float(np.quantile(size, 0.95)),
        current_at_limit=float(np.mean(np.abs(current) >= 0.999 * limit_A)) if known else math.nan,
        samples=int(good.sum()),
        missing=int(good.size - good.sum()),
    )
