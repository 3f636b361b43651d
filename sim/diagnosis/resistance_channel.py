"""The fit of the last links: plate temperature -> film -> ohmmeter, by the simulation error over the whole record.

    y = D(T_f) + sum_j p_j F_j[T_f] + sum_k n_k N_k[T_f]        then the ohmmeter's effects

F_j are play operators with one pair of envelopes (the model's class), N_k relays spread over the Preisach plane: they
stand for whatever a film of another kind does besides, with a normal prior whose width the record itself decides. A
film of the class needs none, and so the prior's width goes to nothing; a film of any other kind uses them, and no
effect has to stand in for it. All coefficients are linear and are eliminated (variable projection); envelopes and
effects' parameters are searched for by Gauss-Newton with Marquardt's damping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.linalg import cho_solve

from compensator.hysteresis.functions import Array
from compensator.identification.operator_outputs import radius_floor
from sim.diagnosis.film_basis import FilmBasis
from sim.diagnosis.film_columns import (
    FOLLOWING,
    FilmNodes,
    film_nodes,
    filtered,
    operator_columns,
    transfer,
)
from sim.diagnosis.film_point import LinearProblem, Point
from sim.diagnosis.film_power import MeterPower
from sim.diagnosis.film_relays import RelaysOfRecord
from sim.diagnosis.plate_path import PlatePath
from sim.diagnosis.readings import quick_noise
from sim.diagnosis.record import Mask, Record
from sim.diagnosis.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.unknowns import Unknown, free, positive, unknowns_of, values_inside, with_values
from sim.effects.effect import Filter, Reading, Switched, Warming, at_the_terminals, filters

GAP = 4.0  # times the noise that the errors of two ranges are apart, from which a reading tells its range
FEWEST_ROUNDS, MOST_ROUNDS = 2, 6  # of a problem that is linear only about a solution
SAME_COST = 1.0  # by which another round changes it, from which the solution stays
SAME_SHARE = 3e-3  # the same of what the cost is beyond the noise's own
TRUSTED = 4.0  # mean square residual over noise below which the model's resistance heats the film, not the measured one


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
        used = np.flatnonzero(record.output_used)
        self.readings = np.interp(np.arange(record.rows), used, self.output[used])  # straight where there is none
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
            power = MeterPower(self.record.time_s, test, self._film_output(p))
        return effects, film_nodes(self.record, self.path, effects, behind.tolist(), power, p.start)

    def _film_output(self, p: FilmParameters) -> Array:
        """The film's own output as far as it is known before a fit; rows."""
        return self.readings if p.film_output is None else p.film_output

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
        place = self.basis.columns
        signal = self._operators(nodes, x) @ c[self.basis.free : place]
        for effect in filters(effects, "hysteretic_part"):
            signal = filtered(signal[:, None], nodes.points_s, effect)[:, 0]
            signal = signal + c[place] * self._behind(effect, nodes.points_s)[:, 0]
            place += 1
        if self.basis.curve is not None:
            signal = signal + self.basis.curve.values(nodes.film_degC[nodes.points], c[1 : self.basis.free])
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

    def point(self, p: FilmParameters, x: Array, guess: Array | None = None) -> Point:
        """The best coefficients at x."""
        effects, nodes = self.nodes(p, x)
        relays = self._plane.at(effects, nodes) if self.relay_count(p) else self._plane.none
        signals = self._signals(effects, nodes, x)
        lags = filters(effects, "log_resistance")
        curved = any(at_the_terminals(e.effect) for e in effects)
        rows, y = self.rows, self.output
        coefficients = guess
        film = nodes.of_rows(signals)
        least, most = (FEWEST_ROUNDS, MOST_ROUNDS) if curved else (1, 1)
        before = math.inf
        for turn in range(most):
            known = coefficients[: signals.shape[1]] if coefficients is not None else np.empty(0)
            guessed = known.size == signals.shape[1]
            signal = np.interp(nodes.points_s, self.record.time_s, self._film_output(p))
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
            found = problem.solved(x, p.prior.precision(self.basis, problem))
            for range_of in other_ranges:
                offset = self._shown(effects, nodes, signal, range_of) - linear
                other = problem.shifted(offset, y, range_of).solved(x, found.prior)
                found = min(found, other, key=lambda point: point.cost)
            coefficients = found.coefficients
            same = max(SAME_COST, SAME_SHARE * (found.cost - 0.5 * rows.size))
            if turn + 1 >= least and abs(found.cost - before) < same:
                break
            before = found.cost
        return found

    def _ranges(self, effects: Sequence[Switched], nodes: FilmNodes, signal: Array) -> list[Array | None]:
        """The outputs by which the ohmmeter may choose its range: those of the model, and those that it shows, which is
        surer where a range's error leaves a gap between two of them that noise does not fill. (Where it does, a choice
        by the readings would call their noise a range's error.) None where it has but one."""
        ranged = [e for e in effects if e.effect.link == "ohmmeter" and getattr(e.effect.form, "linear", False)]
        if not ranged:
            return [None]
        by_model = self._lagged(effects, nodes, transfer(effects, signal)[0])
        apart = sum(self._largest_step_dec(e) for e in ranged)
        return [by_model, self.readings] if apart > GAP * self.sigma_dec else [by_model]

    def _largest_step_dec(self, effect: Switched) -> float:
        """Between the errors of two ranges, among the readings."""
        form, ohm = effect.effect.form, 10.0**-self.readings
        assert isinstance(form, Reading)
        return float(np.ptp(np.log10(form.read(effect.par, ohm) / ohm)))

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

    def predict_from(self, p: FilmParameters, fit: ResistanceFit) -> tuple[Array, Array]:
        """What is shown, and the film's own output, with p's effects and the coefficients of a fit that has all of them
        but one; rows."""
        effects, nodes = self.nodes(p, p.x)
        c, own = fit.coefficients, self.basis.columns
        fresh = np.concatenate((c[:own], np.zeros(len(effects))))  # a filter that the fit has not is behind by nothing
        relays = c.size - self.relay_count(fit.parameters)
        signal = self._output(effects, nodes, p.x, fresh)[0] + self._plane.signal(effects, nodes, c[relays:])
        shown = self._shown(effects, nodes, signal)
        places = filters(fit.effects, *FOLLOWING)
        for e, value in zip(places, c[own:relays], strict=True):
            shown = shown + value * self._behind(e, nodes.points_s)[nodes.rows][:, 0]
        return np.asarray(shown, dtype=np.float64), nodes.of_rows(signal)

    def relay_count(self, p: FilmParameters) -> int:
        """How many coefficients the relays have; none where their prior's width is 0."""
        return self.basis.plane.count if self.relays and p.has_relays else 0

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

    def descend(
        self, p: FilmParameters, steps: int = 12, tolerance: float = 0.05, settle: bool = True
    ) -> ResistanceFit:
        """Gauss-Newton with Marquardt's damping, and the priors' widths on the way.

        Of the penalized cost, except where an effect bends what relays show: a larger one leaves their coefficients
        less room, and the cost alone would end at a fraction of its size (0.3 of a series resistance beside a Preisach
        film). There it is the marginal likelihood.
        """
        low, high, h = self.bounds(p)
        x = np.clip(p.x, low, high)
        point = self.point(p, x)
        p, point = self._settled(p, point, 3 if settle else 0)
        damping = 1e-3
        jacobian = np.zeros((self.record.rows, x.size))
        bending = self._bending(p) if p.has_relays else []

        def loss(at: Point) -> float:
            return -at.evidence if bending else at.cost

        for iteration in range(steps):
            base = self.predict(p, point.x, point)
            room = np.zeros(x.size)  # slope of what it takes
            for k in range(x.size):
                moved = point.x.copy()
                moved[k] += h[k] if moved[k] + h[k] <= high[k] else -h[k]
                shown = self.predict(p, moved, point)
                jacobian[:, k] = (shown - base) / (moved[k] - point.x[k])
                if k in bending:
                    other = self.point(p, moved, point.coefficients)
                    room[k] = (other.room - point.room) / (moved[k] - point.x[k])
            j = jacobian[self.rows] / self.sigma_dec
            residual = (self.output[self.rows] - point.shown[self.rows]) / self.sigma_dec
            cross = point.along(j) / self.sigma_dec
            normal = j.T @ j - cross.T @ cho_solve(point.factor, cross, check_finite=False)
            gradient = j.T @ residual - room
            held = ((point.x <= low) & (gradient < 0.0)) | ((point.x >= high) & (gradient > 0.0))
            normal[held, :] = 0.0
            normal[:, held] = 0.0
            gradient[held] = 0.0
            norm = np.sqrt(np.maximum(np.diag(normal), 1e-9 * float(np.max(np.diag(normal))) + 1e-30))
            before = loss(point)
            for _ in range(6):
                damped = normal / np.outer(norm, norm) + damping * np.eye(norm.size)
                damped[np.diag_indices_from(damped)] = np.maximum(np.diag(damped), 1e-9)
                move = np.linalg.solve(damped, gradient / norm) / norm
                move = np.clip(move, -1.0, 1.0)
                trial = self.point(p, np.clip(point.x + move, low, high), point.coefficients)
                if loss(trial) < loss(point):
                    point, damping = trial, max(0.1 * damping, 1e-9)
                    break
                damping = max(10.0 * damping, 1e-6)
            if self._heated(p) and 2.0 * point.cost < TRUSTED * self.rows.size:
                p = replace(p, film_output=point.film_output)
            if settle and iteration % 3 == 2:
                point = self.point(p, point.x, point.coefficients)
                p, point = self._settled(p, point, 1)
            elif before - loss(point) < tolerance:
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
            wider = p.prior.asked_for(self.basis, point)
            other = point.problem.solved(point.x, wider.precision(self.basis, point.problem))
            if other.evidence <= point.evidence + 0.02:
                break
            p, point = replace(p, prior=wider), other
        return p, point

    @staticmethod
    def _bending(p: FilmParameters) -> list[int]:
        """Which of x bend the reading as a function of the resistance."""
        bends = [at_the_terminals(e.effect) for e in p.effects for q in e.effect.parameters if not q.choices]
        return [4 + k for k, bent in enumerate(bends) if bent]

    def noise(self, fit: ResistanceFit) -> float:
        """The ohmmeter's noise, from what a fit leaves from row to row."""
        return quick_noise(self.output[self.rows] - fit.shown[self.rows])

    def mean_square(self, fit: ResistanceFit) -> float:
        """Of the residual over the noise, in the fitted rows."""
        return 2.0 * fit.minus_log / self.rows.size

    def residual(self, fit: ResistanceFit) -> Array:
        """In units of the noise, in the fitted rows."""
        return (self.output[self.rows] - fit.shown[self.rows]) / self.sigma_dec
