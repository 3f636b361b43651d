"""Both channels as one fit: what the film tells of the plate.

A film on its loop is a thermometer too, often the sharper one. Where the simulated temperature drives the film, both
channels' residuals depend on the plate's unknowns, and one step of Gauss-Newton over the unknowns of both ends gives
what the fits one after the other have left: log-likelihood, values, and how well they are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_point import Point
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.temperature_channel import FIRST_STEP_K, TemperatureChannel, TemperatureFit
from sim.diagnosis.fit.unknowns import along_values, logarithmic, unknowns_of
from sim.diagnosis.search.temperature_search import held_effect, starting_values
from sim.diagnosis.search.views import NOTHING
from sim.effects.effect import Effect, Switched, switched
from sim.inference.levenberg_marquardt import Damping, Linearized, damped_step

MOST_STRETCHES = 30  # each costs two simulations a step
MOVED = 0.3  # of the noise, over all readings of the thermometer: the step of a difference quotient
LARGEST_STEP = 0.1  # the same of an unknown that hardly shows
LARGEST_MOVE = 1.5  # of an unknown in a step, as in the channels' own fits
SETTLED = 0.02  # log-likelihood that one more step would bring
TURNS = 4  # steps: from fits that have ended each for itself
DAMPING = Damping(first=1e-9, least=1e-9, more=30.0, least_after_failure=0.1, trials=3)  # undamped while that gains
TINY = 1e-30  # of a diagonal: what changes nothing does not move
FILM_STEPS = 2  # of the film, which follows the plate's step
HELD_STEPS = 6  # until everything else has followed an effect that is held
SMALL_SHARE = 0.03  # of a starting value
_Ends = tuple[TemperatureFit, ResistanceFit, ResistanceChannel]  # of both fits, the last one's on the first one's path


@dataclass(frozen=True, eq=False)
class JointFit:
    """Both fits, and both channels' slopes by all unknowns: the plate's, first temperatures, envelopes and the film's
    effects. over_T, over_R: in units of the noise, (rows, unknowns); free_R: what is left of over_R once the film's
    coefficients may follow; pull_T, z: what the rows ask for; normal, gradient: of the log-likelihood, priors included.
    """

    first: TemperatureChannel
    last: ResistanceChannel
    a: TemperatureFit
    b: ResistanceFit
    point: Point
    shown: Array
    over_T: Array
    weight_T: Array
    pull_T: Array
    over_R: Array
    free_R: Array
    z: Array
    normal: Array
    gradient: Array

    @property
    def score(self) -> float:
        """Log-likelihood of both channels as they are."""
        return self.b.score - self.a.minus_log

    def step(self) -> tuple[Array, float]:
        """The step of all unknowns, and the log-likelihood that it brings."""
        move = _solved(self.normal, self.gradient)
        return move, 0.5 * float(self.gradient @ move)

    def columns(self) -> tuple[Array, Array]:
        """Slopes and residuals of both channels' rows, one below the other, in units of the noise."""
        root = np.sqrt(self.weight_T)
        columns = np.concatenate((root[:, None] * self.over_T, self.free_R))
        return columns, np.concatenate((self.pull_T / np.maximum(root, 1e-9), self.z))  # > 0

    def score_test(self, effect: Effect) -> tuple[float, Switched]:
        """Log-likelihood that one more effect of the first links may bring with everything else free (score test from a
        small size), and the effect at the size at which it does."""
        best, at = 0.0, switched(effect, [p.smallest for p in effect.parameters])
        for start in starting_values(effect, self.a):
            scaled = [(k == 0 or p.signed) and not effect.inverse for k, p in enumerate(effect.parameters)]
            small = [SMALL_SHARE * v if s else v for v, s in zip(start, scaled, strict=True)]
            d_T, d_R, free = self._delta([*self.a.effects, switched(effect, small)])
            cross = self.over_T.T @ (self.weight_T * d_T) + self.over_R.T @ free
            if not np.all(np.isfinite(cross)):
                continue
            size = float(d_T @ (self.weight_T * d_T)) + float(d_R @ free) - float(cross @ _solved(self.normal, cross))
            along = float(d_T @ self.pull_T) + float(d_R @ self.z) - float(cross @ _solved(self.normal, self.gradient))
            if not size > NOTHING or not np.isfinite(size):
                continue
            times = along / size
            if (times > 0.0 or effect.parameters[0].signed) and 0.5 * along * times > best:
                best = 0.5 * along * times
                at = switched(effect, [times * v if s else v for v, s in zip(small, scaled, strict=True)])
        return best, at

    def _delta(self, effects: Sequence[Switched]) -> tuple[Array, Array, Array]:
        """What both channels' rows change by with other effects of the first links, over the noise."""
        trial = self.first.extended(self.a.parameters, effects)
        path, shown = self.first.simulate(trial, trial.x, trial.first_degC)
        d_T = self.first.over((shown - self.a.shown_degC)[self.first.rows])
        film = self.last.on(path).predict(self.b.parameters, self.b.parameters.x, self.point)
        d_R = self.last.over((film - self.shown)[self.last.rows])
        return d_T, d_R, self.point.off(d_R[:, None])[:, 0]


def joint_fit(
    first: TemperatureChannel, last: ResistanceChannel, a: TemperatureFit, b: ResistanceFit
) -> JointFit | None:
    """Both fits with their slopes; None where the film is of another kind, the record in too many stretches, or a slope
    without an end."""
    if b.parameters.has_relays or first.stretches > MOST_STRETCHES:
        return None
    p, q = a.parameters, b.parameters
    last = last.on(a.path)
    point = last.point(q, q.x, b.coefficients)
    shown = last.predict(q, q.x, point)
    rows, film_rows = first.rows, last.rows
    like = first.likelihood(a.shown_degC)
    by_x = first.over(a.jacobian[rows])
    norm = np.sqrt(np.einsum("rk,r,rk->k", by_x, like.curvature, by_x))
    _, high, _ = first.bounds(p)
    over_T, over_R = [*by_x.T], []
    for k in range(p.x.size):
        h = min(MOVED / max(float(norm[k]), TINY), LARGEST_STEP)
        h = h if p.x[k] + h <= high[k] else -h
        x = p.x.copy()
        x[k] += h
        path, _ = first.simulate(p, x, p.first_degC)
        over_R.append(last.over((last.on(path).predict(q, q.x, point) - shown)[film_rows]) / h)
    for k in range(p.first_degC.size):
        firsts = p.first_degC.copy()
        firsts[k] += FIRST_STEP_K
        path, readings = first.simulate(p, p.x, firsts)
        over_T.append(first.over((readings - a.shown_degC)[rows]) / FIRST_STEP_K)
        over_R.append(last.over((last.on(path).predict(q, q.x, point) - shown)[film_rows]) / FIRST_STEP_K)
    for column in b.jacobian[film_rows].T:
        over_T.append(np.zeros(rows.size))
        over_R.append(last.over(column))
    columns_T, columns_R = np.stack(over_T, axis=1), np.stack(over_R, axis=1)
    free_R = point.off(columns_R)
    z = last.over(last.output[film_rows] - point.shown[film_rows])
    normal = (like.curvature[:, None] * columns_T).T @ columns_T + columns_R.T @ free_R
    gradient = columns_T.T @ like.pull + columns_R.T @ z
    away, index, scale = first.prior(p, p.x)
    gradient[index] -= scale * away
    normal[index, index] += scale * scale
    if not (np.all(np.isfinite(normal)) and np.all(np.isfinite(gradient))):
        return None
    return JointFit(
        first, last, a, b, point, shown, columns_T, like.curvature, like.pull, columns_R, free_R, z, normal, gradient
    )


def _solved(normal: Array, right: Array) -> Array:
    norm = np.sqrt(np.maximum(np.diag(normal), TINY))
    damped = 0.5 * (normal + normal.T) / np.outer(norm, norm)
    damped[np.diag_indices_from(damped)] += DAMPING.first
    return np.asarray(cho_solve(cho_factor(damped, check_finite=False), right / norm) / norm, dtype=np.float64)


def settled(begin: JointFit) -> JointFit:
    """Step after step, until one more brings nothing."""
    best, level, first = begin, DAMPING.first, begin.first

    def cost(at: _Ends) -> float:
        a, b, _ = at
        return a.minus_log - b.score - first.priors(a.parameters)

    for _ in range(TURNS):
        if not best.step()[1] > SETTLED:
            break
        scale = np.maximum(np.diag(best.normal), TINY)
        about = Linearized(best.normal, best.gradient, scale, partial(_moved, best))
        ends, level = damped_step((best.a, best.b, best.last), cost, about, level, DAMPING)
        better = joint_fit(first, ends[2], ends[0], ends[1]) if ends[0] is not best.a else None
        if better is None:
            break
        best = better
    return best


def _moved(at: JointFit, move: Array) -> _Ends:
    """The fits after a step, the film's own unknowns followed."""
    p, q = at.a.parameters, at.b.parameters
    low, high, _ = at.first.bounds(p)
    low_R, high_R, _ = at.last.bounds(q)
    m, n = p.x.size, p.x.size + p.first_degC.size
    longest = float(np.max(np.abs(np.concatenate((move[:m], move[n:])))))
    move = move * min(1.0, LARGEST_MOVE / longest)
    log, log_R = logarithmic([*p.base, *unknowns_of(p.effects)], m), logarithmic(at.last.unknowns(q), q.x.size)
    x = np.clip(p.x + along_values(move[:m], log), low, high)
    a = at.first.at(replace(p, x=x, first_degC=p.first_degC + move[m:n]))
    x_R = np.clip(q.x + along_values(move[n:], log_R), low_R, high_R)
    last = at.last.on(a.path)
    b = last.descend(replace(q, x=x_R), FILM_STEPS)
    return a, replace(b, plain=b.parameters), last


def widened(at: JointFit, effect: Switched) -> JointFit | None:
    """The fits with one more effect of the first links, from a value of it at which everything else has followed."""
    held = Switched(held_effect(effect.effect), effect.par)
    near = at.first.descend(at.first.extended(at.a.parameters, [*at.a.effects, held]), HELD_STEPS)
    a = at.first.at(at.first.extended(near.parameters, [*at.a.effects, effect]))
    channel = at.last.on(a.path)
    b = channel.descend(at.b.parameters, FILM_STEPS)
    begin = joint_fit(at.first, channel, a, replace(b, plain=b.parameters))
    return settled(begin) if begin is not None else None
