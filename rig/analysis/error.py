"""Residuals and errors: one definition for every figure, column, JSON and sentence.

The residual is measured - model, in what was measured: kelvin of a temperature, decades of log10 R (whatever sign the
model's output has), the column's own unit of another quantity. Above 0 the reading is larger than the model's value.

The error of a run against its target is log10 of measured over wanted resistance, in decades; of another quantity that
the meter reads, and of a temperature, measured - wanted in its unit. The whole target is counted, from its first row to
its last, its steps and turning points among them. What comes before it is not: conditioning, the way to the first
value, and `experiment.settle_s` on that value.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from compensator.hysteresis.functions import Array
from rig.records.film_output import sign_of, unit_of

RESIDUAL = "measured - model"


def residual(measured: Array, model: Array, output: str = "") -> Array:
    """Return measured - model, shape (rows,), nan where either is none. output: the film output that both are of, as
    minus_log10_ohm; "" for readings as they are (a temperature)."""
    return np.asarray(sign_of(output) * (measured - model), dtype=np.float64)


def residual_dec(measured_ohm: Array, other_ohm: Array) -> Array:
    """Return log10 of measured over modelled (or wanted) resistance, shape (rows,); nan where either is none."""
    good = np.isfinite(measured_ohm) & (measured_ohm > 0.0) & np.isfinite(other_ohm) & (other_ohm > 0.0)
    found = np.full(measured_ohm.shape, np.nan)
    found[good] = np.log10(measured_ohm[good]) - np.log10(other_ohm[good])
    return found


def residual_label(unit: str) -> str:
    """Return the label of an axis that shows it: "measured - model / K"."""
    return f"{RESIDUAL} / {unit}"


def value_and_half(value: float, half: float) -> tuple[str, str]:
    """Return a value and half of its interval, both to the second significant digit of the half."""
    digits = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 and math.isfinite(half) else 6
    return f"{value:.{digits}f}", f"{half:.{digits}f}"


COUNTED = "over the whole target, its first row to its last"
TRACK, PROFILE = "track", "profile"  # the phases that follow a target


class Rows(Protocol):
    """Columns of a run."""

    @property
    def columns(self) -> Iterable[str]: ...
    def column(self, name: str) -> Any: ...


@dataclass(frozen=True)
class Tracked:
    """Quantity that a run follows: the columns of its readings and of its target, and the unit of an error."""

    measured: str = "resistance_ohm"
    wanted: str = "target_ohm"
    unit: str = "dec"

    @property
    def in_ohm(self) -> bool:
        """True if it is a resistance, with errors in decades."""
        return self.unit == "dec"

    @property
    def name(self) -> str:
        return self.measured.partition("_")[0]


def tracked(run: Rows) -> Tracked:
    """Return a resistance, or the other quantity of which the run has a target."""
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
        """Return plain values, with the unit in the names: rms_dec."""
        return {
            f"{key}_{self.unit}" if key in ("rms", "max", "p95") else key: value
            for key, value in self.__dict__.items()
            if key != "unit"
        }

    def in_words(self) -> str:
        return (
            f"RMS error {shown_error(self.rms, self.unit, 4)}, largest {shown_error(self.max, self.unit, 3)}, "
            f"at {self.max_at_s:.1f} s ({COUNTED})"
        )


def shown_error(error: float, unit: str, digits: int) -> str:
    """Return an error for people; digits: after the point, of decades."""
    if unit == "K":
        return f"{error * 1e3:.0f} mK" if error < 1.0 else f"{error:.2f} K"
    return f"{error:.{digits}f} dec" if unit == "dec" else f"{error:.3g} {unit}"


def rms(error: Array) -> float:
    """Return the root mean square of the finite errors; nan if there is none."""
    counted = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(counted**2))) if counted.size else math.nan


def largest(error: Array) -> float:
    """Return the largest of the finite errors, without its sign; nan if there is none."""
    counted = error[np.isfinite(error)]
    return float(np.max(np.abs(counted))) if counted.size else math.nan


def tracking_error(run: Rows) -> tuple[Array, Array]:
    """Return time of the target (s) and error of the rows that followed what the meter reads; empty if none did."""
    inside, what = run.column("phase") == TRACK, tracked(run)
    time, measured, wanted = (run.column(name)[inside] for name in ("time_s", what.measured, what.wanted))
    error = residual_dec(measured, wanted) if what.in_ohm else measured - wanted
    return time - time[:1].sum(), error


@dataclass(frozen=True, eq=False)
class TargetError:
    """Error of a run against its target: of what the meter reads, or of a temperature. unit: of the error; time_s: of
    the target; error: measured - wanted; both of shape (rows,)."""

    unit: str
    time_s: Array
    error: Array

    @property
    def rms(self) -> float:
        return rms(self.error)

    @property
    def largest(self) -> float:
        return largest(self.error)

    @property
    def shown_rms(self) -> str:
        return shown_error(self.rms, self.unit, 4)

    @property
    def shown_largest(self) -> str:
        return shown_error(self.largest, self.unit, 3)

    def document(self) -> dict[str, float]:
        """Return RMS and largest error, with the unit in the names: rms_dec."""
        return {f"rms_{self.unit}": self.rms, f"max_{self.unit}": self.largest}


def target_error(run: Rows) -> TargetError | None:
    """Return the error over the whole target; None if no row of the run followed a target with a reading."""
    time, error = tracking_error(run)
    if np.any(np.isfinite(error)):
        return TargetError(tracked(run).unit, time, error)
    inside = run.column("phase") == PROFILE
    time, degC, wanted = (run.column(name)[inside] for name in ("time_s", "temperature_degC", "setpoint_degC"))
    return TargetError("K", time - time[:1].sum(), degC - wanted) if np.any(np.isfinite(degC - wanted)) else None


def score(run: Rows, law: str, limit_A: float) -> Score | None:
    """Return the score of a run; None if no row of the target has a reading."""
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
