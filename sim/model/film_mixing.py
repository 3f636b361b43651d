"""How the phases of a film add up to one resistance: logarithms, conductances, resistances, or anything in between.

A film of which a share s is metal, R_i(T) its insulator and R_m its metal, reads

    R^p = (1 - s) R_i(T)^p + s R_m^p        p = -1: domains in parallel; 1: in series; 0: logarithms add

(a power mean; G. Hardy, J. Littlewood, G. Polya, Inequalities, 1934, ch. 2). Where the metal percolates, p falls with
its share: below the threshold of a plane's effective medium R_i (1 - 2 s) is left, domains in series, above it the
metal's conductance times 2 s - 1, domains in parallel (D. Stroud, Phys. Rev. B 12 (1975) 3368). A model D(T) + N, N a
sum of operators, is p = 0 with an insulator and a metal that change alike with temperature. Three numbers tell the
rest: by how much the step from one phase to the other changes with temperature, p, and its tilt.

    u = D(T) + (1 + change (T - middle) / farthest) N        y = B(u)        p(s) = exponent + tilt (2 s - 1)

B takes the ends of a record's output to themselves, so that both change the form between them and no scale; beyond the
ends it goes on straight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading, Switched
from sim.model.ohmmeter import FARTHEST_DEC

MOST_CHANGE = 0.8  # of either sign: the step between the phases does not turn round
MOST_EXPONENT = 1.5  # of either sign: domains in series or in parallel, and half as much
MOST_TILT = 2.0  # of either sign: in series as long as few are metal, in parallel when most are, and as much again
LOGARITHMS = 1e-7  # exponent below which logarithms add
NEAR_END = 1e-6  # share, over which the slope beyond an end is taken
PLACES = 1001  # of a table
NEWTON_STEPS = 6  # from a table's place: digits double from three, and at an end the slope is of one side alone


@dataclass(frozen=True)
class PowerMean:
    """B. low_dec, high_dec: ends of the output, which rises with the share that is metal; exponent, tilt: p's."""

    low_dec: float
    high_dec: float
    exponent: float
    tilt: float

    def mixed(self, u: Array) -> Array:
        """The film's output, decades."""
        if self._logarithms:
            return u
        share = self._share(u)
        inside = np.clip(share, 0.0, 1.0)
        ends = np.array([0.0, NEAR_END, 1.0 - NEAR_END, 1.0])
        first, near_first, near_last, last = self._place(ends)
        slope = np.where(share < 0.0, near_first - first, last - near_last) / NEAR_END
        return self._output(self._place(inside) + (share - inside) * slope)

    def unmixed(self, y: Array) -> Array:
        """u of an output, straight between `PLACES` of it; beyond the ends that of the end."""
        if self._logarithms:
            return y
        share = np.linspace(0.0, 1.0, PLACES)
        there = np.maximum.accumulate(self._place(share))
        return self._output(np.interp(self._share(y), there, share))

    def inverse(self, y: Array) -> Array:
        """The u of which B is y, to 1e-12 of the ends' distance, straight beyond the ends; B has to rise."""
        if self._logarithms:
            return y
        share = np.linspace(0.0, 1.0, PLACES)
        wanted = self._share(y)
        found = np.interp(wanted, self._place(share), share)
        beyond = (wanted < 0.0) | (wanted > 1.0)
        for _ in range(NEWTON_STEPS):
            u = np.stack((found - NEAR_END, found, found + NEAR_END))
            before, here, after = self._share(self.mixed(self._output(u)))
            step = (wanted - here) * 2.0 * NEAR_END / (after - before)
            found = np.where(beyond, found + step, np.clip(found + step, 0.0, 1.0))
        return self._output(found)

    @property
    def rises(self) -> bool:
        """Whether more metal is always less resistance: p that rises steeply with the share would undo that."""
        return bool(np.all(np.diff(self._place(np.linspace(0.0, 1.0, PLACES))) > 0.0))

    def reading(self) -> Switched:
        """B as the first thing that happens to what the operators add up to, on its way to the ohmmeter."""

        def read(par: Array, ohm: Array) -> Array:
            return np.asarray(10.0 ** -np.clip(self.mixed(-np.log10(ohm)), -FARTHEST_DEC, FARTHEST_DEC))

        return Switched(Effect("mixing of the film's phases", "ohmmeter", (), Reading(read), "", ""), np.empty(0))

    @property
    def _logarithms(self) -> bool:
        return abs(self.exponent) + abs(self.tilt) < LOGARITHMS

    def _place(self, share: Array) -> Array:
        """Of the output between its ends at a share from 0 to 1."""
        rate = math.log(10.0) * (self.high_dec - self.low_dec) * (self.exponent + self.tilt * (2.0 * share - 1.0))
        flat = np.abs(rate) < LOGARITHMS
        rate = np.where(flat, 1.0, rate)
        return np.where(flat, share, -np.log1p(share * np.expm1(-rate)) / rate)

    def _share(self, dec: Array) -> Array:
        return np.asarray((dec - self.low_dec) / (self.high_dec - self.low_dec), dtype=np.float64)

    def _output(self, place: Array) -> Array:
        return np.asarray(self.low_dec + (self.high_dec - self.low_dec) * place, dtype=np.float64)


@dataclass(frozen=True)
class FilmMixing:
    """middle_degC: where the step's change is 0; farthest_K: the distance of a record's temperatures from there;
    low_dec, high_dec: ends of the output."""

    middle_degC: float
    farthest_K: float
    low_dec: float
    high_dec: float

    def step(self, change: float, film_degC: Array) -> Array:
        """What the operators are multiplied by at the film's temperatures. change: of it over `farthest_K`."""
        away = (film_degC - self.middle_degC) / self.farthest_K
        return np.asarray(1.0 + change * np.clip(away, -1.0, 1.0), dtype=np.float64)

    def mean(self, exponent: float, tilt: float) -> PowerMean:
        """How the phases add up."""
        return PowerMean(self.low_dec, self.high_dec, exponent, tilt)
