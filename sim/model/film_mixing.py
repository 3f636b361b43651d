"""How the phases of a film add up to one resistance: logarithms, conductances, resistances, or anything in between.

A film of which a share s is metal, R_i(T) its insulator and R_m its metal, reads

    R^p = (1 - s) R_i(T)^p + s R_m^p        p = -1: domains in parallel; 1: in series; 0: logarithms add

(a power mean; G. Hardy, J. Littlewood, G. Polya, Inequalities, 1934, ch. 2). A model D(T) + N, N a sum of operators, is
p = 0 with an insulator and a metal that change alike with temperature. Two numbers tell the rest: by how much the step
from one phase to the other changes with temperature, and p.

    u = D(T) + (1 + change (T - middle) / farthest) N        y = B_p(u)

B_p takes the ends of a record's output to themselves, so that p changes the form between them and no scale; beyond the
ends it goes on straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading, Switched

MOST_CHANGE = 0.8  # of either sign: the step between the phases does not turn round
MOST_EXPONENT = 1.5  # of either sign: domains in series or in parallel, and half as much
FARTHEST_DEC = 15.0  # from 1 ohm: a trial of a fit beyond it has no resistance
LOGARITHMS = 1e-7  # exponent below which logarithms add


@dataclass(frozen=True)
class FilmMixing:
    """middle_degC: where the step's change is 0; farthest_K: the distance of a record's temperatures from there;
    low_dec, high_dec: ends of the output, which rises with the share that is metal."""

    middle_degC: float
    farthest_K: float
    low_dec: float
    high_dec: float

    def step(self, change: float, film_degC: Array) -> Array:
        """What the operators are multiplied by at the film's temperatures. change: of it over `farthest_K`."""
        away = (film_degC - self.middle_degC) / self.farthest_K
        return np.asarray(1.0 + change * np.clip(away, -1.0, 1.0), dtype=np.float64)

    def mixed(self, exponent: float, u: Array) -> Array:
        """B_p: the film's output, decades."""
        if abs(exponent) < LOGARITHMS:
            return u
        span, share = self.high_dec - self.low_dec, self._share(u)
        inside, rate = np.clip(share, 0.0, 1.0), math.log(10.0) * exponent * span
        y = -np.log1p(inside * math.expm1(-rate)) / rate
        slope = -math.expm1(-rate) / rate / (1.0 + inside * math.expm1(-rate))
        return np.asarray(self.low_dec + span * (y + (share - inside) * slope), dtype=np.float64)

    def unmixed(self, exponent: float, y: Array) -> Array:
        """u of an output; beyond the ends that of the end."""
        if abs(exponent) < LOGARITHMS:
            return y
        span = self.high_dec - self.low_dec
        rate = math.log(10.0) * exponent * span
        share = np.expm1(-rate * np.clip(self._share(y), 0.0, 1.0)) / math.expm1(-rate)
        return np.asarray(self.low_dec + span * share, dtype=np.float64)

    def reading(self, exponent: float) -> Switched:
        """B_p as the first thing that happens to what the operators add up to, on its way to the ohmmeter."""

        def read(par: Array, ohm: Array) -> Array:
            y = self.mixed(float(par[0]), -np.log10(ohm))
            return np.asarray(10.0 ** -np.clip(y, -FARTHEST_DEC, FARTHEST_DEC), dtype=np.float64)

        effect = Effect("mixing of the film's phases", "ohmmeter", (), Reading(read), "", "")
        return Switched(effect, np.array([exponent]))

    def _share(self, dec: Array) -> Array:
        return np.asarray((dec - self.low_dec) / (self.high_dec - self.low_dec), dtype=np.float64)
