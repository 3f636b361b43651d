"""Preisach density of a film: a sum of smooth relays, and what it is for a fit, a simulation and a model file.

    u(T) = sum_j p_j tanh(s_j (F_h[T] - c)),   p_j >= 0

F_h is the classical play operator of radius h (K), so that each term is a smooth relay: it switches up around a = c + h
and down around b = c - h (I. D. Mayergoyz, Mathematical Models of Hysteresis (Elsevier 2003), ch. 1). It equals a
generalized play operator of radius 0 with gamma_R = tanh(s (T - a)) and gamma_L = tanh(s (T - b)); gamma_R <= gamma_L
everywhere, so that the order condition below paper eq (6) holds.

The thresholds a lie where the output changes while heating, b where it changes while cooling, closer where it is
steep.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.film import Envelope
from compensator.hysteresis.functions import Array
from sim.inference.joint.domains import Relays
from sim.model.operator_outputs import Integers

BY_OUTPUT: Final = 0.8  # share of the thresholds placed by the output's change; the others evenly over the range
STEPS: Final = 8  # relays of no width over the range, which bend D where its form does not
BINS: Final = 200  # of the range, in which a branch's change is summed up
SPREAD_OVER: Final = 24, 5  # sharp relays for a smooth one: along its step, and to the next half-widths


@dataclass(frozen=True, eq=False)
class PreisachDensity:
    """Smooth relays: centre (degC), slope (1/K) and half-width (K) of each, shape (relays,)."""

    centre: Array
    slope: Array
    half_width: Array

    @classmethod
    def between(cls, up: Array, down: Array, steps: Array, steepness: float) -> PreisachDensity:
        """Return the relays between thresholds of either sense, rising, (degC), and some of no width at `steps`.
        steepness: slope of each, times the distance of its thresholds from their neighbours."""
        apart = np.sqrt(np.outer(np.gradient(up), np.gradient(down)))
        a, b = np.meshgrid(up, down, indexing="ij")
        kept = a > b
        return cls(
            np.concatenate((0.5 * (a + b)[kept], steps)),
            steepness / np.concatenate((apart[kept], np.gradient(steps))),
            np.concatenate((0.5 * (a - b)[kept], np.zeros(steps.size))),
        )

    def outputs(self, plays: Callable[[Array], Array]) -> Array:
        """Return each relay's output, shape (readings, relays). plays: of some half-widths (widths,) the classical play
        operators' outputs, degC, shape (readings, widths)."""
        widths, place = np.unique(self.half_width, return_inverse=True)
        return np.asarray(np.tanh(self.slope * (plays(widths)[:, place] - self.centre)), dtype=np.float64)

    def only(self, kept: Integers | NDArray[np.bool_]) -> PreisachDensity:
        """Return some of the relays."""
        return PreisachDensity(self.centre[kept], self.slope[kept], self.half_width[kept])

    def envelopes(self) -> tuple[tuple[Envelope, ...], tuple[Envelope, ...]]:
        """Return the rising and falling envelopes of operators of radius 0 that are these relays."""
        pairs = zip(self.centre.tolist(), self.slope.tolist(), self.half_width.tolist(), strict=True)
        both = [(Envelope("tanh", s, -s * (c + h)), Envelope("tanh", s, -s * (c - h))) for c, s, h in pairs]
        return tuple(rising for rising, _ in both), tuple(falling for _, falling in both)

    def sharp(self, weights: Array) -> Relays:
        """Return sharp relays of about this density. weights: of the smooth ones."""
        along, across = SPREAD_OVER
        share = (2.0 * np.arange(along) + 1.0) / along - 1.0
        centre = self.centre[:, None, None] + np.arctanh(share)[:, None] / self.slope[:, None, None]
        wider = 0.5 * np.linspace(-1.0, 1.0, across) / self.slope[:, None, None]
        centre, width = np.broadcast_arrays(centre, np.abs(self.half_width[:, None, None] + wider))
        weight = np.broadcast_to(2.0 / (along * across) * weights[:, None, None], centre.shape)
        some = weight > 0.0
        return Relays((centre + width)[some], (centre - width)[some], weight[some])


def relays_over(degC: Array, output: Array, thresholds: int, steepness: float) -> PreisachDensity:
    """Return the relays between so many thresholds of either sense, placed for readings, (readings,). steepness: as of
    `PreisachDensity.between`."""
    steps = np.linspace(float(np.min(degC)), float(np.max(degC)), STEPS + 2)[1:-1]
    up, down = (_thresholds(degC, output, thresholds, sense) for sense in (1.0, -1.0))
    return PreisachDensity.between(up, down, steps, steepness)


def _thresholds(degC: Array, output: Array, count: int, sense: float) -> Array:
    """Temperatures between which the output changes by about as much in each, while it goes in a sense; (count,)."""
    edges = np.linspace(float(np.min(degC)), float(np.max(degC)), BINS + 1)
    density = slope_density(degC, output, edges, sense=sense)
    cumulative = np.concatenate(([0.0], np.cumsum(density) / np.sum(density)))
    place = BY_OUTPUT * cumulative + (1.0 - BY_OUTPUT) * np.linspace(0.0, 1.0, edges.size)
    return np.interp((np.arange(count) + 0.5) / count, place, edges)


def slope_density(degC: Array, output: Array, edges: Array, sense: float | None = None) -> Array:
    """Return the mean d output / dT >= 0 in each temperature bin, from readings at least half a bin's width apart.

    sense: 1 heating alone, -1 cooling alone, None both.
    """
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(degC)))))
    coarse = np.flatnonzero(np.diff(np.floor(2.0 * travel / float(edges[1] - edges[0])), prepend=-1.0) > 0)
    v, dv, dy = degC[coarse], np.diff(degC[coarse]), np.diff(output[coarse])
    middle = 0.5 * (v[1:] + v[:-1])
    if sense is not None:
        own = np.sign(dv) == sense
        middle, dv, dy = middle[own], dv[own], dy[own]
    size = edges.size - 1
    place = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, size - 1)
    moved = np.bincount(place, weights=np.abs(dv), minlength=size)
    changed = np.bincount(place, weights=np.maximum(np.sign(dv) * dy, 0.0), minlength=size)
    return np.asarray(changed / np.maximum(moved, 1e-9) + 1e-12, dtype=np.float64)
