"""Fit of a plate's heat balance, and of its thermometer's lag, to records of temperature and current.

    peltier:  dT/dt = s I (T + 273.15) + 1/2 r I^2 - g (T - T_a)        s = S/C, r = R_e/C, g = G/C
              s = s_25 (1 + a (T - 25)), r = r_25 (1 + b (T - 25))      a, b: slopes
    heater:   dT/dt = q u - g (T - T_a)                                 drive u in 0..1

The chain (`sim.model.plate_path`) is simulated from the recorded current over each stretch between gaps, from a first
temperature of its own, never one step ahead. The fit has two steps: the least error of the simulation, whose residual
gives the noise (`sim.inference.noise`: white noise and a slow discrepancy), then the highest likelihood with it.
Further steps in turn move no parameter by its deviation where the model holds; where it does not, the discrepancy
grows at the simulation's cost. Starts come from the balance integrated over windows (L. Ljung, System Identification
(Prentice Hall 1999), sec. 7.3, 10.2).

Where records leave a combination open, what plates have in common decides, as normal priors: `AMBIENT_DEGC`, `SHARE`,
and of the slopes what is known of the material (`compensator.thermal.plate`). Standard errors leave the first two out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import (
    AMBIENT,
    LARGEST_SLOPE_PER_K,
    RESISTANCE_SLOPE_PRIOR_PER_K,
    SEEBECK_SLOPE_PRIOR_PER_K,
    Kind,
    PlateModel,
)
from sim.effects.effect import switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.covariance import block_sandwich
from sim.inference.evidence import price
from sim.inference.film.rows import FEWEST
from sim.inference.levenberg_marquardt import least_squares
from sim.inference.noise import Noise, Readings, Whitening, discrepancy, estimate, variances
from sim.inference.plate.result import PlateFit, plate_notes
from sim.inference.plate.starts import Stretch, rough_balances
from sim.inference.readings.checked_columns import checked_columns
from sim.inference.readings.odd_readings import Column, of_records
from sim.inference.readings.outliers import lone_outliers
from sim.model.gaps import gap_threshold
from sim.model.inputs import NOTHING, Inputs
from sim.model.links import Links, links_of
from sim.model.plate_path import Nodes, plate_nodes, simulate_plate
from sim.model.recorded import Rows

NAMES: Final = {
    "peltier": (
        "seebeck_over_capacity_per_A_s",
        "resistance_over_capacity_K_per_A2_s",
        "conductance_over_capacity_per_s",
        "ambient_degC",
        "seebeck_slope_per_K",
        "resistance_slope_per_K",
    ),
    "heater": ("drive_over_capacity_K_per_s", "conductance_over_capacity_per_s", "ambient_degC"),
}
PLACES: Final = {"peltier": (0, 1, 2, 4, 5, 6), "heater": (3, 2, 4)}  # of (s, r, g, q, T_a, a, b)
NUMBERS: Final = 7  # of these
SLOPES: Final = (5, 6)  # places of a and b
SMALLEST: Final = 1e-9  # of s (1/(A s)), q (K/s) and g (1/s): a millionth of any plate's
AMBIENT_DEGC: Final = (25.0, 15.0)  # mean and deviation: a room, a cold room, an oven's surroundings
SHARE: Final = (0.4, 0.3)  # of the largest current in that of largest cooling, s (T + 273.15) / r, at 300 K
LAG_STARTS_S: Final = (0.3, 1.0, 3.0, 10.0, 30.0)
SHORTEST_LAG_S: Final = 0.05  # less is within a row of any record
LEAST_NOISE_K: Final = 1e-5  # a simulation without noise, to the rounding of its solver
__all__ = ["PlateFit", "PlateRecord", "identify_plate", "identify_plate_records"]


@dataclass(frozen=True, eq=False)
class PlateRecord:
    """`time_s` increasing, `temperature_degC` (nan: no reading), `current_A` (held until the next row; nan: unknown),
    each of shape (samples,)."""

    time_s: ArrayLike
    temperature_degC: ArrayLike
    current_A: ArrayLike
    name: str = "record"


@dataclass(frozen=True, eq=False)
class PlateRows:
    """The rows of all records in sequence, as the chain takes a record (`sim.model.recorded.Recorded`).

    temperature_degC, used: (rows,); first_rows: of each stretch; begins: True where a record begins, (rows,);
    stretches: as of `PlateFit`; outliers: readings left out beforehand; lengths: rows of each record.
    """

    time_s: Array
    temperature_degC: Array
    current_A: Array
    used: NDArray[np.bool_]
    first_rows: Rows
    begins: NDArray[np.bool_]
    stretches: tuple[tuple[int, int, int], ...]
    outliers: int
    lengths: tuple[int, ...]
    inputs: Inputs = NOTHING
    test_current_A: Array | None = None

    @property
    def commands(self) -> tuple[Array, Array]:
        """When a current was commanded, and which."""
        return self.time_s, self.current_A

    @property
    def taken_s(self) -> Array:
        """There is no resistance."""
        return self.time_s

    @property
    def test_on_s(self) -> Array:
        """There is no resistance."""
        return self.time_s

    @cached_property
    def stretch(self) -> NDArray[np.int64]:
        """The stretch of each row, (rows,)."""
        return np.searchsorted(self.first_rows, np.arange(self.time_s.size), side="right") - 1

    @property
    def parts(self) -> list[Stretch]:
        """The stretches, each by itself."""
        slices = [slice(a, b) for a, b in pairwise([*self.first_rows.tolist(), self.time_s.size])]
        return [Stretch(self.time_s[p], self.current_A[p], self.temperature_degC[p], self.used[p]) for p in slices]

    @cached_property
    def largest_A(self) -> float:
        """The largest current, of either sign."""
        return float(np.max(np.abs(self.current_A)))

    @classmethod
    def of(cls, records: Sequence[PlateRecord]) -> PlateRows:
        """Return the records checked and joined. Raises ValueError, one line, for one that cannot be used."""
        parts, stretches, lengths, outliers, rows, end_s = [], [], [], 0, 0, 0.0
        for number, record in enumerate(records):
            time, temperature, current = _checked(record)
            lengths.append(time.size)
            used = np.isfinite(temperature)
            lone = lone_outliers(temperature, used)
            used[lone] = False
            outliers += lone.size
            steps = np.diff(time)
            broken = (steps > gap_threshold(steps)) | ~np.isfinite(current[:-1])
            edges = np.concatenate(([0], np.flatnonzero(broken) + 1, [time.size]))
            kept = [(int(a), int(b)) for a, b in pairwise(edges) if np.sum(used[a:b]) >= 3]
            for first, last in kept:
                part = slice(first, last)
                stretches.append((rows, number, first, last))
                rows += last - first
                begins = np.arange(first, last) == kept[0][0]
                shifted = time[part] - time[kept[0][0]] + end_s
                parts.append((shifted, temperature[part], np.nan_to_num(current[part]), used[part], begins))
            if kept:
                end_s = float(parts[-1][0][-1]) + float(np.median(steps))
        if not parts:
            raise ValueError("records: no stretch of readings between gaps is long enough, expected at least 3 rows")
        time, temperature, current, used, begins = (np.concatenate(column) for column in zip(*parts, strict=True))
        first_rows = np.array([first for first, *_ in stretches])
        of_records = tuple((number, first, last) for _, number, first, last in stretches)
        return cls(time, temperature, current, used, first_rows, begins, of_records, outliers, tuple(lengths))


def _checked(record: PlateRecord) -> tuple[Array, Array, Array]:
    """Return time, temperature and current of a record that can be used."""
    name, columns = record.name, ("time_s", "temperature_degC", "current_A")
    time, temperature, current = checked_columns({c: getattr(record, c) for c in columns}, name).values()
    finite = temperature[np.isfinite(temperature)]
    if finite.size < FEWEST:
        raise ValueError(f"{name}: temperature_degC: {finite.size} finite readings, expected at least {FEWEST}")
    if not np.any(np.isfinite(current)):
        raise ValueError(f"{name}: current_A: no finite number in {time.size} rows, expected A")
    if np.all(current[np.isfinite(current)] == 0.0):
        raise ValueError(f"{name}: current_A: 0 throughout, expected a current that moves the plate")
    noise = 1.4826 * float(np.median(np.abs(np.diff(finite)))) / math.sqrt(2.0)
    if np.ptp(finite) < max(1e-3, 3.0 * noise):
        at = f"constant at {np.median(finite):.6g}"
        raise ValueError(f"{name}: temperature_degC: {at}, expected one that follows the current")
    return time, temperature, current


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
    if kind not in NAMES:
        raise ValueError(f"kind: {kind!r}: expected 'peltier' or 'heater'")
    if not records:
        raise ValueError("records: none given, expected at least one")
    rows, odd = PlateRows.of(records), _odd(records)

    def noted(at: _Point) -> PlateFit:
        fit = _result(at)
        notes = plate_notes(
            fit,
            rows.current_A,
            lambda current, other: _result(_plain(replace(rows, current_A=current), other, slopes)),
        )
        return replace(fit, identifiability=(*odd, *notes))

    # a trial plate may run away; its residual is then refused
    with np.errstate(over="ignore", invalid="ignore"):
        plain = _plain(rows, kind, slopes)
        lagging = _with_lag(plain) if lag else plain
        fit = noted(plain)
        return fit if lagging is plain else replace(noted(lagging), without_lag=fit)


def _odd(records: Sequence[PlateRecord]) -> tuple[str, ...]:
    """Return lines on temperatures that cannot be what was measured."""
    columns = []
    for record in records:
        time, degC = (np.asarray(values, dtype=np.float64) for values in (record.time_s, record.temperature_degC))
        columns.append((record.name, [Column("temperature_degC", time, degC, "degC")]))
    return of_records(columns)


class _Problem:
    """The residual of the records as a function of the unknowns: plate, lag (if any), first temperature of each
    stretch."""

    def __init__(self, rows: PlateRows, kind: Kind, lag: bool, slopes: bool) -> None:
        self.rows, self.kind, self.lag, self.slopes = rows, kind, lag, slopes and kind == "peltier"
        self.places = [place for place in PLACES[kind] if slopes or place not in SLOPES]
        self.names = tuple(name for name, place in zip(NAMES[kind], PLACES[kind], strict=True) if place in self.places)
        self.split = len(self.places) + lag
        free = np.full(rows.first_rows.size + lag, np.inf)
        least = np.array([SMALLEST, 0.0, SMALLEST, SMALLEST, -np.inf, *[-LARGEST_SLOPE_PER_K] * 2])
        most = np.array([*[np.inf] * 5, *[LARGEST_SLOPE_PER_K] * 2])
        self.least, self.most = np.append(least[self.places], -free), np.append(most[self.places], free)
        if lag:
            self.least[self.split - 1] = 0.0
        self.used = np.flatnonzero(rows.used)
        self.anew = rows.first_rows.astype(np.int64)
        self._nodes: dict[bool, Nodes] = {}

    def shown(self, unknowns: Array) -> Array:
        """Return what the thermometer shows without noise, (used readings,)."""
        return self.simulated(unknowns)[self.used]

    def simulated(self, unknowns: Array) -> Array:
        """Return the same in every row, (rows,)."""
        rows = self.rows
        links = self._links(float(unknowns[self.split - 1])) if self.lag else Links()
        if self.lag not in self._nodes:
            self._nodes[self.lag] = plate_nodes(rows, links)
        par = np.zeros(NUMBERS)
        par[self.places] = unknowns[: len(self.places)]
        late = np.zeros((self.anew.size, int(self.lag)))
        bodies = np.empty((self.anew.size, 0))
        run = simulate_plate(rows, self._nodes[self.lag], par, links, unknowns[self.split :], self.anew, bodies, late)
        return run.shown_degC

    def course(self, unknowns: Array, noise: Noise, readings: Readings) -> Array:
        """Return the plate's temperature in each row, simulated and corrected by the readings, degC, (rows,)."""
        plain = np.delete(unknowns, self.split - 1) if self.lag else unknowns
        alone = self if not self.lag else _Problem(self.rows, self.kind, False, self.slopes)
        plate = alone.simulated(plain)
        if noise.slow == 0.0:
            return plate
        time, beyond = self.rows.time_s, discrepancy(self.residual(unknowns), noise, readings)[0]
        return plate + np.interp(time, time[self.used], beyond)

    @staticmethod
    def _links(lag_s: float) -> Links:
        return links_of((switched(SENSOR_LAG, {"tau_s": lag_s}),))

    def residual(self, unknowns: Array) -> Array:
        """Return measured less modelled, K, (used readings,); large where a trial runs away."""
        left = self.rows.temperature_degC[self.used] - self.shown(unknowns)
        return np.where(np.isfinite(left), left, 1e6)

    def jacobian(self, unknowns: Array, residual: Array) -> Array:
        """Return d residual / d unknowns, (used readings, unknowns). The first temperatures share one simulation: each
        acts on its own stretch."""
        columns = []
        for k in range(self.split):
            step = 1e-5 * max(abs(unknowns[k]), 1e-3)
            moved = unknowns.copy()
            moved[k] += step
            columns.append((self.residual(moved) - residual) / step)
        moved = unknowns.copy()
        moved[self.split :] += 1e-3
        by_first = (self.residual(moved) - residual) / 1e-3
        stretch = self.rows.stretch[self.used]
        columns += [np.where(stretch == k, by_first, 0.0) for k in range(self.rows.first_rows.size)]
        return np.stack(columns, axis=1)

    def priors(self, unknowns: Array) -> tuple[Array, Array]:
        """Return how far the unknowns are from what is known beforehand, in deviations, and the derivatives: first what
        plates have in common, then what is known of the slopes."""
        away, rows = [], []

        def expected(value: float, prior: tuple[float, float], by: dict[int, float]) -> None:
            mean, deviation = prior
            away.append((value - mean) / deviation)
            row = np.zeros(unknowns.size)
            for place, slope in by.items():
                row[self.places.index(place)] = slope / deviation
            rows.append(row)

        expected(float(unknowns[self.places.index(AMBIENT)]), AMBIENT_DEGC, {AMBIENT: 1.0})
        if self.kind == "peltier":
            s, r = max(float(unknowns[0]), SMALLEST), float(unknowns[1])
            pump = 300.0 * s / self.rows.largest_A
            expected(r / pump, SHARE, {1: 1.0 / pump, 0: -r / (pump * s)})
        if self.slopes:
            for place, prior in zip(SLOPES, (SEEBECK_SLOPE_PRIOR_PER_K, RESISTANCE_SLOPE_PRIOR_PER_K), strict=True):
                expected(float(unknowns[self.places.index(place)]), prior, {place: 1.0})
        return np.array(away), np.stack(rows)

    def descend(self, unknowns: Array, whitening: Whitening, evaluations: int) -> tuple[Array, float]:
        """Return the unknowns of the highest posterior density near some, and half of what it is penalized by there."""

        def white(x: Array) -> Array:
            return np.concatenate((whitening.of(self.residual(x)), self.priors(x)[0]))

        def slopes(x: Array, left: Array) -> Array:
            return np.vstack((whitening.of(self.jacobian(x, self.residual(x))), self.priors(x)[1]))

        return least_squares(white, slopes, unknowns, (self.least, self.most), evaluations)


@dataclass(frozen=True, eq=False)
class _Point:
    """A fit on the way: unknowns, the noise and readings that it was found with, its log-likelihood."""

    problem: _Problem
    unknowns: Array
    noise: Noise
    readings: Readings
    log_likelihood: float
    most_slow: float


def _plain(rows: PlateRows, kind: Kind, slopes: bool) -> _Point:
    """Return the likeliest plate without a lag of the thermometer."""
    return _likeliest(_started(_Problem(rows, kind, False, slopes)))


def _readings(problem: _Problem) -> Readings:
    rows, used = problem.rows, problem.used
    record = np.cumsum(rows.begins)[used]
    return Readings.at(rows.time_s[used], np.diff(record, prepend=0) > 0)


def _started(problem: _Problem) -> _Point:
    """Return the best of several starts, by the simulation error alone: no discrepancy stands in for a bad start."""
    rows, readings = problem.rows, _readings(problem)
    temperature = rows.temperature_degC[problem.used]
    moves = np.diff(temperature)
    noise = Noise(max(1.4826 * float(np.median(np.abs(moves - np.median(moves)))), LEAST_NOISE_K))
    whitening = Whitening(noise, readings)
    stretch = rows.stretch[problem.used]
    firsts = temperature[np.searchsorted(stretch, np.arange(rows.first_rows.size))]
    tried = []
    for par in rough_balances(rows.parts, problem.kind):
        known = (SEEBECK_SLOPE_PRIOR_PER_K[0], RESISTANCE_SLOPE_PRIOR_PER_K[0])
        start = np.concatenate((np.append(par, known)[problem.places], firsts))
        tried.append(problem.descend(start, whitening, 8))
    best = min(tried, key=lambda at: at[1])[0]
    for _ in range(2):  # what is known beforehand weighs by what the first one leaves
        best, _ = problem.descend(best, whitening, 60)
        whitening = Whitening(Noise(max(float(np.std(problem.residual(best))), LEAST_NOISE_K)), readings)
    # what the least error of a simulation leaves, no discrepancy needs to exceed
    return _measured(problem, best, readings, float(np.std(problem.residual(best))))


def _measured(problem: _Problem, unknowns: Array, readings: Readings, most_slow: float) -> _Point:
    """Return the point with the noise that its residual shows, readings far out weighing less."""
    residual = problem.residual(unknowns)
    for _ in range(3):
        noise = estimate(residual, readings, LEAST_NOISE_K, most_slow)
        weighed = replace(readings, variance=variances(residual, noise, readings))
        if np.allclose(weighed.variance, readings.variance, rtol=0.05):
            break
        readings = weighed
    whitening = Whitening(noise, readings)
    away = problem.priors(unknowns)[0]
    likelihood = whitening.log_likelihood(residual) - 0.5 * float(away @ away)
    return _Point(problem, unknowns, noise, readings, likelihood, most_slow)


def _likeliest(at: _Point) -> _Point:
    """Return the point of the highest likelihood with the noise of a point near it, and its own noise."""
    unknowns, _ = at.problem.descend(at.unknowns, Whitening(at.noise, at.readings), 40)
    return _measured(at.problem, unknowns, at.readings, at.most_slow)


def _with_lag(plain: _Point) -> _Point:
    """Return the best fit with a lagging thermometer, where it is worth its price; else the one without."""
    problem = _Problem(plain.problem.rows, plain.problem.kind, True, plain.problem.slopes)
    best, split = plain, plain.problem.split
    whitening = Whitening(plain.noise, plain.readings)
    alone = Whitening(Noise(float(np.std(plain.problem.residual(plain.unknowns)))), plain.readings)
    tried = []
    for lag_s in LAG_STARTS_S:
        start = np.insert(plain.unknowns, split, lag_s)
        tried += [problem.descend(start, metric, 12) for metric in (whitening, alone)]
    for unknowns in {round(float(x[split]), 2): x for x, _ in sorted(tried, key=lambda at: at[1])[:4]}.values():
        lagging = _likeliest(_measured(problem, unknowns, plain.readings, plain.most_slow))
        best = max(best, lagging, key=lambda at: at.log_likelihood)
    worth = best.log_likelihood - plain.log_likelihood > price(1, problem.used.size)
    return best if worth and best.unknowns[split] >= SHORTEST_LAG_S else plain


def _result(at: _Point) -> PlateFit:
    problem, unknowns, kind = at.problem, at.unknowns, at.problem.kind
    count, whitening = len(problem.places), Whitening(at.noise, at.readings)
    residual = problem.residual(unknowns)
    by = problem.priors(unknowns)[1]
    known = by[by.shape[0] - len(SLOPES) * problem.slopes :]  # of the slopes alone
    jacobian = whitening.of(problem.jacobian(unknowns, residual))
    covariance = block_sandwich(jacobian, whitening.of(residual), precision=known.T @ known)
    par = np.zeros(NUMBERS)
    par[problem.places] = unknowns[:count]
    s, r, g, q, ambient, of_s, of_r = (float(value) for value in par)
    model = PlateModel(s, r, g, ambient, q, kind, *at.noise.of_a_model, (), of_s, of_r)
    counted = residual[at.readings.variance < 2.0]
    return PlateFit(
        model,
        problem.names,
        unknowns[:count].copy(),
        covariance.standard_errors[:count],
        covariance.correlation[:count, :count],
        tuple(float(first) for first in unknowns[problem.split :]),
        problem.rows.stretches,
        at.noise,
        at.log_likelihood,
        math.sqrt(float(np.mean(counted**2))),
        float(np.max(np.abs(counted))),
        problem.rows.outliers + int(np.sum(at.readings.variance >= 2.0)),
        (),
        max(float(np.ptp(part.time_s)) for part in problem.rows.parts),
        float(unknowns[problem.split - 1]) if problem.lag else 0.0,
        _by_record(problem.rows, problem.course(unknowns, at.noise, at.readings)),
    )


def _by_record(rows: PlateRows, values: Array) -> tuple[Array, ...]:
    """Return values of all rows in those of each record, nan in rows of no stretch."""
    lengths = rows.lengths
    found = [np.full(length, np.nan) for length in lengths]
    for first_row, (number, first, last) in zip(rows.first_rows.tolist(), rows.stretches, strict=True):
        found[number][first:last] = values[first_row : first_row + last - first]
    return tuple(found)
