"""The first-order reversal curves of a record and their distribution, from the readings alone, never from a model.

    rho(T_r, T) = -+ 1/2 d2 log10 R / dT_r dT

with the sign that makes it positive where the film switches: minus for curves of cooling of a film whose R falls on
heating, plus for curves of heating. A curve begins where the film turns round at T_r on a major branch, and ends where
it turns round again. At each place of a grid a polynomial of the second degree in (T_r, T) is fitted to the readings of
all curves within a window, with weights (1 - u^2)^2 that fade; its mixed coefficient gives rho, its residuals the error
of rho. Where a window does not hold `LEAST_CURVES` curves, rho is nan.

Sources: I. D. Mayergoyz, Phys. Rev. Lett. 56 (1986) 1518; C. R. Pike, A. P. Roberts, K. L. Verosub, J. Appl. Phys. 85
(1999) 6660 (the local fit); J. G. Ramirez, A. Sharoni, Y. Dubi, M. E. Gomez, I. K. Schuller, Phys. Rev. B 79 (2009)
235110 (of VO2).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.functions import Array
from sim.inference.readings.output_sense import output_falls
from sim.inference.readings.temperature_path import temperature_path
from sim.inference.transition.transition import WHOLE, Run, Sense, onward_rows, runs_of

FEWEST_CURVES: Final = 7  # of a diagram: fewer show no more than a few sections of it
LEAST_CURVES: Final = 3  # of a window: a bend along T_r needs three
LEAST_ROWS: Final = 12  # of a window: twice the fit's coefficients
LEAST_SPAN: Final = 0.05  # of the record's range: a shorter curve is a ripple
CURVE_ROWS: Final = 150  # of a curve: of more, means of neighbours
APART: Final = 2.1  # median distances of the curves' T_r to either side: five curves in a window
ALONG: Final = 0.05  # of the range, at least, along T
PLACES: Final = 60  # of the grid, along each axis
TINY: Final = 1e-12  # of a fit's own scale, added so that a window with few rows still has a solution
BRANCH: Final = 0.12  # of the range: a run that begins this near to an end came from a major branch's beginning


@dataclass(frozen=True, eq=False)
class Forc:
    """sense: of the curves after the reversal; reversal_degC: T_r of each curve; grids of T_r and T, shape (places,)
    each; density and half of its 95 % interval, decades (or the output's unit) per K^2, shape (T_r, T), nan where the
    record says nothing; window_K: half widths along T_r and T. reason: why there is no diagram, else empty."""

    sense: Sense
    reversal_degC: Array
    grid_reversal_degC: Array
    grid_degC: Array
    density: Array
    half_width: Array
    window_K: tuple[float, float]
    reason: str = ""

    def peak(self) -> tuple[float, float, float] | None:
        """Return (T_r, T, rho) where rho is largest; None where it is nowhere."""
        if not np.any(np.isfinite(self.density)):
            return None
        i, j = np.unravel_index(int(np.nanargmax(self.density)), self.density.shape)
        return float(self.grid_reversal_degC[i]), float(self.grid_degC[j]), float(self.density[i, j])


def forc(time_s: ArrayLike, temperature_degC: ArrayLike, output: ArrayLike, *, in_decades: bool = True) -> Forc:
    """Of a record: arrays of shape (rows,), s, degC, and -log10(R / 1 ohm) or another output; nan where none is."""
    path = temperature_path(time_s, temperature_degC)
    v, y = path.temperature_degC, np.asarray(output, dtype=np.float64)
    log = -y if in_decades else y
    families: dict[Sense, list[tuple[float, Array, Array]]] = {"cooling": [], "heating": []}
    for before, run in _pairs(runs_of(v, path.noise_K), v):
        rows = onward_rows(v, run)
        rows = rows[np.isfinite(log[rows])]
        if rows.size >= LEAST_ROWS and abs(v[run.last] - v[run.first]) >= LEAST_SPAN * np.ptp(v):
            groups = np.array_split(rows, min(CURVE_ROWS, rows.size))
            means = [np.array([float(np.mean(values[group])) for group in groups]) for values in (v, log)]
            families["cooling" if before.heating else "heating"].append((float(v[run.first]), means[0], means[1]))
    sense: Sense = max(families, key=lambda one: _inside(families[one], v))
    curves = families[sense]
    if _inside(curves, v) < FEWEST_CURVES:
        text = f"the record holds {_inside(curves, v)} first-order reversal curves; expected at least {FEWEST_CURVES}: "
        text += "from the cold end to many temperatures in the transition, and back each time"
        return _nothing(sense, np.array([curve[0] for curve in curves]), text)
    falls = output_falls([(v, log)])
    return _diagram(sense, curves, v, -0.5 if (sense == "cooling") == falls else 0.5)


def _pairs(runs: list[Run], v: Array) -> list[tuple[Run, Run]]:
    """Return (run along a major branch, the run after its reversal), of all runs in the order of time.

    A run is on the major branch where it begins at the end of the record's range that is opposite to its sense.
    """
    low, high = float(v.min()), float(v.max())
    near = BRANCH * (high - low)
    found = []
    for before, run in pairwise(runs):
        begins = v[before.first] <= low + near if before.heating else v[before.first] >= high - near
        if begins:
            found.append((before, run))
    return found


def _inside(curves: list[tuple[float, Array, Array]], v: Array) -> int:
    """Return how many curves have a T_r of their own, and are not the other major branch."""
    own = [curve[0] for curve in curves if np.ptp(curve[1]) < WHOLE * np.ptp(v)]
    return int(np.unique(np.round(np.array(own) / (0.005 * np.ptp(v)))).size) if own else 0


def _nothing(sense: Sense, reversal: Array, reason: str) -> Forc:
    none = np.empty((0, 0))
    return Forc(sense, reversal, np.empty(0), np.empty(0), none, none, (0.0, 0.0), reason)


def _diagram(sense: Sense, curves: list[tuple[float, Array, Array]], v: Array, factor: float) -> Forc:
    """Return the local fits over the grid; factor: of the mixed derivative."""
    reversal = np.array([curve[0] for curve in curves])
    order = np.unique(np.round(np.sort(reversal), 6))
    apart = APART * float(np.median(np.diff(order)))
    along = max(ALONG * float(np.ptp(v)), apart)
    number = np.concatenate([np.full(curve[1].size, k) for k, curve in enumerate(curves)])
    x = reversal[number]
    t = np.concatenate([curve[1] for curve in curves])
    z = np.concatenate([curve[2] for curve in curves])
    grid_x = np.linspace(float(reversal.min()), float(reversal.max()), PLACES)
    grid_t = np.linspace(float(t.min()), float(t.max()), PLACES)
    density, half = np.full((PLACES, PLACES), np.nan), np.full((PLACES, PLACES), np.nan)
    for i, place in enumerate(grid_x):
        near = np.flatnonzero(np.abs(x - place) < apart)
        for j, at in enumerate(grid_t):
            if (at > place) == (sense == "cooling"):
                continue  # before the reversal
            rows = near[np.abs(t[near] - at) < along]
            if rows.size >= LEAST_ROWS and np.unique(number[rows]).size >= LEAST_CURVES:
                a, b = (x[rows] - place) / apart, (t[rows] - at) / along
                mixed, error = _mixed(a, b, z[rows], number[rows])
                density[i, j], half[i, j] = factor * mixed / (apart * along), 0.98 * error / (apart * along)
    return Forc(sense, reversal, grid_x, grid_t, density, half, (apart, along))


def _mixed(a: Array, b: Array, z: Array, curve: NDArray[np.int64]) -> tuple[float, float]:
    """Return the coefficient of a b in a local fit of the second degree, and its standard error: residuals of one curve
    are taken to be as alike as they are (a sandwich over the curves: K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986)
    13)."""
    weight = ((1.0 - a * a) * (1.0 - b * b)) ** 2
    columns = np.stack([np.ones_like(a), a, b, a * a, b * b, a * b], axis=1)
    normal = columns.T @ (weight[:, None] * columns)
    normal[np.diag_indices_from(normal)] += TINY * np.trace(normal)
    solved = np.linalg.solve(normal, columns.T * weight)
    coefficients = solved @ z
    left = (z - columns @ coefficients) * solved[5]
    parts = np.bincount(curve - int(curve.min()), weights=left)
    present = np.unique(curve).size
    spread = float(np.sum(parts**2)) * present / max(present - 1, 1)
    return float(coefficients[5]), float(np.sqrt(spread))
