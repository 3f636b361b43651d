"""The fit of the last links: plate temperature -> film -> ohmmeter, by the simulation error over the whole record.

    y = D(T_f) + sum_j p_j F_j[T_f] + sum_k n_k N_k[T_f]        then the ohmmeter's effects

F_j are play operators with one pair of envelopes (the model's class), N_k relays spread over the Preisach plane: they
stand for whatever a film of another kind does besides, with a normal prior whose width the record itself decides. A
film of the class needs none, and so the prior's width goes to nothing; a film of any other kind uses them, and no
effect has to stand in for it. All coefficients are linear and are eliminated (variable projection); envelopes and
effects' parameters are searched for by a damped Gauss-Newton descent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import cho_solve

from compensator.hysteresis.functions import Array
from compensator.identification.levenberg_marquardt import FLAT, Damping, Linearized, damped_step, held_at_bounds
from compensator.identification.operator_outputs import radius_floor
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.fit.film_basis import FilmBasis
from sim.diagnosis.fit.film_point import LinearProblem, Point
from sim.diagnosis.fit.preisach_density import RelaysOfRecord
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.unknowns import Unknown, envelope_unknowns, unknowns_of, values_inside, with_values
from sim.effects.effect import Switched
from sim.model.film_columns import operator_columns
from sim.model.film_nodes import FilmNodes, film_nodes
from sim.model.links import Links, behind, columns_followed, links_of, shown_output
from sim.model.meter_power import MeterPower
from sim.model.ohmmeter import Ohmmeter, before_ranges, shown_in_rows
from sim.model.plate_path import PlatePath
from sim.model.recorded import COARSE, Spacing

ENVELOPES = 4  # of x, at its begin: two for each branch
GAP = 4.0  # times the noise that the errors of two ranges are apart, from which a reading tells its range
FEWEST_ROUNDS, MOST_ROUNDS = 2, 6  # of a problem that is linear only about a solution
SAME_COST = 1.0  # by which another round changes it, from which the solution stays
SAME_SHARE = 3e-3  # the same of what the cost is beyond the noise's own
DAMPING = Damping(least=1e-9, least_after_failure=1e-6, trials=6)
TRUSTED = 4.0  # mean square residual over noise below which the model's resistance heats the film, not the measured one


class ResistanceChannel:
    """Fits on one record and one path of the plate's temperature."""

    def __init__(
        self,
        record: Record,
        path: PlatePath,
        fitted: Mask,
        noise: NoiseModel,
        basis: FilmBasis,
        relays: bool = True,
        spacing: Spacing = COARSE,
    ) -> None:
        assert record.output is not None
        self.record, self.path, self.noise, self.basis = record, path, noise, basis
        self.fitted = fitted & record.output_used
        self.rows = np.flatnonzero(self.fitted)
        self.output = np.nan_to_num(record.output)
        self.relays, self.spacing = relays, spacing
        used = np.flatnonzero(record.output_used)
        self.readings = np.interp(np.arange(record.rows), used, self.output[used])  # straight where there is none
        self.whitening = noise.on(self.rows, self.output[self.rows])
        self._plane = RelaysOfRecord(basis.plane, record.taken_s, self.rows, self.whitening)

    def on(self, path: PlatePath) -> ResistanceChannel:
        """The same rows on another path."""
        other = copy(self)
        other.path = path
        return other

    @staticmethod
    def filters_behind(effects: Sequence[Switched]) -> int:
        """How many of x, at its end, say how far the film's own filters are behind at the first row."""
        return len(links_of(effects).film_lags)

    def extended(self, p: FilmParameters, effects: Sequence[Switched]) -> FilmParameters:
        """The same film with these effects."""
        x = np.concatenate((p.x[:ENVELOPES], values_inside(effects), np.zeros(self.filters_behind(effects))))
        return replace(p, effects=tuple(effects), x=x)

    def split(self, p: FilmParameters, x: Array) -> tuple[list[Switched], Array]:
        """Effects with their values, and how far the film's filters are behind (K)."""
        count = self.filters_behind(p.effects)
        return with_values(p.effects, x[ENVELOPES : x.size - count]), x[x.size - count :]

    def nodes(self, p: FilmParameters, x: Array) -> tuple[Links, FilmNodes]:
        """The effects with their values in the chain's order, and the film's temperature."""
        effects, late = self.split(p, x)
        test, power, links = self.record.test_current_A, None, links_of(effects)
        if test is not None and links.heated:
            own = self._at_rows_s(links, self._film_output(p))
            power = MeterPower(self.record.time_s, test, -own if self.record.quantity.rises else own)
        return links, film_nodes(self.record, self.path, links, late.tolist(), power, p.start, self.spacing)

    def _film_output(self, p: FilmParameters) -> Array:
        """The film's own output as far as it is known before a fit; rows."""
        return self.readings if p.film_output is None else p.film_output

    def _at_rows_s(self, links: Links, output: Array) -> Array:
        """What was taken for the rows' readings, at the rows' own times: they may be stamped too early or too late."""
        taken, time = links.taken(self.record.taken_s), self.record.time_s
        if np.array_equal(taken, time):
            return output
        order = np.argsort(taken, kind="stable")
        return np.interp(time, taken[order], output[order])

    def _signals(self, links: Links, nodes: FilmNodes, x: Array) -> Array:
        """Columns at the points before the ohmmeter: constant, D, operators; creep included."""
        operators = self._operators(nodes, x)
        parts = [np.ones((nodes.points.size, 1))]
        if self.basis.curve is not None:
            parts.append(self.basis.curve.columns(nodes.film_degC[nodes.points]))
        extra = []
        for effect in links.hysteretic_part:
            operators = columns_followed(effect, nodes.points_s, operators)
            extra.append(behind(effect, nodes.points_s))
        return np.concatenate([*parts, operators, *extra], axis=1)

    def _operators(self, nodes: FilmNodes, x: Array) -> Array:
        shape, floor = x[:ENVELOPES], radius_floor(x[:ENVELOPES])[0]
        return operator_columns(nodes, shape, floor + (1.0 - floor) * self.basis.fractions)

    def own_output(self, links: Links, nodes: FilmNodes, x: Array, c: Array, late_dec: Sequence[float]) -> Array:
        """The film's own output at the points: the columns of `_signals` times c, its coefficients. late_dec: how far
        each filter of the hysteretic part is behind."""
        signal = self._operators(nodes, x) @ c[self.basis.free : self.basis.columns]
        for effect, late in zip(links.hysteretic_part, late_dec, strict=True):
            signal = columns_followed(effect, nodes.points_s, signal[:, None])[:, 0]
            signal = signal + late * behind(effect, nodes.points_s)[:, 0]
        if self.basis.curve is not None:
            signal = signal + self.basis.curve.values(nodes.film_degC[nodes.points], c[1 : self.basis.free])
        return np.asarray(c[0] + signal, dtype=np.float64)

    def point(self, p: FilmParameters, x: Array, guess: Array | None = None) -> Point:
        """The best coefficients at x."""
        links, nodes = self.nodes(p, x)
        relays = self._plane.at(links, nodes) if self.relay_count(p) else self._plane.none
        signals = self._signals(links, nodes, x)
        rows, y, coefficients = self.rows, self.output, guess
        film = nodes.of_rows(signals)
        if links.linear:
            at_rows = Ohmmeter(links, nodes, np.empty(0)).columns(signals)
            problem = LinearProblem.of(at_rows, np.zeros(y.size), film, relays, y, rows, self.whitening, None)
            return problem.solved(x, p.prior.precision(self.basis, problem))
        least, most = (FEWEST_ROUNDS, MOST_ROUNDS) if links.bends else (1, 1)
        before = math.inf
        for turn in range(most):
            known = coefficients[: signals.shape[1]] if coefficients is not None else np.empty(0)
            guessed = known.size == signals.shape[1]
            signal = np.interp(nodes.points_s, self.record.time_s, self._film_output(p))
            if coefficients is not None and guessed:
                of_relays = coefficients[coefficients.size - relays.count :]
                signal = signals @ known + nodes.at_points(relays.film @ of_relays)
            ohmmeter = Ohmmeter(links, nodes, signal)
            bent = ohmmeter.slope is not None and relays.count
            shown = relays.bent(ohmmeter.slope[nodes.rows], rows, self.whitening) if bent else relays  # type: ignore[index]
            at_rows = ohmmeter.columns(signals)
            if coefficients is not None and guessed:
                linear = at_rows[:, : known.size] @ known + shown.every @ of_relays
            else:
                linear = ohmmeter.plain(signal[:, None])[:, 0]
            first, *other_ranges = self._ranges(links, nodes, signal)
            offset = shown_in_rows(links, nodes, signal, first) - linear
            problem = LinearProblem.of(at_rows, offset, film, shown, y, rows, self.whitening, first)
            found = problem.solved(x, p.prior.precision(self.basis, problem))
            for range_of in other_ranges:
                offset = shown_in_rows(links, nodes, signal, range_of) - linear
                other = problem.shifted(offset, y, range_of).solved(x, found.prior)
                found = min(found, other, key=lambda point: point.cost)
            coefficients = found.coefficients
            same = max(SAME_COST, SAME_SHARE * (found.cost - 0.5 * rows.size))
            if turn + 1 >= least and abs(found.cost - before) < same:
                break
            before = found.cost
        return found

    def _ranges(self, links: Links, nodes: FilmNodes, signal: Array) -> list[Array | None]:
        """The outputs by which the ohmmeter may choose its range: those of the model, and those that it shows, which is
        surer where a range's error leaves a gap between two of them that noise does not fill. (Where it does, a choice
        by the readings would call their noise a range's error.) None where it has but one."""
        ranged = [e for e in links.readings if getattr(e.effect.form, "linear", False)]
        if not ranged:
            return [None]
        by_model = before_ranges(links, nodes, signal)
        apart = sum(float(np.ptp(shown_output(e, self.readings) - self.readings)) for e in ranged)  # largest steps
        return [by_model, self.readings] if apart > GAP * self.noise.level else [by_model]

    def of_relays(self, p: FilmParameters, x: Array, point: Point) -> tuple[Links, FilmNodes, Array]:
        """Effects and film at another x, and what the relays add: all that the envelopes leave alone."""
        links, nodes = self.nodes(p, x)
        first = point.coefficients.size - self.relay_count(p)
        return links, nodes, self._plane.signal(links, nodes, point.coefficients[first:])

    def predict(
        self, p: FilmParameters, x: Array, point: Point, relays: tuple[Links, FilmNodes, Array] | None = None
    ) -> Array:
        """What is shown at another x with the point's coefficients. relays: as `of_relays` has them, where known."""
        links, nodes, of_relays = self.of_relays(p, x, point) if relays is None else relays
        c = point.coefficients
        creeps, lags = len(links.hysteretic_part), len(links.meter_lags)
        late = c[self.basis.columns : self.basis.columns + creeps + lags].tolist()
        signal = self.own_output(links, nodes, x, c, late[:creeps]) + of_relays
        return shown_in_rows(links, nodes, signal, point.problem.range_of, late[creeps:])

    def predict_from(
        self, p: FilmParameters, fit: ResistanceFit, late: Mapping[str, float] | None = None
    ) -> tuple[Array, Array]:
        """What is shown, and the film's own output, with p's effects and the coefficients of a fit that has all of them
        but one; rows. late: how far each filter of the hysteretic part and of log R is behind at the first row, by
        effect; one that is not named, by nothing; None: as in the fit."""
        links, nodes = self.nodes(p, p.x)
        c = fit.coefficients
        late = self.late_dec(fit) if late is None else late
        signal = self.own_output(links, nodes, p.x, c, [late.get(e.name, 0.0) for e in links.hysteretic_part])
        signal = signal + self._plane.signal(links, nodes, c[c.size - self.relay_count(fit.parameters) :])
        shown = shown_in_rows(links, nodes, signal, None, [late.get(e.name, 0.0) for e in links.meter_lags])
        return shown, nodes.of_rows(signal)

    def late_dec(self, fit: ResistanceFit) -> dict[str, float]:
        """How far a fit has each filter of the hysteretic part and of log R behind at the first row."""
        place, links = self.basis.columns, links_of(fit.effects)
        names = [e.name for e in (*links.hysteretic_part, *links.meter_lags)]
        return dict(zip(names, fit.coefficients[place : place + len(names)].tolist(), strict=True))

    def relay_count(self, p: FilmParameters) -> int:
        """How many coefficients the relays have; none where their prior's width is 0."""
        return self.basis.plane.count if self.relays and p.has_relays else 0

    def bounds(self, p: FilmParameters) -> tuple[Array, Array, Array]:
        """Least, largest and step of each of x."""
        unknowns = self.unknowns(p)
        behind = p.x.size - len(unknowns)
        low = np.array([u.low for u in unknowns] + [-20.0] * behind)
        high = np.array([u.high for u in unknowns] + [20.0] * behind)
        return low, high, np.array([u.step for u in unknowns] + [1e-2] * behind)

    def unknowns(self, p: FilmParameters) -> list[Unknown]:
        """Of the envelopes and of the effects."""
        return [*envelope_unknowns(self.path.plate_degC), *unknowns_of(p.effects)]

    def descend(
        self, p: FilmParameters, steps: int = 12, tolerance: float = 0.05, settle: bool = True
    ) -> ResistanceFit:
        """The local minimum reached from p, with the priors' widths settled on the way.

        Of the penalized cost, except where an effect bends what relays show: a larger one leaves their coefficients
        less room, and the cost alone would end at a fraction of its size (0.3 of a series resistance beside a Preisach
        film). There it is the marginal likelihood.
        """
        low, high, h = self.bounds(p)
        x = np.clip(p.x, low, high)
        point = self.point(p, x)
        p, point = self._settled(p, point, 3 if settle else 0)
        damping = DAMPING.first
        jacobian = np.zeros((self.record.rows, x.size))
        bending = p.bending if p.has_relays else []

        def loss(at: Point) -> float:
            return -at.evidence if bending else at.cost

        for iteration in range(steps):
            room = self._slopes(p, point, high, h, bending, jacobian)
            j = self.over(jacobian[self.rows])
            residual = self._over_noise(point.shown)
            cross = point.along(j)
            normal = j.T @ j - cross.T @ cho_solve(point.factor, cross, check_finite=False)
            gradient = j.T @ residual - room
            held_at_bounds(normal, gradient, point.x, low, high)
            scale = np.maximum(np.diag(normal), FLAT * float(np.max(np.diag(normal))) + 1e-30)
            before = loss(point)
            about = Linearized(normal, gradient, scale, partial(self._moved, p, point, low, high), FLAT)
            point, damping = damped_step(point, loss, about, damping, DAMPING)
            if links_of(p.effects).heated and 2.0 * point.cost < TRUSTED * self.rows.size:
                p = replace(p, film_output=point.film_output)
            if settle and iteration % 3 == 2:
                point = self.point(p, point.x, point.coefficients)
                p, point = self._settled(p, point, 1)
            elif before - loss(point) < tolerance:
                break
        point = self.point(p, point.x, point.coefficients)
        p, point = self._settled(p, point, 3 if settle else 0)
        effects, _ = self.split(p, point.x)
        residual = self._over_noise(point.shown)
        return ResistanceFit(
            replace(p, effects=tuple(effects), x=point.x),
            point.shown,
            point.film_output,
            point.evidence,
            self.noise.level,
            point.coefficients,
            jacobian.copy(),
            0.5 * float(residual @ residual),
        )

    def _moved(self, p: FilmParameters, point: Point, low: Array, high: Array, move: Array) -> Point:
        """The point after a step, within the bounds and no longer than 1 in any unknown."""
        return self.point(p, np.clip(point.x + np.clip(move, -1.0, 1.0), low, high), point.coefficients)

    def _slopes(
        self, p: FilmParameters, point: Point, high: Array, h: Array, bending: list[int], jacobian: Array
    ) -> Array:
        """d shown / d x by difference quotients, into jacobian (rows, unknowns); returned is by how much the room that
        the coefficients leave changes with those of x that bend the reading."""
        relays, room = self.of_relays(p, point.x, point), np.zeros(point.x.size)
        base = self.predict(p, point.x, point, relays)
        for k in range(point.x.size):
            moved = point.x.copy()
            moved[k] += h[k] if moved[k] + h[k] <= high[k] else -h[k]
            change = self.predict(p, moved, point, relays if k < ENVELOPES else None) - base
            jacobian[:, k] = change / (moved[k] - point.x[k])
            if k in bending:
                other = self.point(p, moved, point.coefficients)
                room[k] = (other.room - point.room) / (moved[k] - point.x[k])
        return room

    def over(self, values: Array) -> Array:
        """Values of the fitted rows, (rows,) or (rows, columns), over the noise."""
        return self.whitening.over(values)

    def _over_noise(self, shown: Array) -> Array:
        """What is left in the fitted rows, over the noise."""
        return self.over(self.output[self.rows] - shown[self.rows])

    def _settled(self, p: FilmParameters, point: Point, turns: int) -> tuple[FilmParameters, Point]:
        """The priors' widths at a fixed x, and the point with them."""
        for _ in range(turns):
            wider = p.prior.asked_for(self.basis, point)
            other = point.problem.solved(point.x, wider.precision(self.basis, point.problem))
            if other.evidence <= point.evidence + 0.02:
                break
            p, point = replace(p, prior=wider), other
        return p, point

    def mean_square(self, fit: ResistanceFit) -> float:
        """Of the residual over the noise, in the fitted rows."""
        return 2.0 * fit.minus_log / self.rows.size

    def residual(self, fit: ResistanceFit) -> Array:
        """In units of the noise, in the fitted rows."""
        return self._over_noise(fit.shown)
