"""The result of the fit of a plate: the model, how sure it is, and what the records leave open, in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import Kind, PlateModel
from sim.inference.covariance import NORMAL_95
from sim.inference.noise import Noise

FAR_OFF: Final = 10.0  # times the noise: beyond it the discrepancy is larger than what any interval tells
LEAST_NOISE_K: Final = 1e-3  # a noise below is that of a record without any, or of a coarse last digit
TURNED: Final = 0.2  # of the error: a fit that is so much better with the current turned, or cut at 0, is the right one
HEATER: Final = 0.97  # of a Peltier plate's error: a heater's, with a parameter less, is no smaller by chance
MORE_THAN_NOISE: Final = 1.2  # times the noise: its estimate is good to some hundredths
SAME: Final = 0.02  # of the largest: currents that differ by less are one level
LONG: Final = 1.5  # thermal time constants that a stretch has to last to tell loss and ambient apart


@dataclass(frozen=True, eq=False)
class PlateFit:
    """The identified plate.

    model; names, values, standard_errors: of the parameters, shape (parameters,), an error inf where the records fix
    nothing; correlation: (parameters, parameters). first_degC: temperature at the start of each stretch between gaps.
    noise: of the thermometer, and of what the model lacks. rmse_K, max_abs_K: of the simulation over all readings that
    count; outliers: number of readings that do not count in full; identifiability: what the records cannot fix. lag_s:
    of the thermometer behind the plate, 0 where it was not asked for or does not make the records likelier. Of each
    record, in its rows: simulated_degC, what the thermometer shows without noise; course_degC, the plate's likeliest
    temperature, from the simulation and the readings. without_lag: the fit in which the thermometer does not lag, where
    this one does.
    """

    model: PlateModel
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    correlation: Array
    first_degC: tuple[float, ...]
    noise: Noise
    rmse_K: float
    max_abs_K: float
    outliers: int
    identifiability: tuple[str, ...]
    lag_s: float = 0.0
    simulated_degC: tuple[Array, ...] = ()
    course_degC: tuple[Array, ...] = ()
    without_lag: PlateFit | None = None

    @property
    def noise_K(self) -> float:
        """White noise of the thermometer."""
        return self.noise.white

    @property
    def far_off(self) -> bool:
        """Whether the model is off by far more than the thermometer's noise; one of `identifiability` says so."""
        return self.rmse_K > FAR_OFF * max(self.noise.white, LEAST_NOISE_K)


Refit = Callable[[Array, Kind], float]


def plate_notes(fit: PlateFit, current_A: Array, longest_s: float, refit: Refit) -> list[str]:
    """Return what the records leave open, the gravest first.

    current_A: of all rows, (rows,); longest_s: of the stretches between gaps. refit: the error (K, RMS) of the fit with
    another current, as another kind of plate.
    """
    notes = _wrong_current(fit, current_A, refit)
    if fit.far_off:
        times = fit.rmse_K / max(fit.noise.white, LEAST_NOISE_K)
        note = (
            f"The model is off by {fit.rmse_K:.2g} K (RMS), {times:.0f} times the thermometer's noise: something is "
            "missing, such as a heat sink that warms up or a thermometer that lags, or a column is misread. The "
            "parameters' errors are larger than their intervals."
        )
        if fit.model.kind == "peltier":
            less_K = refit(-current_A, "peltier")
            if less_K < TURNED * fit.rmse_K:
                note += f" With the current's sign reversed it is off by {less_K:.2g} K only: the sign may be turned."
        notes.append(note)
    return notes + _left_open(fit, current_A, longest_s)


def _wrong_current(fit: PlateFit, current_A: Array, refit: Refit) -> list[str]:
    """Return a line where a heater, or a plate that is never cooled, explains what a Peltier plate does not."""
    if fit.model.kind != "peltier" or fit.rmse_K <= MORE_THAN_NOISE * max(fit.noise.white, LEAST_NOISE_K):
        return []
    if not np.any(current_A < 0.0):
        heater_K = refit(current_A, "heater")
        if heater_K > HEATER * fit.rmse_K:
            return []
        return [
            f"The current never cools, and a heater's balance leaves {heater_K:.2g} K (RMS), a Peltier plate's "
            f"{fit.rmse_K:.2g} K: if this is a heater, say so with --plate heater."
        ]
    heated = np.maximum(current_A, 0.0)
    if not np.any(heated > 0.0):
        return []
    kinds: tuple[Kind, Kind] = ("peltier", "heater")
    less_K, kind = min((refit(heated, kind), kind) for kind in kinds)
    if less_K > TURNED * fit.rmse_K:
        return []
    advice = "take it as 0 and say --plate heater." if kind == "heater" else "take it as 0."
    return [
        f"With every current below 0 taken as 0 the model is off by {less_K:.2g} K (RMS) instead of {fit.rmse_K:.2g} "
        f"K: the current does not cool. Is the cooling side connected? If it cannot cool, {advice}"
    ]


def constant_drive(current_A: Array, kind: Kind) -> str:
    """Return what one level of the current, (rows,), cannot tell; empty where it has several levels."""
    largest = float(np.max(np.abs(current_A), initial=0.0))
    if largest > 0.0 and np.unique(np.round(current_A / (SAME * largest))).size > 1:
        return ""
    if kind == "peltier":
        return (
            "The current is constant: Seebeck term, Joule heat and loss cannot be separated. "
            "Record a profile with at least three levels of current, of both signs."
        )
    return (
        "The drive is constant: heating rate and loss to the ambient cannot be separated. "
        "Record steps of the drive, zero among them."
    )


def _left_open(fit: PlateFit, current_A: Array, longest_s: float) -> list[str]:
    """Return what the parameters' intervals and the current's course say."""
    notes, kind = [], fit.model.kind
    largest = float(np.max(np.abs(current_A)))
    g = fit.model.conductance_over_capacity_per_s
    if constant := constant_drive(current_A[:-1], kind):
        notes.append(constant)
    elif kind == "peltier" and (np.all(current_A >= -SAME * largest) or np.all(current_A <= SAME * largest)):
        notes.append(
            "The current has one sign only: Seebeck term and Joule heat are nearly the same. "
            "Record heating and cooling with currents of both signs and several sizes."
        )
    if g * longest_s < LONG:
        notes.append(
            f"No stretch is longer than 1.5 thermal time constants (the longest is {longest_s:.0f} s): loss and "
            "ambient are poorly separated. Let the plate rest at zero current for several time constants."
        )
    for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True):
        if name.endswith("slope_per_K"):  # known beforehand, whatever the record tells
            continue
        if not math.isfinite(error) or error > (100.0 if name == "ambient_degC" else 3.0 * abs(value)):
            notes.append(
                f"{name} is not determined by this record: {value:.3g}, as the model has it, is one of many values "
                "that explain it as well."
            )
        elif name == "ambient_degC" and error > 3.0:
            known = f"+- {NORMAL_95 * error:.1f} K (95 %)"
            notes.append(f"ambient_degC is known to {known} only; a rest at zero current would determine it.")
        elif name != "ambient_degC" and error > 0.3 * abs(value):
            share = 100.0 * NORMAL_95 * error / max(abs(value), 1e-300)
            notes.append(f"{name} is known to +- {share:.0f} % (95 %) only.")
    return notes
