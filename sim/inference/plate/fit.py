"""The plate of records of temperature and current: the joint fit without a film, and with no effect but a lag.

    peltier:  dT/dt = s I (T + 273.15) + 1/2 r I^2 - g (T - T_a)        s = S/C, r = R_e/C, g = G/C
              s = s_25 (1 + a (T - 25)), r = r_25 (1 + b (T - 25))      a, b: slopes
    heater:   dT/dt = q u - g (T - T_a)                                 drive u in 0..1

Likelihood, noise, starts and priors are those of every fit (`sim.inference.joint`). The standard errors leave the prior
of the room out, so that a number that the records do not determine has none. The room is that of the first record;
further ones have rooms of their own, near it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import Kind, PlateModel
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.covariance import NORMAL_95
from sim.inference.evidence import price
from sim.inference.joint.likelihood import PLATE_NAMES, Fit, Joint
from sim.inference.joint.starts import module_fit
from sim.inference.noise import Noise, discrepancy, rough_noise
from sim.inference.readings.checked_columns import checked_columns
from sim.inference.readings.odd_readings import Column, of_records
from sim.inference.record.joined import joined
from sim.inference.record.record import read_columns
from sim.model.gaps import rows_after_gaps

FEWEST: Final = 12  # readings below which nothing is fitted
TOGETHER: Final = (
    3  # readings between two gaps: of fewer the current is hardly known, as of a row before a controller ran
)
LAG_STARTS_S: Final = (0.3, 1.0, 3.0, 10.0, 30.0)  # the range of real thermometers, by factors of three
LAG_STEPS: Final = 6  # of a descent from each of them
ROUNDS: Final = 1  # of fit and noise: in further ones the discrepancy grows at the cost of a simulation that is off
FINER: Final = 1e-4  # log-likelihood that the last step gains: values are then within 0.02 of their deviations
FAR_OFF: Final = 10.0  # times the noise: beyond it the discrepancy is larger than what any interval tells
LEAST_NOISE_K: Final = 1e-3  # a noise below is that of a record without any, or of a coarse last digit
TURNED: Final = 0.2  # of the error: a fit that is so much better with the current turned, or cut at 0, is the right one
HEATER: Final = 0.97  # of a Peltier plate's error: a heater's, with a parameter less, is no smaller by chance
MORE_THAN_NOISE: Final = 1.2  # times the noise: its estimate is good to some hundredths
SAME: Final = 0.02  # of the largest: currents that differ by less are one level
LONG: Final = 1.5  # thermal time constants that a stretch has to last to tell loss and ambient apart


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


def identify_plate(
    time_s: ArrayLike,
    temperature_degC: ArrayLike,
    current_A: ArrayLike,
    *,
    kind: Kind = "peltier",
    lag: bool = False,
    slopes: bool = True,
) -> PlateFit:
    """Fit the plate of one record; arrays of shape (samples,) in s, degC, A (heater: drive 0..1).

    lag, slopes: as of `identify_plate_records`. Raises ValueError with one line for a record that cannot be used.
    """
    return identify_plate_records([PlateRecord(time_s, temperature_degC, current_A)], kind=kind, lag=lag, slopes=slopes)


def identify_plate_records(
    records: Sequence[PlateRecord], *, kind: Kind = "peltier", lag: bool = False, slopes: bool = True
) -> PlateFit:
    """Fit one plate to several records; a stretch of rows between gaps has a first temperature of its own.

    lag: whether the thermometer may lag behind the plate. slopes: whether a Peltier plate's Seebeck coefficient and
    resistance may change with temperature. Raises ValueError with one line for records that cannot be used.
    """
    if kind not in ("peltier", "heater"):
        raise ValueError(f"kind: {kind!r}: expected 'peltier' or 'heater'")
    if not records:
        raise ValueError("records: none given, expected at least one")
    checked = [_checked(record) for record in records]
    columns, begins = joined(checked)
    record, odd = read_columns(columns, held_out=False, fewest=FEWEST, joined=begins), _odd(records)
    current_A = record.current_A
    assert current_A is not None

    def fitted(current: Array, of: Kind) -> Fit:
        return module_fit(Joint(replace(record, current_A=current), (), None, of, slopes=slopes), ROUNDS, FINER)

    def noted(fit: Fit) -> PlateFit:
        found = _result(fit, len(record.left_out))
        longest_s = max(float(np.ptp(part)) for part in np.split(record.time_s, record.first_rows[1:]))
        return replace(
            found,
            identifiability=(
                *odd,
                *plate_notes(found, current_A, longest_s, lambda *other: _result(fitted(*other)).rmse_K),
            ),
        )

    # a trial plate may run away; its residual is then refused
    with np.errstate(over="ignore", invalid="ignore"):
        plain = fitted(current_A, kind)
        lagging = _with_lag(plain) if lag else plain
        fit = noted(plain)
        return fit if lagging is plain else replace(noted(lagging), without_lag=fit)


def _checked(record: PlateRecord) -> dict[str, Array]:
    """Return the columns of a record that can be used."""
    name, asked = record.name, ("time_s", "temperature_degC", "current_A")
    columns = checked_columns({column: getattr(record, column) for column in asked}, name)
    time, temperature, current = columns.values()
    for part in np.split(np.arange(time.size), rows_after_gaps(time)):
        if np.sum(np.isfinite(temperature[part])) < TOGETHER:
            temperature = np.where(np.isin(np.arange(time.size), part), np.nan, temperature)
    finite = temperature[np.isfinite(temperature)]
    if finite.size < FEWEST:
        raise ValueError(f"{name}: temperature_degC: {finite.size} finite readings, expected at least {FEWEST}")
    if not np.any(np.isfinite(current)):
        raise ValueError(f"{name}: current_A: no finite number in {current.size} rows, expected A")
    if np.all(current[np.isfinite(current)] == 0.0):
        raise ValueError(f"{name}: current_A: 0 throughout, expected a current that moves the plate")
    if np.ptp(finite) < max(1e-3, 3.0 * rough_noise(finite)):
        at = f"constant at {np.median(finite):.6g}"
        raise ValueError(f"{name}: temperature_degC: {at}, expected one that follows the current")
    return columns | {"temperature_degC": temperature}


def _odd(records: Sequence[PlateRecord]) -> tuple[str, ...]:
    """Return lines on temperatures that cannot be what was measured."""
    columns = []
    for record in records:
        time, degC = (np.asarray(values, dtype=np.float64) for values in (record.time_s, record.temperature_degC))
        columns.append((record.name, [Column("temperature_degC", time, degC, "degC")]))
    return of_records(columns)


def _with_lag(plain: Fit) -> Fit:
    """Return the best fit with a lagging thermometer, where it is worth its price; else the one without."""
    joint = plain.joint.having((SENSOR_LAG,))
    start, tried = joint.from_other(plain.joint, plain.at.x), []
    for metric in (plain.metric, plain.metric.without_slow()):  # a discrepancy may stand in for a lag
        for lag_s in LAG_STARTS_S:
            at = joint.solve(joint.with_effect(start, SENSOR_LAG, [lag_s]), metric)
            tried.append(joint.descend(at, metric, LAG_STEPS, 1.0))
    best = plain
    for at in {round(_lag_s(joint, at.x), 2): at for at in sorted(tried, key=lambda p: p.cost)[:4]}.values():
        metric = joint.noise(at, plain.metric, plain.most)
        lagging = joint.fit(at.x, metric, None, ROUNDS, plain.most, settled=FINER)
        best = max(best, lagging, key=lambda fit: fit.log_likelihood)
    worth = best.log_likelihood - plain.log_likelihood > price(1, joint.rows_K.size)
    return best if worth else plain


def _lag_s(joint: Joint, x: Array) -> float:
    """Return the lag of a fit's parameters, 0 of a fit without one."""
    return math.exp(x[joint.place["sensor_lag.tau_s"]]) if joint.effects else 0.0


def _result(fit: Fit, left_out: int = 0) -> PlateFit:
    """Return what users see of a fit. left_out: readings that do not count at all."""
    joint, at, channel = fit.joint, fit.at, fit.metric.temperature
    asked = [joint.place[name] for name in PLATE_NAMES if name in joint.place]
    covariance = fit.covariance(without=("ambient_degC",))
    s, r, g, q, ambient, of_s, of_r = (float(value) for value in joint.plate_numbers(at.x))
    error = channel.noise.of_a_model if not channel.of_instrument else (0.0, 0.0)
    model = PlateModel(s, r, g, ambient, q, joint.kind, *error, (), of_s, of_r)
    full = channel.readings.variance < 2.0
    time, begins = joint.record.time_s, joint.record.joined
    # a rounded reading is off by what it was rounded by, besides
    noise = replace(channel.noise, white=math.hypot(channel.noise.white, channel.step / math.sqrt(12.0)))
    course = at.run.path.at(time)
    if not channel.of_instrument:
        beyond, _ = discrepancy(at.residual_K, channel.noise, channel.readings)
        course = course + np.interp(time, channel.readings.time_s, beyond)
    return PlateFit(
        model,
        tuple(PLATE_NAMES[joint.names[k]] for k in asked),
        at.x[asked],
        covariance.standard_errors[asked],
        covariance.correlation[np.ix_(asked, asked)],
        tuple(float(x) for x, name in zip(at.x, joint.names, strict=True) if name.startswith("first_degC.")),
        noise,
        math.sqrt(float(np.mean(at.residual_K[full] ** 2))),
        float(np.max(np.abs(at.residual_K[full]))),
        left_out + int(np.sum(~full)),
        (),
        _lag_s(joint, at.x),
        tuple(np.split(at.run.shown_degC, begins)),
        tuple(np.split(course, begins)),
    )


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
            "missing, such as a heat sink that warms up or a thermometer that lags, or a column is misread. The errors "
            "of all plate parameters are larger than their 95 % intervals."
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
