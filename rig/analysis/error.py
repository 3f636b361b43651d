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


# RMS errors up to which a number is called good, and usable; by unit and what it is an error of.
OF_MODEL, OF_TARGET = "model", "target"
LIMITS = {
    ("dec", OF_MODEL): (0.01, 0.02),  # 2 and 5 % of the resistance: what calibrations leave of films that suit it
    ("K", OF_MODEL): (0.05, 0.5),  # a tenth of what is called behind, and that: beyond it feedback alone has to find R
    ("dec", OF_TARGET): (0.02, 0.05),  # 5 and 12 %: beyond it the eye sees the difference in a transition of decades
    ("K", OF_TARGET): (0.05, 0.5),
}
COUNTED = "over the whole target"
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
        """Return the score for a line on the terminal."""
        share = percent(self.rms) if self.unit == "dec" else ""
        found = f"RMS error {shown_error(self.rms, self.unit, 4)}"
        found += in_brackets(share, judgement(self.rms, self.unit, OF_TARGET))
        return f"{found}, largest {shown_error(self.max, self.unit, 3)} at {self.max_at_s:.1f} s"


def shown_error(error: float, unit: str, digits: int) -> str:
    """Return an error for people; digits: after the point, of decades."""
    return f"{error:.{digits}f} dec" if unit == "dec" else f"{error:.3g} {unit}"


def percent(error_dec: float) -> str:
    """Return an error in decades as a share of the resistance: 0.01 decades are 2.3 %."""
    return f"{100.0 * (10.0**error_dec - 1.0):.2g} %" if error_dec < 0.3 else f"a factor of {10.0**error_dec:.2g}"


def judgement(error: float, unit: str, of: str) -> str:
    """Return whether an RMS error is good, usable or bad, with the limit; "" for a unit without limits. of: `OF_MODEL`
    or `OF_TARGET`."""
    if not math.isfinite(error) or (unit, of) not in LIMITS:
        return ""
    good, usable = LIMITS[unit, of]
    if error <= usable:
        return f"good: at most {good:g} {unit}" if error <= good else f"usable: {good:g} to {usable:g} {unit}"
    return f"bad: more than {usable:g} {unit}"


def in_brackets(*texts: str) -> str:
    """Return the texts that are not empty in brackets, with a space before them; "" if all are empty."""
    told = [text for text in texts if text]
    return f" ({'; '.join(told)})" if told else ""


# What each parameter of a plate or an effect is, and its unit. A name that is not here is shown as it is written.
PARAMETERS = {
    "seebeck_over_capacity_per_A_s": ("Seebeck coefficient over heat capacity, S/C", "1/(A s)"),
    "resistance_over_capacity_K_per_A2_s": (
        "electrical resistance of the Peltier element over heat capacity, R_e/C",
        "K/(A\N{SUPERSCRIPT TWO} s)",
    ),
    "conductance_over_capacity_per_s": ("thermal conductance over heat capacity, G/C", "1/s"),
    "seebeck_slope_per_K": ("relative slope of S with temperature", "1/K"),
    "resistance_slope_per_K": ("relative slope of R_e with temperature", "1/K"),
    "drive_over_capacity_K_per_s": ("heating rate at full drive", "K/s"),
    "ambient_degC": ("room temperature", "\N{DEGREE SIGN}C"),
    "inputs.input_2": ("heat of the second heater over that of the first", ""),
    "deadband_A": ("dead band", "A"),
    "delay_s": ("delay", "s"),
    "leakage_ohm": ("leakage resistance", "ohm"),
    "loss_per_K3_s": ("radiated power over (heat capacity T\N{SUPERSCRIPT FOUR})", "1/(K\N{SUPERSCRIPT THREE} s)"),
    "series_ohm": ("series resistance", "ohm"),
    "sink_capacity_ratio": ("heat capacity of the sink over that of the plate", ""),
    "sink_conductance_ratio_per_s": ("conductance sink to room over heat capacity of the plate", "1/s"),
    "step_K": ("step", "K"),
    "tau_s": ("time constant", "s"),
    "theta_K_per_W": ("thermal resistance film to plate", "K/W"),
    "threshold_ohm": ("changes range at", "ohm"),
}
UNITS = {  # endings of other parameters' names
    "_K_per_h": "K/h",
    "_K_per_W": "K/W",
    "_per_K3_s": "1/(K\N{SUPERSCRIPT THREE} s)",
    "_per_A_s": "1/(A s)",
    "_K_per_A2_s": "K/(A\N{SUPERSCRIPT TWO} s)",
    "_K_per_s": "K/s",
    "_per_K": "1/K",
    "_per_s": "1/s",
    "_degC": "\N{DEGREE SIGN}C",
    "_ohm": "ohm",
    "_dec": "decades",
    "_K": "K",
    "_A": "A",
    "_s": "s",
}


def split_unit(name: str) -> tuple[str, str]:
    """Return (what, unit) of a parameter's name: ("time constant", "s") of tau_s, ("share", "") of share."""
    if name in PARAMETERS:
        return PARAMETERS[name]
    for ending, unit in UNITS.items():
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""


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
