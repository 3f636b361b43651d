"""The fit of the first links to the thermometer's readings, by the simulation error over whole stretches.

The equations are `plate_equations`; here are the readings, their noise, what is known beforehand, and the cost. The
first temperatures of the stretches are many but each acts on its own stretch only, so that they are eliminated from the
normal equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.likelihood import Likelihood, likelihood, normal_residual
from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import Mask, Record, Rows
from sim.diagnosis.fit.known_beforehand import known_beforehand
from sim.diagnosis.fit.losses import Losses
from sim.diagnosis.fit.own_temperature import with_own_temperature
from sim.diagnosis.fit.plate_equations import PlateEquations
from sim.diagnosis.fit.plate_parameters import CONDUCTANCE, PlateParameters
from sim.diagnosis.fit.unknowns import along_values, fitted_sizes, logarithmic, unknowns_of
from sim.effects.effect import Switched
from sim.inference.levenberg_marquardt import (
    FLAT,
    PROMISED,
    Damping,
    Linearized,
    descend,
    held_at_bounds,
)
from sim.inference.noise import Noise, Readings, estimate
from sim.model.links import links_of
from sim.model.plate_path import PlatePath
from sim.model.recorded import COARSE, Spacing, driven_rows

DAMPING = Damping(least=1e-10, least_after_failure=1e-8, trials=7)
LONGEST_MOVE = 1.5  # of an unknown, in its own units: a factor of 4.5 of what is searched for by its logarithm
FIRST_STEP_K = 0.01  # of first temperatures in difference quotients: the plate is next to linear in them
FAR, STEP = 20.0, 1e-3  # of a body's or filter's own temperature, over `APART_K`: the furthest; of its differences
STEPS, SETTLED = 40, 1e-3  # of a descent, which costs little; log-likelihood that the last one gains


@dataclass(frozen=True, eq=False)
class TemperatureFit:
    """parameters; path: the plate's temperature; shown_degC (rows,); minus_log: of the likelihood over the rows that
    were fitted; slopes: what computes the jacobian, which most fits are not asked for; curvature: of the likelihood,
    over the noise."""

    parameters: PlateParameters
    path: PlatePath
    shown_degC: Array
    minus_log: float
    slopes: Callable[[], Array]
    curvature: Array

    @cached_property
    def jacobian(self) -> Array:
        """d shown / d x (rows, unknowns), in K."""
        return self.slopes()

    @property
    def effects(self) -> tuple[Switched, ...]:
        return self.parameters.effects


@dataclass(frozen=True, eq=False)
class _Trial:
    """A point of the descent: the fit's vector, the stretches' first temperatures, and what they give."""

    x: Array
    first_degC: Array
    path: PlatePath
    shown_degC: Array
    cost: float


class TemperatureChannel(PlateEquations):
    """Fits on one record. fitted: the rows that count; noise: by which they are weighed; step_K: of the quantization
    of readings with white noise.

    misfit: how many rows say as much as one of independent noise would: what no model explains goes on from row to row
    (`sim.diagnosis.data.misfit`). Above 1 the likelihood of the rows since a current first drove the plate is taken
    to the power of 1 / misfit, so that what is known beforehand of room, bodies and sizes counts for that much more.
    """

    def __init__(
        self,
        record: Record,
        fitted: Mask,
        noise: NoiseModel,
        step_K: float = 0.0,
        spacing: Spacing = COARSE,
        misfit: float = 1.0,
    ) -> None:
        super().__init__(record, spacing)
        self.noise, self.sigma_K = noise, noise.level
        self.step_K = step_K if noise.plain else 0.0
        self.misfit = misfit
        self.fitted = fitted & record.temperature_used
        self.rows = np.flatnonzero(self.fitted)
        self.stretch = np.searchsorted(record.first_rows, self.rows, side="right") - 1
        self.stretches = record.first_rows.size
        self.mean_degC = float(np.mean(record.temperature_degC[self.rows])) if self.rows.size else 0.0
        begins = np.diff(self.stretch, prepend=-1) > 0  # each stretch has a temperature of its own
        self._whitening = noise.on(self.rows, record.temperature_degC[self.rows], begins)
        self.weight = np.where(driven_rows(record, record.joined)[self.rows], 1.0 / misfit, 1.0)

    def with_misfit(self, misfit: float) -> TemperatureChannel:
        """The same rows, of which so many say as much as one."""
        return TemperatureChannel(self.record, self.fitted, self.noise, self.step_K, self.spacing, misfit)

    def model_error(self, fit: TemperatureFit) -> Noise:
        """By how much the model of a fit is off since a current first drove the plate: the slow part of the noise that
        its residual shows; none where rows say as much as independent ones."""
        driven = driven_rows(self.record, self.record.joined)[self.rows]
        if self.misfit <= 1.0 or not np.any(driven):
            return Noise(self.sigma_K)
        rows = self.rows[driven]
        left = self.record.temperature_degC[rows] - fit.shown_degC[rows]
        part = np.searchsorted(self.record.joined, rows, side="right")
        readings = Readings.at(self.record.time_s[rows], np.diff(part, prepend=-1) > 0)
        return estimate(left, readings, self.sigma_K)

    def over(self, values: Array) -> Array:
        """Values of the fitted rows, (rows,) or (rows, columns), over the noise."""
        return self._whitening.over(values)

    def likelihood(self, shown: Array) -> Likelihood:
        """Of the fitted rows' readings for what is shown, (all rows,)."""
        readings = self.record.temperature_degC[self.rows]
        if self.noise.plain:
            return likelihood(readings, shown[self.rows], self.sigma_K, self.step_K)
        z = np.clip(self.over(readings - shown[self.rows]), -1e9, 1e9)  # a trial far off has a square
        return Likelihood(0.5 * z * z, z, np.ones_like(z))

    def in_its_stretches(self, fit: TemperatureFit) -> PlateParameters:
        """A fit's parameters, beginning where its path was where this record's stretches do: they may be others."""
        return replace(fit.parameters, first_degC=fit.path.at(self.record.time_s[self.record.first_rows]))

    def prior(self, p: PlateParameters, x: Array) -> tuple[Array, Rows, Array]:
        """What is known beforehand, as `sim.diagnosis.fit.known_beforehand` has it."""
        return known_beforehand(x, len(p.base), p.rooms, p.effects, self._owns(p.effects), self.misfit > 1.0)

    def priors(self, p: PlateParameters) -> float:
        """Logarithm of what is known beforehand."""
        away = self.prior(p, p.x)[0]
        return -0.5 * float(away @ away)

    def cost(self, p: PlateParameters, x: Array, shown: Array) -> float:
        like = self.likelihood(shown)
        away = self.prior(p, x)[0]
        total = float(self.weight @ like.minus_log) + 0.5 * float(away @ away)
        return total if math.isfinite(total) else math.inf

    def bounds(self, p: PlateParameters) -> tuple[Array, Array, Array]:
        """Least, largest and step of each unknown."""
        unknowns = [*p.base, *unknowns_of(p.effects)]
        own = p.x.size - len(unknowns)
        low = np.array([u.low for u in unknowns] + [-FAR] * own)
        high = np.array([u.high for u in unknowns] + [FAR] * own)
        if self.misfit > 1.0:  # there a size stands in for a cause: none beyond what is met
            for k, (u, q) in enumerate(zip(unknowns_of(p.effects), fitted_sizes(p.effects), strict=True), len(p.base)):
                high[k] = u.inside(q.largest)
                low[k] = -high[k] if q.signed else low[k]
        return low, high, np.array([u.step for u in unknowns] + [STEP] * own)

    def descend(self, p: PlateParameters, steps: int = STEPS, tolerance: float = SETTLED) -> TemperatureFit:
        """The local minimum reached from p."""
        low, high, h = self.bounds(p)
        log = logarithmic([*p.base, *unknowns_of(p.effects)], p.x.size)

        def tried(x: Array, first: Array) -> _Trial:
            path, shown = self.simulate(p, x, first)
            return _Trial(x, first, path, shown, self.cost(p, x, shown))

        @np.errstate(over="ignore", invalid="ignore")  # a simulation with a step of an unknown may be without an end
        def linearized(at: _Trial) -> Linearized[_Trial]:
            x, first, shown = at.x, at.first_degC, at.shown_degC
            jacobian = self._slopes(p, at, high, h)
            by_first = self.simulate(p, x, first + FIRST_STEP_K)[1][self.rows] - shown[self.rows]
            e = self.over(by_first) / FIRST_STEP_K
            like = self.likelihood(shown)
            j = self.over(np.take(jacobian, self.rows, axis=0))
            w, pulled = self.weight * like.curvature, self.weight * like.pull
            away, index, scale = self.prior(p, x)
            gradient = j.T @ pulled
            gradient[index] -= scale * away
            normal = (w[:, None] * j).T @ j
            normal[index, index] += scale * scale
            d = np.bincount(self.stretch, w * e * e, self.stretches) + 1e-9  # > 0 of one without readings
            pull = np.bincount(self.stretch, e * pulled, self.stretches)
            by_x = self._by_stretch((w * e)[:, None] * j)
            losses = self._losses(p, x)
            normal, gradient, cross = losses.both_sides(normal), losses.along(gradient), losses.along(1.0 * by_x)
            reduced = normal - (cross / d) @ cross.T
            right = gradient - (cross / d) @ pull
            held_at_bounds(reduced, right, x, low, high)
            diagonal = np.maximum(np.diag(reduced), 1e-12 * np.diag(normal) + 1e-30)  # > 0 beside rounding

            def moved(move: Array) -> _Trial:
                to = np.clip(x + along_values(np.clip(move, -LONGEST_MOVE, LONGEST_MOVE), log), low, high)
                gone = to - x
                gone[losses.room] = move[losses.room]
                to[losses.room] = losses.room_after(move[losses.room], to)
                return tried(to, first + (pull - cross.T @ gone) / d)

            return Linearized(reduced, right, diagonal, moved, FLAT)

        start = tried(np.clip(p.x, low, high), p.first_degC.copy())
        best = descend(
            start,
            steps,
            lambda at: at.cost,
            linearized,
            # a gain counts by what is left, as in the last channel
            lambda before, after: before - after < tolerance * max(1.0, 2.0 * after / self.rows.size),
            DAMPING,
            PROMISED * tolerance,
        )
        return self._fit(p, best, high, h)

    def _by_stretch(self, columns: Array) -> Array:
        """Sums over the rows of each stretch, (columns, stretches)."""
        if self.stretches == 1:  # as most records are
            return np.asarray(np.sum(columns, axis=0)[:, None], dtype=np.float64)
        return np.array([np.bincount(self.stretch, column, self.stretches) for column in columns.T])

    def _losses(self, p: PlateParameters, x: Array) -> Losses:
        names = [u.name for u in p.base]
        return Losses(names.index(CONDUCTANCE), len(names) - 1, x, p.base[-1].inside(self.mean_degC))

    def at(self, p: PlateParameters) -> TemperatureFit:
        """The fit that these parameters are, with its slopes."""
        _, high, h = self.bounds(p)
        path, shown = self.simulate(p, p.x, p.first_degC)
        return self._fit(p, _Trial(p.x, p.first_degC, path, shown, math.nan), high, h)

    def _fit(self, p: PlateParameters, at: _Trial, high: Array, h: Array) -> TemperatureFit:
        like = self.likelihood(at.shown_degC)
        effects = self.split(p, at.x)[0]
        final = replace(p, effects=tuple(effects), x=at.x, first_degC=at.first_degC)
        minus_log = float(self.weight @ like.minus_log)
        if self.misfit > 1.0:  # there sizes that nobody meets count against an effect
            minus_log -= self.priors(final)
        slopes = partial(self._slopes, p, at, high, h)
        return TemperatureFit(final, at.path, at.shown_degC, minus_log, slopes, like.curvature)

    def _slopes(self, p: PlateParameters, at: _Trial, high: Array, h: Array) -> Array:
        """d shown / d x by difference quotients, (rows, unknowns). What is another one in each record or after each
        long gap is moved everywhere at once: it shows in its own rows alone."""
        x, first, shown = at.x, at.first_degC, at.shown_degC
        jacobian = np.empty((self.record.rows, x.size))
        of_thermometer = frozenset(e.name for e in links_of(p.effects).thermometer)
        owners = [e.name in of_thermometer for e in p.effects for _ in unknowns_of([e])]
        for k, only_shown in enumerate([False] * len(p.base) + owners):
            moved = x.copy()
            moved[k] += h[k] if moved[k] + h[k] <= high[k] else -h[k]
            other = self.simulate(p, moved, first, at.path if only_shown else None)[1]
            jacobian[:, k] = (other - shown) / (moved[k] - x[k])
        row, begin = np.arange(self.record.rows), len(p.base) + len(owners)
        own_ones = [(self.anew, e.name in of_thermometer) for e in with_own_temperature(p.effects)]
        for firsts, only_shown in ((self.record.joined, False), *own_ones):
            if not firsts.size:
                continue
            own = slice(begin, begin + firsts.size)
            step = np.where(x[own] + h[own] <= high[own], h[own], -h[own])
            moved = x.copy()
            moved[own] += step
            changed = self.simulate(p, moved, first, at.path if only_shown else None)[1] - shown
            mine = np.searchsorted(firsts, row, side="right")[:, None] == 1 + np.arange(firsts.size)
            jacobian[:, own] = np.where(mine, changed[:, None], 0.0) / (moved[own] - x[own])
            begin += firsts.size
        return jacobian

    def residual(self, fit: TemperatureFit) -> Array:
        """In units of the noise, in the fitted rows."""
        if not self.noise.plain:
            return self.over((self.record.temperature_degC - fit.shown_degC)[self.rows])
        return normal_residual(
            self.record.temperature_degC[self.rows], fit.shown_degC[self.rows], self.sigma_K, self.step_K
        )
