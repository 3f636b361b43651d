"""Mixed envelopes: a dictionary of operators that differ in centre and half-width, fitted by their weights alone.

An operator of radius 0 with gamma_R = tanh(a (v - c - h)) and gamma_L = tanh(a (v - c + h)) equals
tanh(a (F_h[v] - c)), F_h the classical play operator of radius h (K): a smooth relay that switches up around c + h
and down around c - h. A film of any distribution of such switching temperatures (a Preisach film) is therefore a sum
of them, and its weights p >= 0 a convex problem without local minima. Centres lie where the output changes, closer
where it is steep, and slopes follow their spacing; which spacing is left to held-out rows. gamma_R <= gamma_L
everywhere, so that the order condition below paper eq (6) always holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.multistart import half_width_of_change, slope_density
from sim.inference.film.rows import Path
from sim.inference.nnls import solve_triangle
from sim.inference.triangle import triangle
from sim.model.operator_outputs import Integers, operator_outputs

WIDTHS: Final = np.array(  # of the loop's half-width, closest about it, where a steep transition has all its relays
    [0.0, 0.25, 0.5, 0.65, 0.75, 0.85, 0.95, 1.05, 1.15, 1.3, 1.5, 1.8, 2.1, 2.6, 3.2]
)
RESOLUTIONS: Final = (
    (8, 1.0, 0.8, False),
    (12, 0.8, 0.8, False),
    (16, 0.8, 0.8, False),
    (24, 0.8, 0.8, False),
    (24, 1.2, 0.8, False),
    (8, 1.0, 0.8, True),
    (12, 0.8, 0.8, True),
    (16, 0.8, 0.8, True),
    (24, 0.8, 0.8, True),
)  # centres, slope times spacing, share of centres placed by the output's change rather than evenly, whether moved


@dataclass(frozen=True, eq=False)
class Dictionary:
    """Operators: centre (degC), slope (1/K) and half-width (K) of each, shape (operators,)."""

    centre: Array
    slope: Array
    half_width: Array

    def outputs(self, path: Path) -> Array:
        """Operator outputs at the readings, shape (readings, operators)."""
        widths, place = np.unique(self.half_width, return_inverse=True)
        plays = np.empty((path.rows.size, widths.size))
        group = np.zeros(widths.size, dtype=np.int64)
        gamma = np.ascontiguousarray(path.inputs[:, None])
        operator_outputs(gamma, path.side, widths, group, np.inf, path.rows, plays)
        return np.asarray(np.tanh(self.slope * (plays[:, place] - self.centre)), dtype=np.float64)

    def only(self, kept: Integers) -> Dictionary:
        return Dictionary(self.centre[kept], self.slope[kept], self.half_width[kept])


def half_loop_width(path: Path) -> float:
    """Half the distance (K) between the temperatures at which half of the change is seen while heating and while
    cooling. A relay switches at its own two temperatures in minor loops too; a mean of the branches would not."""
    span = float(np.ptp(path.inputs[path.rows]))
    half = half_width_of_change(path)
    return min(max(half, 0.01 * span), 0.2 * span) if math.isfinite(half) else 0.05 * span


def dictionary(
    path: Path, centres: int, steepness: float, by_output: float, moved: bool, half_width: float
) -> Dictionary:
    """Centres x half-widths, placed for the record at hand. moved: half a width below what is seen while heating, and
    above what is seen while cooling, where relays of that width have their centres; else where the output changes,
    which serves a film of many widths."""
    v = path.inputs[path.rows]
    edges = np.linspace(np.min(v), np.max(v), 101)
    density = slope_density(path, edges, half_width if moved else 0.0)
    cumulative = np.concatenate(([0.0], np.cumsum(density) / np.sum(density)))
    place = by_output * cumulative + (1.0 - by_output) * np.linspace(0.0, 1.0, edges.size)
    centre = np.interp((np.arange(centres) + 0.5) / centres, place, edges)
    slope = steepness / np.gradient(centre)
    widths = half_width * WIDTHS
    return Dictionary(np.tile(centre, widths.size), np.tile(slope, widths.size), np.repeat(widths, centres))


@dataclass(frozen=True, eq=False)
class MixedSolution:
    """The fitted dictionary, its inactive operators left out. `residual`: y - fit, shape (readings,).

    Centres, slopes, half-widths and D's shape were chosen, not fitted: a band from `jacobian` holds them fixed.
    """

    operators: Dictionary
    weights: Array
    form: Form
    shape: Array  # D's nonlinear parameters
    coefficients: Array
    offset: float
    residual: Array

    @property
    def square(self) -> float:
        return float(np.mean(self.residual**2))

    def at(self, path: Path) -> Array:
        """The fit at another path's readings, shape (readings,)."""
        v = path.inputs[path.rows]
        memoryless = self.form.columns(v, self.shape) @ self.coefficients
        return np.asarray(self.offset + memoryless + self.operators.outputs(path) @ self.weights, dtype=np.float64)

    @property
    def outer_names(self) -> tuple[str, ...]:
        return ()

    @property
    def outer_values(self) -> Array:
        return np.empty(0)

    @property
    def parameters(self) -> int:
        return self.weights.size + int(np.sum(self.coefficients != 0.0)) + 1

    def play_outputs(self, path: Path) -> Array:
        """Operator outputs at the path's readings, shape (readings, operators)."""
        return self.operators.outputs(path)

    def jacobian(self, path: Path) -> Array:
        """Offset, D's coefficients, active weights: shape (readings, parameters)."""
        v = path.inputs[path.rows]
        memoryless = self.form.columns(v, self.shape)[:, self.coefficients != 0.0]
        return np.concatenate((np.ones((v.size, 1)), memoryless, self.operators.outputs(path)), axis=1)

    def model(self, output: str, initial: str) -> FilmModel:
        o = self.operators
        rows = zip(o.centre, o.slope, o.half_width, strict=True)
        pairs = [(float(a), float(a * (c + h)), float(a * (c - h))) for c, a, h in rows]
        return FilmModel(
            np.zeros(len(pairs)),
            self.weights,
            tuple(Envelope("tanh", a, -up) for a, up, _ in pairs),
            tuple(Envelope("tanh", a, -down) for a, _, down in pairs),
            self.form.memoryless(self.coefficients, self.shape, self.offset),
            "mixed_envelopes",
            output,
            "heated" if initial == "heated" else "cooled",
        )


def solve_mixed(path: Path, operators: Dictionary, form: Form, shape: Array) -> MixedSolution:
    """The best weights of a dictionary, with D of the given form and shape."""
    memoryless = form.columns(path.inputs[path.rows], shape)
    columns = np.concatenate((memoryless, operators.outputs(path), path.output[:, None]), axis=1)
    mean = columns.mean(axis=0)
    centred = columns - mean
    k = memoryless.shape[1]
    x, _ = solve_triangle(triangle(centred), 0 if form.monotone else k)
    kept = np.flatnonzero(x[k:] > 1e-6 * float(np.sum(x[k:])))
    x_kept = np.append(x[:k], x[k:][kept])
    index = np.append(np.arange(k), k + kept)
    offset = float(mean[-1] - mean[index] @ x_kept)
    residual = centred[:, -1] - centred[:, index] @ x_kept
    return MixedSolution(operators.only(kept), x[k:][kept], form, shape, x[:k], offset, residual)
