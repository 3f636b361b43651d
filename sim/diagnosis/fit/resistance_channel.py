"""The fit of the last links to the ohmmeter's readings, by the simulation error over the whole record.

The equations are `film_equations`; here are the readings, their noise, and the cost. The relays have a normal prior
whose width the record itself decides: a Prandtl-Ishlinskii film needs none, and so it goes to nothing; a film of any
other kind uses them, and no effect has to stand in for it. All coefficients are linear and are eliminated (variable
projection); envelopes and effects' parameters are searched for by a damped Gauss-Newton descent.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import NoiseModel, Whitens
from sim.diagnosis.data.record import Mask, Record, Rows
from sim.diagnosis.fit.film_basis import ENVELOPES, FilmBasis
from sim.diagnosis.fit.film_equations import FilmEquations, straight_readings
from sim.diagnosis.fit.film_point import LinearProblem, Point, Projected
from sim.diagnosis.fit.preisach_density import Relays, RelaysOfRecord
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.inference.levenberg_marquardt import (
    FLAT,
    PROMISED,
    Damping,
    Linearized,
    damped_step,
    held_at_bounds,
)
from sim.model.film_nodes import FilmNodes
from sim.model.links import Links, links_of, shown_output
from sim.model.ohmmeter import Ohmmeter, before_ranges, shown_in_rows
from sim.model.plate_path import PlatePath
from sim.model.recorded import COARSE, Spacing

GAP = 4.0  # times the noise that the errors of two ranges are apart, from which a reading tells its range
FEWEST_ROUNDS, MOST_ROUNDS = 2, 6  # of a problem that is linear only about a solution
SAME_COST = 1.0  # by which another round changes it, from which the solution stays
SAME_SHARE = 3e-3  # the same of what the cost is beyond the noise's own
SHARES_OF_WAY = (0.5, 0.25, 0.1, 0.03)  # to a solution that is worse than the guess it is linear about
AS_LINEAR = 0.01  # by which the ohmmeter's bends change the cost of a solution, below which no other round follows
STEPS, SETTLED = 12, 0.05  # of a descent; log-likelihood that the last one gains: no decision hangs on it
SAME_EVIDENCE = 0.02  # by which other widths of the priors change it, from which they stay
TURN = 2  # steps after which the room's own slopes are computed anew: half the work of a step, and they change slowly
LONGEST = 1.0  # step of an unknown: of a logarithm, a kelvin
SETTLE, EACH = 3, 2 * TURN  # turns of the widths before and after a descent; steps of it after which they follow
DAMPING = Damping(least=1e-9, least_after_failure=1e-6, trials=6)
TRUSTED = 4.0  # mean square residual over noise below which the model's resistance heats the film, not the measured one


@dataclass(frozen=True, eq=False)
class ResistanceChannel(FilmEquations):
    """The equations with the readings that they are fitted to. fitted: the readings that count; rows: of these; output:
    all readings, 0 where there is none; whitening: of the fitted rows; plane: the relays in the rows; problems: the
    last one."""

    noise: NoiseModel
    fitted: Mask
    rows: Rows
    output: Array
    whitening: Whitens
    plane: RelaysOfRecord
    problems: deque[LinearProblem] = field(default_factory=lambda: deque(maxlen=1), init=False)

    @classmethod
    def of(
        cls,
        record: Record,
        path: PlatePath,
        fitted: Mask,
        noise: NoiseModel,
        basis: FilmBasis,
        relays: bool = True,
        spacing: Spacing = COARSE,
    ) -> ResistanceChannel:
        """fitted: the rows that count, as far as they have a reading."""
        assert record.output is not None
        fitted = fitted & record.output_used
        rows, output = np.flatnonzero(fitted), np.nan_to_num(record.output)
        whitening = noise.on(rows, output[rows])
        plane = RelaysOfRecord(basis.plane, record.taken_s, rows, whitening)
        readings = straight_readings(record)
        return cls(record, path, basis, readings, relays, spacing, noise, fitted, rows, output, whitening, plane)

    def point_of(self, fit: ResistanceFit) -> Point:
        """The point that a fit of this channel is."""
        return self.point(fit.parameters, fit.parameters.x, fit.coefficients)

    def point(self, p: FilmParameters, x: Array, guess: Array | None = None) -> Point:
        """The best coefficients at x."""
        links, nodes = self.nodes(p, x)
        step = self.step(p, x, nodes.film_degC[nodes.taken])
        relays = self.plane.at(links, nodes, step) if self.relay_count(p) else self.plane.none
        signals = self._signals(p, links, nodes, x)
        rows, y, coefficients = self.rows, self.output, guess
        film = nodes.of_rows(signals)
        if links.linear and not p.is_mixed:
            at_rows = Ohmmeter(links, nodes, np.empty(0)).columns(signals)
            problem = self._problem(at_rows, np.zeros(y.size), film, relays, None)
            return problem.solved(x, p.prior.precision(self.basis, problem))
        bends = links.bends or p.is_mixed
        least, most = (FEWEST_ROUNDS, MOST_ROUNDS) if bends else (1, 1)
        before = math.inf
        for turn in range(most):
            known = coefficients[: signals.shape[1]] if coefficients is not None else np.empty(0)
            guessed = known.size == signals.shape[1]
            if coefficients is not None and guessed:
                of_relays = coefficients[coefficients.size - relays.count :]
                whole = signals @ known + nodes.at_points(relays.film @ of_relays)
                curve = self._curve(signals, known)
            else:
                own = np.interp(nodes.points_s, self.record.time_s, self._film_output(p))
                whole, curve = self.phases(p, x).unmixed(own), np.zeros(own.size)
            signal, slope = self._mixed(p, x, curve, whole)
            ohmmeter = Ohmmeter(links, nodes, signal)
            shown = self._seen(relays, slope, ohmmeter, links, nodes)
            at_rows = ohmmeter.columns(self._about(signals, slope))
            if coefficients is not None and guessed:
                linear = at_rows[:, : known.size] @ known + shown.shown(of_relays)
            else:
                linear = ohmmeter.plain((whole if slope is None else whole * slope)[:, None])[:, 0]
            first, *other_ranges = self._ranges(links, nodes, signal)
            offset = shown_in_rows(links, nodes, signal, first) - linear
            problem = self._problem(at_rows, offset, film, shown, first)
            found = problem.solved(x, p.prior.precision(self.basis, problem))
            for range_of in other_ranges:
                offset = shown_in_rows(links, nodes, signal, range_of) - linear
                other = problem.shifted(offset, y, range_of).solved(x, found.prior)
                found = min(found, other, key=lambda point: point.cost)
            if p.is_mixed:
                straight = found.cost
                found = self._nearer(p, links, nodes, signals, found, coefficients if guessed else None)
                bent = abs(found.cost - straight)
            else:
                bent = self._bent(p, links, nodes, signals, found) if first is None else math.inf
            if first is None and bent < AS_LINEAR:
                break
            coefficients, guessed = found.coefficients, True
            same = max(SAME_COST, SAME_SHARE * (found.cost - 0.5 * rows.size))
            if turn + 1 >= least and abs(found.cost - before) < same:
                break
            before = found.cost
        return found

    def _problem(
        self, at_rows: Array, offset: Array, film: Array, relays: Relays, range_of: Array | None
    ) -> LinearProblem:
        """With its products, which are those of the last one where that has the same columns."""
        for last in self.problems:
            if last.at_rows is at_rows and last.relays is relays:
                return last.shifted(offset, self.output, range_of)
        found = LinearProblem.of(at_rows, offset, film, relays, self.output, self.rows, self.whitening, range_of)
        self.problems.append(found)
        return found

    def _about(self, signals: Array, slope: Array | None) -> Array:
        """The film's columns as its output changes with them about a guess. slope: with all but D, (points,)."""
        if slope is None:
            return signals
        mixed = signals * slope[:, None]
        mixed[:, 1 : self.basis.free] = signals[:, 1 : self.basis.free]
        return mixed

    def _seen(self, relays: Relays, slope: Array | None, ohmmeter: Ohmmeter, links: Links, nodes: FilmNodes) -> Relays:
        """The relays as the ohmmeter shows them about a signal. slope: of the film's output with them, (points,)."""
        if not relays.count or (ohmmeter.slope is None and slope is None):
            return relays
        if not links.meter_lags:
            slopes = [each for each in (slope, ohmmeter.slope) if each is not None]
            return relays.seen_by(np.prod(slopes, axis=0)[nodes.rows], self.rows, self.whitening)
        film = relays.film if slope is None else relays.film * slope[nodes.rows, None]
        every = ohmmeter.of_rows(film, self.record.taken_s)
        return replace(relays, every=every).seen_by(None, self.rows, self.whitening)

    def _bent(self, p: FilmParameters, links: Links, nodes: FilmNodes, signals: Array, found: Point) -> float:
        """By how much the cost of a problem's solution changes where the ohmmeter is not linear about a guess."""
        shown = self._shown(p, links, nodes, signals, found, found.coefficients)
        bent, straight = self._over_noise(shown), self._over_noise(found.shown)
        return abs(0.5 * float(bent @ bent) - 0.5 * float(straight @ straight))

    def _shown(
        self, p: FilmParameters, links: Links, nodes: FilmNodes, signals: Array, found: Point, c: Array
    ) -> Array:
        """What is shown in all rows with these coefficients, whatever bends it."""
        problem = found.problem
        film, own = signals.shape[1], problem.own.shape[1]
        whole = signals @ c[:film] + nodes.at_points(problem.relays.film @ c[own:])
        signal, _ = self._mixed(p, found.x, self._curve(signals, c), whole)
        return shown_in_rows(links, nodes, signal, problem.range_of) + problem.at_rows[:, film:] @ c[film:own]

    def _nearer(
        self, p: FilmParameters, links: Links, nodes: FilmNodes, signals: Array, found: Point, guess: Array | None
    ) -> Point:
        """The solution of a linear problem with what it shows in truth, or so much of the way to it from the guess that
        the cost falls: where much is left, a film that percolates bends more than a straight line tells."""

        def at(c: Array) -> Point:
            shown = self._shown(p, links, nodes, signals, found, c)
            residual = self._over_noise(shown)
            cost = 0.5 * float(residual @ residual) + 0.5 * float(found.prior @ c**2)
            return replace(found, coefficients=c, shown=shown, cost=cost if math.isfinite(cost) else math.inf)

        solution = at(found.coefficients)
        if guess is None:
            return solution
        best, way = at(guess), found.coefficients - guess
        for share in SHARES_OF_WAY:
            if solution.cost < best.cost:
                return solution
            solution = at(guess + share * way)
        return solution if solution.cost < best.cost else best

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

    def descend(
        self, p: FilmParameters, steps: int = STEPS, tolerance: float = SETTLED, settle: bool = True
    ) -> ResistanceFit:
        """The local minimum reached from p, with the priors' widths settled on the way.

        Of the penalized cost, except where an effect bends what relays show: a larger one leaves their coefficients
        less room, and the cost alone would end at a fraction of its size (0.3 of a series resistance beside a Preisach
        film). There it is the marginal likelihood.
        """
        low, high, h = self.bounds(p)
        point = self.point(p, np.clip(p.x, low, high))
        p, point = self._settled(p, point, SETTLE if settle else 0)
        damping = DAMPING.first
        jacobian, room = np.zeros((self.record.rows, p.x.size)), np.zeros(p.x.size)
        nonlinear = p.nonlinear if p.has_relays else []

        def loss(at: Point) -> float:
            return -at.evidence if nonlinear else at.cost

        for iteration in range(steps):
            if iteration % TURN == 0:  # points beside it, and their room, are linear about their own solution
                point = self._about_itself(p, point)
            slopes = self._slopes(p, point, (low, high, h), [] if iteration % TURN else nonlinear, jacobian)
            room = room if iteration % TURN else slopes
            about = self._projected(point, jacobian)
            normal, gradient = about.normal, about.gradient - room
            held_at_bounds(normal, gradient, point.x, low, high)
            scale = np.maximum(np.diag(normal), FLAT * float(np.max(np.diag(normal))) + 1e-30)  # > 0
            ends = np.maximum(low - point.x, -LONGEST), np.minimum(high - point.x, LONGEST)
            step = Linearized(normal, gradient, scale, partial(self._moved, p, about), FLAT, ends)
            before, settled = loss(point), tolerance * self._misfit(point)
            point, damping = damped_step(point, loss, step, damping, DAMPING, PROMISED * settled)
            if links_of(p.effects).heated and 2.0 * point.cost < TRUSTED * self.rows.size:
                p = replace(p, film_output=self.heated_by(p, point))
            if settle and iteration % EACH == EACH - 1:
                point = self._about_itself(p, point)
                p, point = self._settled(p, point, 1)
            elif before - loss(point) < settled:
                break
        point = self._about_itself(p, point)
        p, last = self._settled(p, point, SETTLE if settle else 0)
        # linear about the solution of other widths, the evidence of a mixing was 30 off
        point = self._about_itself(p, last) if last is not point and p.is_mixed else last
        found = replace(p, effects=tuple(self.split(p, point.x)[0]), x=point.x)
        minus_log = 0.5 * float(np.sum(self._over_noise(point.shown) ** 2))
        output, c = self.film_output(p, point), point.coefficients
        return ResistanceFit(found, point.shown, output, point.evidence, c, jacobian.copy(), minus_log, point.cost)

    def _about_itself(self, p: FilmParameters, point: Point) -> Point:
        """The point with all that is linear only about a guess taken about its own solution; itself where all is."""
        links = links_of(p.effects)
        same = links.linear and not links.heated and not p.is_mixed
        return point if same else self.point(p, point.x, point.coefficients)

    def _misfit(self, point: Point) -> float:
        """How many times the noise's own variance is left, at least 1: a gain counts by what is left."""
        return max(1.0, 2.0 * point.cost / self.rows.size)

    def _moved(self, p: FilmParameters, about: Projected, move: Array) -> Point:
        """The point after a step."""
        return self.point(p, about.point.x + move, about.coefficients(move))

    def following(self, fit: ResistanceFit) -> Callable[[Array], Array]:
        """The coefficients that a fit's become where its x moves by so much."""
        return self._projected(self.point_of(fit), fit.jacobian).coefficients

    def _projected(self, point: Point, jacobian: Array) -> Projected:
        return Projected.about(point, self.over(jacobian[self.rows]), self._over_noise(point.shown))

    def _slopes(
        self,
        p: FilmParameters,
        point: Point,
        bounds: tuple[Array, Array, Array],
        nonlinear: list[int],
        jacobian: Array,
    ) -> Array:
        """d shown / d x by difference quotients, into jacobian (rows, unknowns); returned is by how much the room that
        the coefficients leave changes with those of x that bend the reading."""
        (low, high, h), relays, room = bounds, self.of_relays(p, point.x, point), np.zeros(point.x.size)
        base = self.predict(p, point.x, point, relays)
        for k in range(point.x.size):
            if low[k] == high[k]:
                jacobian[:, k] = 0.0
                continue
            moved = point.x.copy()
            moved[k] += h[k] if moved[k] + h[k] <= high[k] else -h[k]
            change = self.predict(p, moved, point, relays if k < ENVELOPES else None) - base
            jacobian[:, k] = change / (moved[k] - point.x[k])
            if k in nonlinear:
                followed = point.nearest(point.along(self.over(change[self.rows])))
                other = self.point(p, moved, point.coefficients - followed)
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
            if other.evidence <= point.evidence + SAME_EVIDENCE:
                break
            p, point = replace(p, prior=wider), other
        return p, point

    def mean_square(self, fit: ResistanceFit) -> float:
        """Of the residual over the noise, in the fitted rows."""
        return 2.0 * fit.minus_log / self.rows.size

    def residual(self, fit: ResistanceFit) -> Array:
        """In units of the noise, in the fitted rows."""
        return self._over_noise(fit.shown)
