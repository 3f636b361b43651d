"""Intervals of the effects' parameters, from the information matrix of the whitened likelihood (`Fit.covariance`)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.diagnosis.candidates import Directions
from sim.effects.effect import Command, Effect, jumps
from sim.inference.covariance import NORMAL_95
from sim.inference.joint.likelihood import Fit

Interval = tuple[float, float]
LESS_LIKELY: Final = 0.5 * NORMAL_95**2  # log-likelihood at an interval's ends
AROUND: Final = 3.0  # factor about a fit's value, within which a jumping parameter is looked for
LOOKED_AT: Final = 40  # values at once: a descent comes within a tenth
WIDEST: Final = 20.0  # standard deviations in a logarithm are cut here: exp() of more is no number to report


def intervals(fit: Fit) -> dict[str, dict[str, tuple[float, Interval | None]]]:
    """Each effect's parameters with their 95 % intervals; None where an interval has no meaning."""
    found: dict[str, dict[str, tuple[float, Interval | None]]] = {}
    errors = fit.covariance().standard_errors if fit.effects else np.empty(0)
    for effect in fit.effects:
        values = fit.values()[effect.name]
        if jumps(effect):
            jumping = Jumps(fit, effect)
            found[effect.name] = {jumping.parameter: (values[jumping.parameter], jumping.interval())}
            continue
        own: dict[str, tuple[float, Interval | None]] = {}
        for p in effect.parameters:
            at = fit.joint.place.get(f"{effect.name}.{p.name}")
            if at is None:
                own[p.name] = values[p.name], None
                continue
            reach = NORMAL_95 * min(float(errors[at]), 1e6)
            x = float(fit.at.x[at])
            if p.signed:
                own[p.name] = x, (x - reach, x + reach)
            else:
                reach = min(reach, WIDEST)
                own[p.name] = math.exp(x), (math.exp(x - reach), math.exp(x + reach))
        found[effect.name] = own
    return found


class Jumps:
    """The likelihood along a parameter at whose values the outcome jumps: between two of them it is level, and it has
    many maxima. All else follows."""

    def __init__(self, fit: Fit, effect: Effect) -> None:
        assert isinstance(effect.form, Command)
        assert effect.form.jumps is not None
        self.parameter = effect.parameters[0].name
        self._at, self._held = fit.at, fit.joint.place[f"{effect.name}.{self.parameter}"]
        self._directions = Directions(fit, fit.metric, fit.at)
        edges = np.unique(effect.form.jumps(fit.joint.record.commands[1]))
        self.edges = edges[edges > 0.0]  # value k lies below edge k

    def at_value(self, k: int) -> Array:
        """The fit's parameters with the parameter between two of its edges."""
        between = np.concatenate(([0.0], self.edges, [2.0 * self.edges[-1]]))
        x = self._at.x.copy()
        x[self._held] = math.log(0.5 * (between[k] + between[k + 1]))
        return x

    def falls(self, values: NDArray[np.int64]) -> Array:
        """By how much each is less likely than the fit; inf where that is not known."""
        falls = self._directions.falls([self.at_value(int(k)) for k in values])
        return np.where(np.isfinite(falls), falls, np.inf)

    def likeliest(self) -> Array:
        """The fit's parameters with the likeliest value about the fit's own."""
        low, high = np.searchsorted(self.edges, math.exp(self._at.x[self._held]) * np.array([1.0 / AROUND, AROUND]))
        while True:
            values = np.unique(np.linspace(low, high, LOOKED_AT).round().astype(np.int64))
            falls = self.falls(values)
            best = int(np.argmin(falls))
            if values.size < LOOKED_AT or falls[best] > 0.0:
                return self.at_value(int(values[best])) if falls[best] < 0.0 else self._at.x
            low, high = values[max(best - 1, 0)], values[min(best + 1, values.size - 1)]

    def middle(self) -> Array:
        """The fit's parameters with the value in the middle of its interval: where commands lie far apart, any other is
        as likely, and says less."""
        low, high = self.interval()
        return self.at_value(int(np.searchsorted(self.edges, 0.5 * (low + high))))

    def interval(self) -> Interval:
        """Out to where all further values are less likely by the chance of 95 %."""
        own = int(np.searchsorted(self.edges, math.exp(self._at.x[self._held])))
        ends = []
        for last in (0, self.edges.size):
            inside, outside = own, last
            step = 1
            while abs(last - inside) > step:  # farther and farther, until it is outside
                trial = inside + int(math.copysign(step, last - own))
                if self.falls(np.array([trial]))[0] > LESS_LIKELY:
                    outside = trial
                    break
                inside, step = trial, 2 * step
            while abs(outside - inside) > 1:
                trial = (inside + outside) // 2
                if self.falls(np.array([trial]))[0] > LESS_LIKELY:
                    outside = trial
                else:
                    inside = trial
            ends.append(inside)
        low = float(self.edges[ends[0] - 1]) if ends[0] > 0 else 0.0
        return low, float(self.edges[min(ends[1], self.edges.size - 1)])


def is_vague(interval: Interval | None, value: float) -> bool:
    """Return True if an interval says nothing of a size: it is wider than the size itself on either side."""
    return interval is not None and interval[1] - interval[0] > 2.0 * abs(value)
