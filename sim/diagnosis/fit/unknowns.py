"""What a fit looks for, as one vector: parameters on a scale on which a step is a step everywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask
from sim.effects.effect import Effect, Parameter, Switched
from sim.model.film_mixing import MOST_CHANGE, MOST_EXPONENT, MOST_PERCOLATION

LEAST_LEFT = 0.2  # of a value, after a step
BEYOND, ABOVE = 30.0, 10.0  # times below and above the sizes met, where a fit may go
STEEP = (0.5, 200.0)  # least and most of a flank's slope, over the range of temperatures
STEP = 1e-3  # of a difference quotient, of a value or its usual size: curvature and rounding are both below 1e-6


@dataclass(frozen=True)
class Unknown:
    """One number: log(value) if `log`, else value / scale. step: for difference quotients, on that scale."""

    name: str
    log: bool
    scale: float
    low: float
    high: float
    step: float

    def inside(self, value: float) -> float:
        """The value on the fit's scale."""
        return float(np.log(value)) if self.log else value / self.scale

    def outside(self, x: float) -> float:
        """The value itself."""
        return float(np.exp(x)) if self.log else x * self.scale


def positive(name: str, smallest: float, largest: float) -> Unknown:
    """A number > 0 between two bounds."""
    return Unknown(name, True, 1.0, float(np.log(smallest)), float(np.log(largest)), STEP)


def free(name: str, scale: float, low: float = -np.inf, high: float = np.inf, step: float = STEP) -> Unknown:
    """A number of either sign and a usual size."""
    return Unknown(name, False, scale, low / scale, high / scale, step)


def envelope_unknowns(plate_degC: Array) -> list[Unknown]:
    """Steepness and centre of either branch's envelope, over a record's temperatures."""
    low_T, high_T = float(np.min(plate_degC)), float(np.max(plate_degC))
    span = high_T - low_T
    a = positive("a", STEEP[0] / span, STEEP[1] / span)
    c = free("c", 1.0, low_T - 0.5 * span, high_T + 0.5 * span)
    return [a, c, a, c]


def mixing_unknowns(mixed: bool) -> list[Unknown]:
    """How the phases of a film mix, or that they do not."""
    both = {"change": MOST_CHANGE, "exponent": MOST_EXPONENT}
    signed = [free(f"mixing.{name}", 1.0, -most * mixed, most * mixed) for name, most in both.items()]
    return [*signed, free("mixing.percolation", 1.0, 0.0, MOST_PERCOLATION * mixed)]


def unknown_of(effect: Effect, parameter: Parameter) -> Unknown:
    """The unknown of an effect's parameter."""
    return _unknown(effect.name, parameter)


@lru_cache(maxsize=256)  # asked for at every trial of a descent
def _unknown(effect: str, parameter: Parameter) -> Unknown:
    name = f"{effect}.{parameter.name}"
    if parameter.signed:
        scale = float(np.sqrt(parameter.smallest * parameter.largest))
        return free(name, scale, -ABOVE * parameter.largest, ABOVE * parameter.largest)
    return positive(name, parameter.smallest / BEYOND, parameter.largest * ABOVE)


def fitted_parameters(effect: Effect) -> list[Parameter]:
    """The parameters that a descent moves: not those with a choice of values."""
    return [p for p in effect.parameters if not p.choices]


def unknowns_of(effects: Sequence[Switched]) -> list[Unknown]:
    """The unknowns of several effects, in order."""
    return [unknown_of(e.effect, p) for e in effects for p in fitted_parameters(e.effect)]


def fitted_sizes(effects: Sequence[Switched]) -> list[Parameter]:
    """The parameters of `unknowns_of`, in the same order."""
    return [p for e in effects for p in fitted_parameters(e.effect)]


def met_inside(unknown: Unknown, parameter: Parameter) -> tuple[float, float]:
    """The smallest and the largest size met on the fit's scale, of a signed one from the largest below 0 on."""
    low = -parameter.largest if parameter.signed else parameter.smallest
    return unknown.inside(low), unknown.inside(parameter.largest)


def with_values(effects: Sequence[Switched], x: Array) -> list[Switched]:
    """The effects with the parameters of a fit's vector."""
    out, k = [], 0
    for e in effects:
        par = e.par.copy()
        for j, p in enumerate(e.effect.parameters):
            if not p.choices:
                par[j] = unknown_of(e.effect, p).outside(float(x[k]))
                k += 1
        out.append(Switched(e.effect, par))
    return out


def values_inside(effects: Sequence[Switched]) -> Array:
    """The effects' parameters as a fit's vector."""
    return np.array(
        [
            unknown_of(e.effect, p).inside(float(e.par[j]))
            for e in effects
            for j, p in enumerate(e.effect.parameters)
            if not p.choices
        ]
    )


def logarithmic(unknowns: Sequence[Unknown], count: int) -> Mask:
    """Which of a fit's vector of so many numbers, unknowns first, are on a log scale."""
    return np.array([u.log for u in unknowns] + [False] * (count - len(unknowns)))


def along_values(move: Array, log: Mask) -> Array:
    """A step on the fit's scale that is one along the values themselves: what unknowns cancel of each other is
    linear in these."""
    return np.where(log, np.log1p(np.maximum(move, LEAST_LEFT - 1.0)), move)
