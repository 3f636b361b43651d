"""The film as a linear problem: what each coefficient adds to the film's own output, node by node.

With the temperature of the film given, the output is linear in the weights of the play operators and in the
coefficients of D; filters (creep, a meter's lag) act on each column alone. Only the envelopes and the effects' own
parameters are not linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from compensator.compiled import njit
from compensator.hysteresis.functions import ENVELOPE_CODES, Array
from sim.model.film_nodes import FilmNodes
from sim.model.operator_outputs import envelopes_along, operator_outputs

KNOTS = 7  # of a smooth D over the record's range, which bends less often
SIMPLE = 3  # degree of what D has of simple form
GRID = 400


def operator_columns(nodes: FilmNodes, shape: Array, radii: Array, function: str) -> Array:
    """Return each operator's output at the points, shape (points, operators). shape: (log a_R, c_R, log a_L, c_L) of
    envelopes of a function."""
    inputs, side = film_path(nodes)
    gamma = envelopes_along(inputs, side, shape, float(ENVELOPE_CODES[function]))
    rows = nodes.points + (inputs.size - nodes.time_s.size)
    out = np.empty((rows.size, radii.size))
    operator_outputs(gamma, side, radii, 1.0, rows, out)
    return out


def play_columns(nodes: FilmNodes, half_width_K: Array) -> Array:
    """Return classical play operators F_h[T] at the points, degC, shape (points, operators)."""
    inputs, side = film_path(nodes)
    rows = nodes.points + (inputs.size - nodes.time_s.size)
    out = np.empty((rows.size, half_width_K.size))
    operator_outputs(inputs, side, half_width_K, np.inf, rows, out)
    return out


def film_path(nodes: FilmNodes) -> tuple[Array, NDArray[np.int8]]:
    """Return the film's temperatures after the turning points before the first row, and the directions of the steps."""
    inputs, side, before = nodes.film_degC, nodes.side, len(nodes.turned_degC)
    if not before:
        return inputs, side
    inputs = np.concatenate((nodes.turned_degC, inputs))
    turns = np.sign(np.diff(inputs[: before + 1]))
    return inputs, np.concatenate((side[:1], turns, side[1:])).astype(np.int8)


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """Any smooth D(T) on a range: cubic splines, as many as tell any of the named forms within 1e-4 of its span.

    Its columns are Legendre's polynomials of degree 1 to 3 over the range, and then what else the splines can do, each
    of mean square 1 about: a curve of simple form has coefficients of the first few only. knots: (knots,), evenly
    spaced; cubics: of each column between two of them, (knots - 1, 4, columns), highest power first.
    """

    knots: Array
    cubics: Array

    @classmethod
    def over(cls, low: float, high: float, count: int = KNOTS) -> SmoothCurve:
        inner = np.linspace(low, high, count)
        knots = np.concatenate(([low] * 3, inner, [high] * 3))
        design = _splines(knots, np.linspace(low, high, GRID))
        x = np.linspace(-1.0, 1.0, GRID)
        simple = np.stack([legval(x, [0.0] * k + [1.0]) for k in range(SIMPLE + 1)], axis=1)
        simple = np.linalg.qr(simple)[0] * np.sqrt(GRID)
        others = np.linalg.svd(design - simple @ (simple.T @ design) / GRID, full_matrices=False)[0]
        wanted = np.concatenate((simple[:, 1:], np.sqrt(GRID) * others[:, : design.shape[1] - SIMPLE]), axis=1)
        mix = np.linalg.lstsq(np.column_stack((design, np.ones(GRID))), wanted, rcond=None)[0][:-1]
        spline = BSpline(knots, np.vstack((np.zeros(mix.shape[1]), mix)), 3)
        cubics = np.stack([spline(inner[:-1], nu) / math.factorial(nu) for nu in (3, 2, 1, 0)], axis=1)
        cubics[:, 3] -= np.sum(mix, axis=0) / (mix.shape[0] + 1)  # less their mean, as the splines are
        return cls(inner, cubics)

    @property
    def count(self) -> int:
        """How many columns."""
        return int(self.cubics.shape[2])

    def columns(self, temperature: Array) -> Array:
        """Return the columns, shape (samples, count), without the constant."""
        out = np.empty((temperature.size, self.count))
        cubic_columns(self.knots, self.cubics, temperature, out)
        return out

    def values(self, temperature: Array, coefficients: Array) -> Array:
        """Return the columns times coefficients, shape (samples,)."""
        out = np.empty((temperature.size, 1))
        cubic_columns(self.knots, (self.cubics @ coefficients)[:, :, None], temperature, out)
        return out[:, 0]


@njit
def cubic_columns(knots: Array, cubics: Array, temperature: Array, out: Array) -> None:
    """Cubics between evenly spaced knots, into out (samples, columns); constant beyond the ends, no number of none."""
    low, high, last = knots[0], knots[-1], knots.size - 2
    width = (high - low) / (last + 1)
    for k in range(temperature.size):
        if math.isnan(temperature[k]):
            out[k] = math.nan
            continue
        inside = min(max(temperature[k], low), high)
        at = min(int((inside - low) / width), last)
        u = inside - knots[at]
        for j in range(out.shape[1]):
            out[k, j] = ((cubics[at, 0, j] * u + cubics[at, 1, j]) * u + cubics[at, 2, j]) * u + cubics[at, 3, j]


def _splines(knots: Array, temperature: Array) -> Array:
    """Return cubic B-splines but the first, less their mean; beyond the ends constant."""
    inside = np.clip(temperature, knots[0], knots[-1])
    count = knots.size - 4
    design = BSpline(knots, np.eye(count), 3)(inside)
    return np.asarray(design[:, 1:] - 1.0 / count, dtype=np.float64)
