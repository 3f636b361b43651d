"""Fits seen by what is left of them: what one more effect would change that nothing fitted can follow.

The change of the fitted rows by the effect, over the noise, is projected off the slopes of everything that is free; of
what is left, half the square is the log-likelihood that a fit without the effect is expected to lose, and its product
with the residual says whether the record asks for it (score test).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.temperature_channel import FIRST_STEP_K, TemperatureChannel, TemperatureFit
from sim.diagnosis.fit.unknowns import STEP
from sim.effects.effect import Switched

NOTHING = 1e-9  # a square in units of the noise's: what changes the rows less changes nothing


class FirstView:
    """A fit seen by what is left of it once plate, first temperatures and everything fitted may follow."""

    def __init__(self, channel: TemperatureChannel, fit: TemperatureFit) -> None:
        self._channel, self.fit, p = channel, fit, fit.parameters
        rows = channel.rows
        weight = np.sqrt(channel.weight)
        self.residual = channel.residual(fit) * weight
        columns = channel.over(fit.jacobian[rows]) * weight[:, None]
        moved = channel.simulate(p, p.x, p.first_degC + FIRST_STEP_K)[1][rows] - fit.shown_degC[rows]
        self._e = e = channel.over(moved) * weight / FIRST_STEP_K
        self._d = np.bincount(channel.stretch, e * e, channel.stretches) + 1e-12  # > 0 of one without readings
        nuisance = np.stack([self._off_firsts(c) for c in columns.T], axis=1)
        norms = np.linalg.norm(nuisance, axis=0)
        self._q = np.linalg.qr(nuisance[:, norms > 0.0] / norms[norms > 0.0])[0]

    def _off_firsts(self, column: Array) -> Array:
        """What is left of a column in the fitted rows once each stretch's first temperature may follow."""
        stretch, e = self._channel.stretch, self._e
        share = np.bincount(stretch, e * column, self._channel.stretches) / self._d
        return np.asarray(column - e * share[stretch], dtype=np.float64)

    def left_of(self, effect: Switched) -> Array:
        """What one more effect, in place of one of the same name, changes in the fitted rows, over the noise."""
        channel, fit, rows = self._channel, self.fit, self._channel.rows
        others = [e for e in fit.effects if e.name != effect.name]
        trial = channel.extended(fit.parameters, [*others, effect])
        shown = channel.simulate(trial, trial.x, fit.parameters.first_degC)[1]
        delta = self._off_firsts(channel.over(shown[rows] - fit.shown_degC[rows]) * np.sqrt(channel.weight))
        return np.asarray(delta - self._q @ (self._q.T @ delta), dtype=np.float64)


class View:
    """A fit seen by what is left of it once the film's coefficients and everything fitted may follow."""

    def __init__(self, channel: ResistanceChannel, fit: ResistanceFit) -> None:
        p = fit.parameters
        self._channel, self.fit = channel, fit
        self._point = channel.point(p, p.x, fit.coefficients)
        rows = channel.rows
        self.residual = channel.over(channel.output[rows] - self._point.shown[rows])
        # what changes is counted from what is computed the same way: a point chooses the meter's ranges by itself
        self._base = channel.predict_from(p, fit, near=self._point.problem.relays)[0]
        outer = self._point.off(channel.over(fit.jacobian[rows]))
        norms = np.linalg.norm(outer, axis=0)
        self._q = (
            np.linalg.qr(outer[:, norms > NOTHING] / norms[norms > NOTHING])[0]
            if np.any(norms > NOTHING)
            else np.zeros((rows.size, 1))
        )

    def expected(self, effect: Switched) -> float:
        """The log-likelihood that a fit which lacks this effect is expected to lose: what of it the film cannot do."""
        left = self.left_of(effect)
        return 0.5 * float(left @ left) if np.all(np.isfinite(left)) else 0.0

    def left_of(self, effect: Switched) -> Array:
        """What one more effect, in place of one of the same name, changes in the fitted rows, over the noise."""
        return self.left_of_each([effect])[:, 0]

    def left_of_each(self, effects: Sequence[Switched]) -> Array:
        """The same of several, each by itself, (rows, effects): the film's columns are read once for all of them."""
        channel, fit, rows = self._channel, self.fit, self._channel.rows
        near, changes = self._point.problem.relays, []
        for effect in effects:
            others = [e for e in fit.effects if e.name != effect.name]
            shown = channel.predict_from(channel.extended(fit.parameters, [*others, effect]), fit, near=near)[0]
            changes.append((shown - self._base)[rows])
        return self._left(channel.over(np.stack(changes, axis=1)))

    def gain_of_mixing(self) -> float:
        """The log-likelihood that the fit may gain where the phases of its film mix otherwise (score test)."""
        channel, p, rows = self._channel, self.fit.parameters, self._channel.rows
        shown, columns = channel.predict(p, p.x, self._point), []
        for k in range(ENVELOPES, SHAPE):
            x = p.x.copy()
            x[k] += STEP
            moved = channel.predict(replace(p, mixes=True), x, self._point)
            columns.append((moved - shown)[rows])
        left = self._left(channel.over(np.stack(columns, axis=1)))
        if not np.all(np.isfinite(left)):
            return 0.0
        return 0.5 * float(self.residual @ (left @ np.linalg.lstsq(left, self.residual)[0]))

    def _left(self, changes: Array) -> Array:
        """What is left of changes of the fitted rows, (rows, changes), over the noise, once everything that is free has
        followed."""
        changes = self._point.off(changes)
        return np.asarray(changes - self._q @ (self._q.T @ changes), dtype=np.float64)
