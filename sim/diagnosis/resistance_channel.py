"""The fit of the last links: plate temperature -> film -> ohmmeter, by the simulation error over the whole record.

    y = D(T_f) + sum_j p_j F_j[T_f] + sum_k n_k N_k[T_f]        then the ohmmeter's effects

F_j are play operators with one pair of envelopes (the model's class), N_k relays spread over the Preisach plane: they
stand for whatever a film of another kind does besides, with a normal prior whose width the record itself decides (the
largest marginal likelihood: D. MacKay, Neural Computation 4 (1992) 415). A film of the class needs none, and so the
prior's width goes to nothing; a film of any other kind uses them, and no effect has to stand in for it. All
coefficients are linear and are eliminated (variable projection); envelopes and effects' parameters are searched for by
Gauss-Newton with Marquardt's damping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from compensator.functions import Array
from compensator.identify_operators import radius_floor
from sim.diagnosis.film_columns import (
    FOLLOWING,
    SIMPLE,
    FilmNodes,
    FilmStart,
    SmoothCurve,
    film_nodes,
    filtered,
    operator_columns,
    transfer,
)
from sim.diagnosis.film_point import LinearProblem, Point
from sim.diagnosis.film_power import MeterPower
from sim.diagnosis.film_relays import RelayPlane, RelaysOfRecord
from sim.diagnosis.plate_path import PlatePath
from sim.diagnosis.readings import quick_noise
from sim.diagnosis.record import Mask, Record
from sim.diagnosis.unknowns import Unknown, free, positive, unknowns_of, values_inside, with_values
from sim.effects.effect import Filter, Reading, Switched, Warming, filters

OPERATORS = 96
PER_OPERATOR = 2  # readings that an operator needs at least; its prior does the rest
WIDE_DEC = 30.0  # prior of the constant
CURVE_DEC = 1.0  # of D's slope over the range, and the most of what bends it
LEAST_CURVE_DEC = 1e-4
BEHIND_DEC = 0.1  # of how far a filter is behind at the first row
TRUSTED = 4.0  # mean square residual over noise below which the model's resistance heats the film, not the measured one


@dataclass(frozen=True, eq=False)
class FilmBasis:
    """What a record's film is built of: D's splines, places of the radii, and the plane of relays."""

    curve: SmoothCurve | None
    fractions: Array
    plane: RelayPlane


@dataclass(frozen=True, eq=False)
class FilmParameters:
    """x: envelopes (4), effects, how far film filters are behind; weight, relay: the priors' widths, in decades; bend,
    wave: of what D has of degree 2 and 3, and of what else it has."""

    effects: tuple[Switched, ...]
    x: Array
    start: FilmStart
    weight_dec: float = 0.3
    relay_dec: float = 0.0
    bend_dec: float = CURVE_DEC
    wave_dec: float = CURVE_DEC


@dataclass(frozen=True, eq=False)
class ResistanceFit:
    """parameters; shown: -log10 of the resistance shown, (rows,); film_output: of the film itself, (rows,); score: the
    marginal log-likelihood of the fitted rows (effects' and envelopes' parameters at their best); coefficients."""

    parameters: FilmParameters
    shown: Array
    film_output: Array
    score: float
    sigma_dec: float
    coefficients: Array
    jacobian: Array
    minus_log: float
    plain: FilmParameters | None = None

    @property
    def effects(self) -> tuple[Switched, ...]:
        return self.parameters.effects


class ResistanceChannel:
    """Fits on one record and one path of the plate's temperature."""

    def __init__(
        self, record: Record, path: PlatePath, fitted: Mask, sigma_dec: float, basis: FilmBasis, relays: bool = True
    ) -> None:
        assert record.output is not None
        self.record, self.path, self.sigma_dec, self.basis = record, path, sigma_dec, basis
        self.fitted = fitted & record.output_used
        self.rows = np.flatnonzero(self.fitted)
        self.output = np.nan_to_num(record.output)
        self.relays = relays
        self.power_output: Array = np.where(record.output_used, self.output, np.nan)
        bad = ~np.isfinite(self.power_output)
        if np.any(bad):
            good = np.flatnonzero(~bad)
            self.power_output[bad] = np.interp(np.flatnonzero(bad), good, self.power_output[good])
        self._readings = self.power_output
        self._plane = RelaysOfRecord(basis.plane, record.taken_s, self.rows)

    def on(self, path: PlatePath) -> ResistanceChannel:
        """The same rows on another path."""
        other = copy(self)
        other.path = path
        return other

    # -- the model at one x

    @staticmethod
    def filters_behind(effects: Sequence[Switched]) -> int:
        """How many of x, at its end, say how far the film's own filters are behind at the first row."""
        return len(filters(effects, "film_temperature"))

    def extended(self, p: FilmParameters, effects: Sequence[Switched]) -> FilmParameters:
        """The same film with these effects."""
        x = np.concatenate((p.x[:4], values_inside(effects), np.zeros(self.filters_behind(effects))))
        return replace(p, effects=tuple(effects), x=x)

    def split(self, p: FilmParameters, x: Array) -> tuple[list[Switched], Array]:
        """Effects with their values, and how far the film's filters are behind (K)."""
        behind = self.filters_behind(p.effects)
        return with_values(p.effects, x[4 : x.size - behind]), x[x.size - behind :]

    def nodes(self, p: FilmParameters, x: Array) -> tuple[list[Switched], FilmNodes]:
        effects, behind = self.split(p, x)
        test, power = self.record.test_current_A, None
        if test is not None and self._heated(p):
            power = MeterPower(self.record.time_s, test, self.power_output)
        return effects, film_nodes(self.record, self.path, effects, behind.tolist(), power, p.start)

    def _signals(self, effects: Sequence[Switched], nodes: FilmNodes, x: Array) -> Array:
        """Columns at the points before the ohmmeter: constant, D, operators; creep included."""
        operators = self._operators(nodes, x)
        parts = [np.ones((nodes.points.size, 1))]
        if self.basis.curve is not None:
            parts.append(self.basis.curve.columns(nodes.film_degC[nodes.points]))
        extra = []
        for effect in filters(effects, "hysteretic_part"):
            operators = filtered(operators, nodes.points_s, effect)
            extra.append(self._behind(effect, nodes.points_s))
        return np.concatenate([*parts, operators, *extra], axis=1)

    def _operators(self, nodes: FilmNodes, x: Array) -> Array:
        floor, _ = radius_floor(x[:4])
        return operator_columns(nodes, x[:4], floor + (1.0 - floor) * self.basis.fractions)

    def _output(self, effects: Sequence[Switched], nodes: FilmNodes, x: Array, c: Array) -> tuple[Array, int]:
        """The columns of `_signals` times the first of some coefficients, (points,), and how many took part."""
        place = self.film_columns
        signal = self._operators(nodes, x) @ c[self._free : place]
        for effect in filters(effects, "hysteretic_part"):
            signal = filtered(signal[:, None], nodes.points_s, effect)[:, 0]
            signal = signal + c[place] * self._behind(effect, nodes.points_s)[:, 0]
            place += 1
        if self.basis.curve is not None:
            signal = signal + self.basis.curve.values(nodes.film_degC[nodes.points], c[1 : self._free])
        return c[0] + signal, place

    @staticmethod
    def _behind(effect: Switched, time: Array) -> Array:
        """What a filter adds when it is one decade behind at the first row."""
        out, form = np.empty(time.size), effect.effect.form
        assert isinstance(form, Filter)
        form.run(effect.par, time, np.zeros(time.size), np.array([-1.0]), out)
        return out[:, None]

    def _shown(
        self, effects: Sequence[Switched], nodes: FilmNodes, signal: Array, range_of: Array | None = None
    ) -> Array:
        """The film's output at the points through the ohmmeter, in every row. range_of: the outputs by which the
        ohmmeter chooses its range, where a small step must not change that."""
        shown = self._lagged(effects, nodes, transfer(effects, signal)[0])
        seen = shown if range_of is None else range_of
        for effect in effects:
            form = effect.effect.form
            if isinstance(form, Reading) and effect.effect.link == "ohmmeter" and form.linear:
                shown = shown - seen - np.log10(form.read(effect.par, 10.0**-seen))
        return shown

    def _prior(self, p: FilmParameters, problem: LinearProblem) -> Array:
        """Precision of each coefficient: free ones, operators, behind, relays."""
        extra, relays = problem.own.shape[1] - self.film_columns, problem.relays.count
        return np.concatenate(
            (
                np.array([WIDE_DEC**-2]),
                self._curve_widths(p) ** -2,
                np.full(self.basis.fractions.size, p.weight_dec**-2),
                np.full(extra, BEHIND_DEC**-2),
                np.full(relays, max(p.relay_dec, 1e-9) ** -2),
            )
        )

    def _curve_widths(self, p: FilmParameters) -> Array:
        """The prior's width of each coefficient of D."""
        widths = np.full(self._free - 1, p.wave_dec)
        widths[:SIMPLE] = p.bend_dec
        widths[:1] = CURVE_DEC
        return widths

    def point(self, p: FilmParameters, x: Array, guess: Array | None = None) -> Point:
        """The best coefficients at x."""
        effects, nodes = self.nodes(p, x)
        relays = self._plane.at(effects, nodes) if self.relay_count(p) else self._plane.none
        signals = self._signals(effects, nodes, x)
        lags = filters(effects, "log_resistance")
        curved = any(
            isinstance(e.effect.form, Reading) and e.effect.link == "ohmmeter" and not e.effect.form.linear
            for e in effects
        )
        rows, y = self.rows, self.output
        coefficients = guess
        film = nodes.of_rows(signals)
        rounds = 1 if not curved else 3 if guess is None else 2  # near a guess two are enough
        for _ in range(rounds):
            known = coefficients[: signals.shape[1]] if coefficients is not None else np.empty(0)
            guessed = known.size == signals.shape[1]
            signal = np.interp(nodes.points_s, self.record.time_s, self.power_output)
            if coefficients is not None and guessed:
                of_relays = coefficients[coefficients.size - relays.count :]
                signal = signals @ known + nodes.at_points(relays.film @ of_relays)
            slope = transfer(effects, signal)[1] if curved else np.ones(signal.size)
            shown = relays.bent(slope[nodes.rows], rows) if curved and relays.count else relays
            moved = signals * slope[:, None] if curved else signals
            for lag in lags:
                moved = filtered(moved, nodes.points_s, lag)
                moved = np.concatenate((moved, self._behind(lag, nodes.points_s)), axis=1)
            at_rows = nodes.of_rows(moved)
            if coefficients is not None and guessed:
                linear = at_rows[:, : known.size] @ known + shown.every @ of_relays
            else:
                linear = self._lagged(effects, nodes, slope * signal)
            first, *other_ranges = self._ranges(effects, nodes, signal)
            offset = self._shown(effects, nodes, signal, first) - linear
            problem = LinearProblem.of(at_rows, offset, film, shown, y, rows, self.sigma_dec, first)
            found = problem.solved(x, self._prior(p, problem))
            for range_of in other_ranges:
                offset = self._shown(effects, nodes, signal, range_of) - linear
                other = problem.shifted(offset, y, range_of).solved(x, found.prior)
                found = min(found, other, key=lambda point: point.cost)
            coefficients = found.coefficients
        return found

    def _ranges(self, effects: Sequence[Switched], nodes: FilmNodes, signal: Array) -> list[Array | None]:
        """The outputs by which the ohmmeter may choose its range: those of the model, and those that it shows, which is
        surer where a range's error leaves a gap between two of them. None where it has but one."""
        if not any(e.effect.link == "ohmmeter" and getattr(e.effect.form, "linear", False) for e in effects):
            return [None]
        return [self._lagged(effects, nodes, transfer(effects, signal)[0]), self._readings]

    @property
    def _free(self) -> int:
        """Columns of the constant and of D."""
        return 1 + (self.basis.curve.count if self.basis.curve is not None else 0)

    @property
    def film_columns(self) -> int:
        """Columns of the film itself: constant, D, operators; those of filters follow, then relays."""
        return self._free + self.basis.fractions.size

    def _lagged(self, effects: Sequence[Switched], nodes: FilmNodes, signal: Array) -> Array:
        """A signal at the points through the ohmmeter's filters, in every row."""
        for effect in filters(effects, "log_resistance"):
            signal = filtered(signal[:, None], nodes.points_s, effect)[:, 0]
        return signal[nodes.rows]

    def predict(self, p: FilmParameters, x: Array, point: Point) -> Array:
        """What is shown at another x with the point's coefficients."""
        effects, nodes = self.nodes(p, x)
        c = point.coefficients
        signal, place = self._output(effects, nodes, x, c)
        signal = signal + self._plane.signal(effects, nodes, c[c.size - self.relay_count(p) :])
        shown = self._shown(effects, nodes, signal, point.problem.range_of)
        for effect in filters(effects, "log_resistance"):
            shown = shown + (self._behind(effect, nodes.points_s)[nodes.rows] * c[place])[:, 0]
            place += 1
        return np.asarray(shown, dtype=np.float64)

    def predict_from(self, p: FilmParameters, fit: ResistanceFit) -> Array:
        """What is shown with p's effects and the coefficients of a fit that has all of them but one; rows."""
        effects, nodes = self.nodes(p, p.x)
        c, own = fit.coefficients, self.film_columns
        fresh = np.concatenate((c[:own], np.zeros(len(effects))))  # a filter that the fit has not is behind by nothing
        relays = c.size - self.relay_count(fit.parameters)
        signal = self._output(effects, nodes, p.x, fresh)[0] + self._plane.signal(effects, nodes, c[relays:])
        shown = self._shown(effects, nodes, signal)
        places = filters(fit.effects, *FOLLOWING)
        for e, value in zip(places, c[own:relays], strict=True):
            shown = shown + value * self._behind(e, nodes.points_s)[nodes.rows][:, 0]
        return np.asarray(shown, dtype=np.float64)

    def relay_count(self, p: FilmParameters) -> int:
        """How many coefficients the relays have; none where their prior's width is 0."""
        return self.basis.plane.count if self.relays and p.relay_dec > 0.0 else 0

    # -- the fit

    def bounds(self, p: FilmParameters) -> tuple[Array, Array, Array]:
        """Least, largest and step of each of x."""
        unknowns = self.unknowns(p)
        behind = p.x.size - len(unknowns)
        low = np.array([u.low for u in unknowns] + [-20.0] * behind)
        high = np.array([u.high for u in unknowns] + [20.0] * behind)
        return low, high, np.array([u.step for u in unknowns] + [1e-2] * behind)

    def unknowns(self, p: FilmParameters) -> list[Unknown]:
        """Of the envelopes and of the effects."""
        t = self.path.plate_degC
        low_T, high_T = float(np.min(t)), float(np.max(t))
        span = high_T - low_T
        a = positive("a", 0.5 / span, 200.0 / span)
        c = free("c", 1.0, low_T - 0.5 * span, high_T + 0.5 * span)
        return [a, c, a, c, *unknowns_of(p.effects)]

    def widths(self, p: FilmParameters, point: Point) -> FilmParameters:
        """The priors' widths that the coefficients ask for (one step of the fixed point)."""
        inverse = cho_solve(point.factor, np.eye(point.coefficients.size), check_finite=False)
        variance = np.diag(inverse)
        c = point.coefficients
        relays = point.problem.relays.count
        ops = slice(self._free, self.film_columns)
        size = self.basis.fractions.size
        weight = math.sqrt(float(np.sum(c[ops] ** 2 + variance[ops])) / size)
        relay = p.relay_dec
        if relays:
            n = slice(c.size - relays, c.size)
            known = relays - float(np.sum(variance[n])) / p.relay_dec**2
            square = float(np.sum(c[n] ** 2))
            relay = math.sqrt(max(square, 1e-16) / max(known, 1e-3))
            if square < 1e-14:
                relay = p.relay_dec
            relay = min(max(relay, 1e-6), 1.0)
        bends, waves = slice(2, 1 + SIMPLE), slice(1 + SIMPLE, self._free)
        bend, wave = (
            min(max(math.sqrt(float(np.mean(c[part] ** 2 + variance[part]))), LEAST_CURVE_DEC), CURVE_DEC)
            if self._free > 1
            else CURVE_DEC
            for part in (bends, waves)
        )
        return replace(p, weight_dec=min(max(weight, 1e-3), 3.0), relay_dec=relay, bend_dec=bend, wave_dec=wave)

    def descend(
        self, p: FilmParameters, steps: int = 12, tolerance: float = 0.05, settle: bool = True
    ) -> ResistanceFit:
        """Gauss-Newton with Marquardt's damping, and the priors' widths on the way."""
        low, high, h = self.bounds(p)
        x = np.clip(p.x, low, high)
        point = self.point(p, x)
        p, point = self._settled(p, point, 3 if settle else 0)
        damping = 1e-3
        jacobian = np.zeros((self.record.rows, x.size))
        for iteration in range(steps):
            base = self.predict(p, point.x, point)
            for k in range(x.size):
                moved = point.x.copy()
                moved[k] += h[k] if moved[k] + h[k] <= high[k] else -h[k]
                shown = self.predict(p, moved, point)
                jacobian[:, k] = (shown - base) / (moved[k] - point.x[k])
            j = jacobian[self.rows] / self.sigma_dec
            residual = (self.output[self.rows] - point.shown[self.rows]) / self.sigma_dec
            cross = point.along(j) / self.sigma_dec
            normal = j.T @ j - cross.T @ cho_solve(point.factor, cross, check_finite=False)
            gradient = j.T @ residual
            held = ((point.x <= low) & (gradient < 0.0)) | ((point.x >= high) & (gradient > 0.0))
            normal[held, :] = 0.0
            normal[:, held] = 0.0
            gradient[held] = 0.0
            norm = np.sqrt(np.maximum(np.diag(normal), 1e-9 * float(np.max(np.diag(normal))) + 1e-30))
            before = point.cost
            for _ in range(6):
                damped = normal / np.outer(norm, norm) + damping * np.eye(norm.size)
                damped[np.diag_indices_from(damped)] = np.maximum(np.diag(damped), 1e-9)
                move = np.linalg.solve(damped, gradient / norm) / norm
                move = np.clip(move, -1.0, 1.0)
                trial = self.point(p, np.clip(point.x + move, low, high), point.coefficients)
                if trial.cost < point.cost:
                    point, damping = trial, max(0.1 * damping, 1e-9)
                    break
                damping = max(10.0 * damping, 1e-6)
            if self._heated(p) and 2.0 * point.cost < TRUSTED * self.rows.size:
                self.power_output = point.film_output.copy()
            if settle and iteration % 3 == 2:
                point = self.point(p, point.x, point.coefficients)
                p, point = self._settled(p, point, 1)
            elif before - point.cost < tolerance:
                break
        point = self.point(p, point.x, point.coefficients)
        p, point = self._settled(p, point, 3 if settle else 0)
        effects, _ = self.split(p, point.x)
        residual = (self.output[self.rows] - point.shown[self.rows]) / self.sigma_dec
        return ResistanceFit(
            replace(p, effects=tuple(effects), x=point.x),
            point.shown,
            point.film_output,
            point.evidence,
            self.sigma_dec,
            point.coefficients,
            jacobian.copy(),
            0.5 * float(residual @ residual),
        )

    @staticmethod
    def _heated(p: FilmParameters) -> bool:
        return any(isinstance(e.effect.form, Warming) and e.effect.form.heated for e in p.effects)

    def _settled(self, p: FilmParameters, point: Point, turns: int) -> tuple[FilmParameters, Point]:
        """The priors' widths at a fixed x, and the point with them."""
        for _ in range(turns):
            wider = self.widths(p, point)
            other = point.problem.solved(point.x, self._prior(wider, point.problem))
            if other.evidence <= point.evidence + 0.02:
                break
            p, point = wider, other
        return p, point

    def noise(self, fit: ResistanceFit) -> float:
        """The ohmmeter's noise, from what a fit leaves from row to row."""
        return quick_noise(self.output[self.rows] - fit.shown[self.rows])

    def mean_square(self, fit: ResistanceFit) -> float:
        """Of the residual over the noise, in the fitted rows."""
        return 2.0 * fit.minus_log / self.rows.size

    def residual(self, fit: ResistanceFit) -> Array:
        """In units of the noise, in the fitted rows."""
        return (self.output[self.rows] - fit.shown[self.rows]) / self.sigma_dec


def basis_for(record: Record, path: PlatePath, middle: float, half: float, curve: bool) -> FilmBasis:
    """Placed for a record: D's splines over the range, relays where the output changes."""
    low, high = float(np.min(path.plate_degC)), float(np.max(path.plate_degC))
    readings = int(np.sum(record.output_used))
    operators = min(OPERATORS, max(readings // PER_OPERATOR, 12))
    return FilmBasis(
        SmoothCurve.over(low - 0.5, high + 0.5) if curve else None,
        np.arange(operators) / operators,
        RelayPlane.over(middle, min(2.2 * half, 0.6 * (high - low)), high - low, readings),
    )
