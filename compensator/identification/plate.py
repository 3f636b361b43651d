"""Identification of a plate's heat balance from temperature and current, by its simulation error.

    peltier:  dT/dt = s I (T + 273.15) + 1/2 r I^2 - g T + h           s = S/C, r = R_e/C, g = G/C, h = g T_a
    heater:   dT/dt = q u - g T + h                                    drive u in 0..1

The current of a row is held until the next, so that each step is exact (`compensator.thermal.plate`), and so are its
derivatives. The simulation runs over each stretch between gaps from a first temperature of its own, which enters
linearly and is projected out. Starts come from the balance integrated over windows (a linear regression, biased by
noise); the fit itself minimizes the simulation error, not the one-step prediction error, which a lag or noise would
mislead: L. Ljung, System Identification (Prentice Hall 1999), sec. 7.3, 10.2. Robust weights: P. J. Huber, Robust
Statistics (Wiley 1981), ch. 7.

Where a record leaves a combination open, what every plate has in common decides: an ambient of 25 +- 15 degC, and a
current up to about 40 % +- 30 % of the one of largest cooling, s (T + 273.15) / r. That weighs as much as one reading
independent of all others, nothing on a record that fixes its plate; the standard errors leave it out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from compensator.identification.checked_columns import checked_columns
from compensator.identification.constant_drive import constant_drive
from compensator.identification.covariance import NORMAL_95, block_sandwich, correlation_rows
from compensator.identification.gaps import gap_threshold
from compensator.identification.heat_balance import (
    LAG_PLACE,
    PLACES,
    Kind,
    SimulationError,
    Stretch,
    Trial,
    rough_balances,
)
from compensator.identification.odd_readings import Column, of_records
from compensator.identification.rows import FEWEST, check_moves
from compensator.identification.temperature_smoother import temperature_path
from compensator.thermal.plate import PlateModel

NAMES: Final = {
    "peltier": (
        "seebeck_over_capacity_per_A_s",
        "resistance_over_capacity_K_per_A2_s",
        "conductance_over_capacity_per_s",
        "ambient_degC",
    ),
    "heater": ("drive_over_capacity_K_per_s", "conductance_over_capacity_per_s", "ambient_degC"),
}
HUBER: Final = 4.0  # in robust standard deviations
UNUSUAL: Final = 6.0  # squared spreads from a usual plate
LAG_STARTS_S: Final = (0.3, 1.0, 3.0, 10.0, 30.0)
SHORTEST_LAG_S: Final = 0.05  # less is within a row of any record
LAG_EVIDENCE: Final = 10.0  # of log-likelihood, over the residual's own correlation; chance gives 2
FAR_OFF: Final = 10.0  # times the noise: beyond it intervals, which know the noise alone, say next to nothing
LEAST_NOISE_K: Final = 1e-3  # a noise told smaller is that of a record without any, or of a coarse last digit
TURNED: Final = 0.2  # of the error: a fit that is so much better with the current turned, or cut at 0, is the right one
HEATER: Final = 0.97  # of a Peltier plate's error: a heater's, with a parameter less, is no smaller by chance
MORE_THAN_NOISE: Final = 1.2  # times the noise: its estimate from neighbouring rows is good to some tenths


@dataclass(frozen=True, eq=False)
class PlateRecord:
    """`time_s` increasing, `temperature_degC` (nan: no reading), `current_A` (held until the next row; nan: unknown),
    each of shape (samples,)."""

    time_s: ArrayLike
    temperature_degC: ArrayLike
    current_A: ArrayLike
    name: str = "record"


@dataclass(frozen=True, eq=False)
class PlateFit:
    """The identified plate.

    model; names: of the parameters; values, standard_errors: shape (parameters,), inf where the record fixes nothing;
    correlation: shape (parameters, parameters); first_degC: temperature at the start of each stretch, with `stretches`
    its (record, first row, last row + 1); noise_K: of the thermometer; rmse_K, max_abs_K: of the simulation over all
    trusted readings; outliers: number of readings left out; identifiability: what the records cannot fix; lag_s: of the
    thermometer behind the plate, where `lag` is True.
    """

    model: PlateModel
    names: tuple[str, ...]
    values: Array
    standard_errors: Array
    correlation: Array
    first_degC: tuple[float, ...]
    stretches: tuple[tuple[int, int, int], ...]
    noise_K: float
    rmse_K: float
    max_abs_K: float
    outliers: int
    identifiability: tuple[str, ...]
    lag_s: float = 0.0

    @property
    def far_off(self) -> bool:
        """Whether the model is off by far more than the thermometer's noise; one of `identifiability` says so."""
        return self.rmse_K > FAR_OFF * max(self.noise_K, LEAST_NOISE_K)


def identify_plate(
    time_s: ArrayLike, temperature_degC: ArrayLike, current_A: ArrayLike, *, kind: Kind = "peltier", lag: bool = False
) -> PlateFit:
    """The plate of one record; arrays of shape (samples,) in s, degC, A (heater: drive 0..1).

    lag: whether the thermometer may lag behind the plate. Raises ValueError with one line for a record that cannot be
    used.
    """
    return identify_plate_records([PlateRecord(time_s, temperature_degC, current_A)], kind=kind, lag=lag)


def identify_plate_records(records: Sequence[PlateRecord], *, kind: Kind = "peltier", lag: bool = False) -> PlateFit:
    """One plate for several records; a stretch of rows between gaps has a first temperature of its own.

    lag: whether the thermometer may lag; then `lag_s` is the lag, 0 where it does not make the record likelier.
    """
    if kind not in NAMES:
        raise ValueError(f"kind: {kind!r}: expected 'peltier' or 'heater'")
    if not records:
        raise ValueError("records: none given, expected at least one")
    # of trial plates that run away, and of currents that no plate has: they bring no gain and are refused
    with np.errstate(over="ignore", invalid="ignore"):
        fit = _fitted(records, kind, lag)
        first = (*_odd(records), *_other_kind(records, fit, lag))
        if not fit.far_off:
            return replace(fit, identifiability=(*first, *fit.identifiability))
        times = fit.rmse_K / max(fit.noise_K, LEAST_NOISE_K)
        note = (
            f"The model is off by {fit.rmse_K:.2g} K (RMS), {times:.0f} times the thermometer's noise: something is "
            "missing, such as a heat sink that warms up or a thermometer that lags, or a column is not what it is "
            "taken for. The numbers are off by more than their intervals say."
        )
        if kind == "peltier":
            turned = [replace(record, current_A=-np.asarray(record.current_A, dtype=np.float64)) for record in records]
            less_K = _fitted(turned, kind, lag).rmse_K
            if less_K < TURNED * fit.rmse_K:
                note += f" With the current's sign reversed it is off by {less_K:.2g} K only: the sign may be turned."
    return replace(fit, identifiability=(*first, note, *fit.identifiability))


def _other_kind(records: Sequence[PlateRecord], fit: PlateFit, lag: bool) -> list[str]:
    """A line where a Peltier plate's balance leaves more than a heater's does, or than one that is never cooled."""
    if fit.model.kind != "peltier" or fit.rmse_K <= MORE_THAN_NOISE * max(fit.noise_K, LEAST_NOISE_K):
        return []
    currents = [np.asarray(record.current_A, dtype=np.float64) for record in records]
    if not any(bool(np.any(current < 0.0)) for current in currents):
        heater_K = _fitted(records, "heater", lag).rmse_K
        if heater_K > HEATER * fit.rmse_K:
            return []
        return [
            f"The current never cools, and a heater's balance leaves {heater_K:.2g} K (RMS), a Peltier plate's "
            f"{fit.rmse_K:.2g} K: if this is a heater, say so with --plate heater."
        ]
    heated = [replace(record, current_A=np.maximum(u, 0.0)) for record, u in zip(records, currents, strict=True)]
    if not any(bool(np.any(np.asarray(record.current_A) > 0.0)) for record in heated):
        return []
    less_K, kind = min((_fitted(heated, kind, lag).rmse_K, kind) for kind in NAMES)  # type: ignore[arg-type]
    if less_K > TURNED * fit.rmse_K:
        return []
    advice = "take it as 0 and say --plate heater." if kind == "heater" else "take it as 0."
    return [
        f"With every current below 0 taken as 0 the model is off by {less_K:.2g} K (RMS) instead of {fit.rmse_K:.2g} "
        f"K: the current does not cool. Is the cooling side connected? If it cannot cool, {advice}"
    ]


def _odd(records: Sequence[PlateRecord]) -> tuple[str, ...]:
    """Lines on temperatures that cannot be what was measured."""
    told = []
    for record in records:
        time, degC = (np.asarray(values, dtype=np.float64) for values in (record.time_s, record.temperature_degC))
        told.append((record.name, [Column("temperature_degC", time, degC, "degC")]))
    return of_records(told)


def _fitted(records: Sequence[PlateRecord], kind: Kind, lag: bool) -> PlateFit:
    """The plate of the records as they are."""
    stretches: list[Stretch] = []
    outliers, noises = 0, []
    for number, record in enumerate(records):
        found, out, noise = _stretches(record, number)
        stretches += found
        outliers += out
        noises.append(noise)
    if not stretches:
        raise ValueError("records: no stretch of readings between gaps is long enough, expected at least 3 rows")
    fit = SimulationError(stretches, PLACES[kind])
    near = [fit.descend(fit.evaluate(start), 6) for start in rough_balances(stretches, kind)]
    best = fit.descend(min(near, key=lambda trial: trial.cost), 60)
    if not best.residual.size:
        raise ValueError("records: no reading that can be trusted, expected at least 3 rows of them")
    if lag:
        best = _with_lag(fit, best)
    for _ in range(2):
        start = best.par
        limit = HUBER * max(1.4826 * float(np.median(np.abs(best.residual))), 1e-9)
        one_reading = float(np.mean(best.weights * best.residual**2)) * correlation_rows(best.residual)
        fit = SimulationError(stretches, PLACES[kind], limit, one_reading)
        best = fit.evaluate(start)
        if float(np.sum(fit.usual(start)[0] ** 2)) > UNUSUAL:  # the record leaves something open: look around again
            rough = [np.append(par[:LAG_PLACE], start[LAG_PLACE]) for par in rough_balances(stretches, kind)]
            near = [fit.descend(fit.evaluate(par), 12) for par in (start, *rough)]
            best = min(near, key=lambda trial: trial.cost)
        best = fit.descend(best, 60)
    return _result(fit, best, kind, float(np.median(noises)), outliers)


def _with_lag(fit: SimulationError, plain: Trial) -> Trial:
    """The best fit with a lagging thermometer, where that explains more than chance does; else the one without."""
    lagging = SimulationError(fit.stretches, (*fit.places, LAG_PLACE), fit.limit, fit.one_reading)
    best = plain
    for lag in LAG_STARTS_S:
        trial = lagging.descend(lagging.evaluate(np.append(plain.par[:LAG_PLACE], lag)), 40)
        best = min(best, trial, key=lambda t: t.cost)
    if best.par[LAG_PLACE] < SHORTEST_LAG_S:
        return plain
    rows = correlation_rows(best.residual)
    likelier = 0.5 * best.residual.size / rows * math.log(max(plain.cost, 1e-300) / max(best.cost, 1e-300))
    return fit.evaluate(best.par) if likelier > LAG_EVIDENCE else plain


def _stretches(record: PlateRecord, number: int) -> tuple[list[Stretch], int, float]:
    """The record in stretches between gaps, its number of outliers, and its noise (K)."""
    name = record.name
    columns = ("time_s", "temperature_degC", "current_A")
    time, temperature, current = checked_columns({c: getattr(record, c) for c in columns}, name).values()
    known = np.isfinite(temperature)
    if np.sum(known) < FEWEST:
        raise ValueError(f"{name}: temperature_degC: {int(np.sum(known))} finite readings, expected at least {FEWEST}")
    if not np.any(np.isfinite(current)):
        raise ValueError(f"{name}: current_A: no finite number in {time.size} rows, expected A")
    if np.all(current[np.isfinite(current)] == 0.0):
        raise ValueError(f"{name}: current_A: 0 throughout, expected a current that moves the plate")
    path = temperature_path(time, temperature)
    check_moves(name, path, "one that follows the current")
    known[path.outliers] = False
    steps = np.diff(time)
    broken = (steps > gap_threshold(steps)) | ~np.isfinite(current[:-1])
    edges = np.concatenate(([0], np.flatnonzero(broken) + 1, [time.size]))
    found = []
    for first, last in pairwise(edges):
        if np.sum(known[first:last]) >= 3:
            part = slice(first, last)
            used = known[part]
            found.append(
                Stretch(
                    number,
                    int(first),
                    steps[first : last - 1],
                    np.nan_to_num(current[part]),
                    np.where(used, temperature[part], 0.0),
                    used,
                )
            )
    return found, path.outliers.size, path.noise_K


def _result(fit: SimulationError, best: Trial, kind: Kind, noise_K: float, outliers: int) -> PlateFit:
    s, r, g, q, h, lag = (float(value) for value in best.par)
    lost = g < 1e-7
    ambient = h / g if not lost else 25.0
    s, r = (s, r) if kind == "peltier" else (0.0, 0.0)
    model = PlateModel(s, r, g if not lost else 0.0, ambient, q, kind, _error_K(best.residual, noise_K))
    root = np.sqrt(best.weights)
    covariance = block_sandwich(root[:, None] * best.jacobian, root * best.residual)
    change = np.eye(len(fit.places))  # from (.., g, h) to (.., g, T_a)
    change[-1, -1] = 1.0 / max(g, 1e-12)
    change[-1, -2] = -ambient / max(g, 1e-12)
    covariance = covariance.transformed(change)
    errors = covariance.standard_errors
    values = best.par[fit.places].copy()
    values[-1] = ambient
    return PlateFit(
        model,
        NAMES[kind],
        values,
        errors,
        covariance.correlation,
        tuple(float(first) for first in best.firsts),
        tuple((part.record, part.first, part.first + part.used.size) for part in fit.stretches),
        noise_K,
        math.sqrt(float(np.mean(best.residual**2))),
        float(np.max(np.abs(best.residual))),
        outliers + int(np.sum(best.weights < 0.5)),
        plate_notes(fit.stretches, NAMES[kind], values, errors, kind),
        lag,
    )


def _error_K(residual_K: Array, noise_K: float) -> float:
    """By how much the model is off in a row beyond the noise, as if in each row by itself: what hangs together over tau
    rows says as much as one of them. 0 where it is off by no more than the noise's own estimate may be."""
    square = float(np.mean(residual_K**2))
    if square <= (MORE_THAN_NOISE * noise_K) ** 2:
        return 0.0
    return math.sqrt((square - noise_K**2) * correlation_rows(residual_K))


def plate_notes(
    stretches: Sequence[Stretch], names: tuple[str, ...], values: Array, errors: Array, kind: Kind
) -> tuple[str, ...]:
    """What the records leave open, in plain words, and which profile would fix it."""
    notes = []
    current = np.concatenate([stretch.current[:-1] for stretch in stretches])
    largest = float(np.max(np.abs(current)))
    length = max(float(np.sum(stretch.steps)) for stretch in stretches)
    g = values[names.index("conductance_over_capacity_per_s")]
    if constant := constant_drive(current, kind):
        notes.append(constant)
    elif kind == "peltier" and (np.all(current >= -0.02 * largest) or np.all(current <= 0.02 * largest)):
        notes.append(
            "The current has one sign only: Seebeck term and Joule heat are nearly the same. "
            "Record heating and cooling with currents of both signs and several sizes."
        )
    if g * length < 1.5:
        notes.append(
            f"No stretch is longer than 1.5 thermal time constants (the longest is {length:.0f} s): loss and ambient "
            "are poorly separated. Let the plate rest at zero current for several time constants."
        )
    for name, value, error in zip(names, values, errors, strict=True):
        if not math.isfinite(error) or error > (100.0 if name == "ambient_degC" else 3.0 * abs(value)):
            notes.append(
                f"{name} is not determined by this record: {value:.3g}, as the model has it, is one of many values "
                "that explain it as well."
            )
        elif name == "ambient_degC" and error > 3.0:
            known = f"+- {NORMAL_95 * error:.1f} K (95 %)"
            notes.append(f"ambient_degC is known to {known} only; a rest at zero current would fix it.")
        elif name != "ambient_degC" and error > 0.3 * abs(value):
            share = 100.0 * NORMAL_95 * error / max(abs(value), 1e-300)
            notes.append(f"{name} is known to +- {share:.0f} % (95 %) only.")
    return tuple(notes)
