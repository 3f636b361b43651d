"""Preisach density: what relays, each switching up and down at temperatures of its own, add to a PI film.

    u(T) = PI film + sum over (a, b) of p_ab tanh(s_ab (F_h[T] - c)),   p_ab >= 0,   c = (a + b) / 2,   h = (a - b) / 2

The relays are those of `sim.inference.film.preisach_density`. The weights have a normal prior, whose width is the one
that predicts held-out rows best: relays that a record does not determine stay small, and what is left there is the PI
film, its weights fitted anew with those of the relays. The problem has one minimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.multistart import slope_density
from sim.inference.film.preisach_density import PreisachDensity
from sim.inference.film.rows import Path
from sim.inference.film.variable_projection import PlainFit
from sim.inference.nnls import reduced, solve_triangle
from sim.model.operator_outputs import operator_outputs

THRESHOLDS: Final = (12, 18, 24, 36)  # of either sense: half finer each, up to what half a second can compute
BY_OUTPUT: Final = 0.8  # share of the thresholds placed by the output's change; the others evenly over the range
STEEPNESS: Final = 0.8  # of a relay's step, times the distance of thresholds: the sum of neighbours is then smooth
STEPS: Final = 8  # relays of no width over the range, which bend D where its form does not
BINS: Final = 200  # of the range, in which a branch's change is summed up
WIDTHS: Final = np.geomspace(1.0, 1000.0, 7)  # of the prior, over the noise: up to a whole film in one relay
NEGLIGIBLE: Final = 1e-6  # of all weights: below it a relay counts as absent


def relays_over(path: Path, thresholds: int, steepness: float = STEEPNESS) -> PreisachDensity:
    """Return the relays between so many thresholds of either sense, placed for the records at hand."""
    v = path.inputs[path.rows]
    steps = np.linspace(float(np.min(v)), float(np.max(v)), STEPS + 2)[1:-1]  # of no width: what D lacks
    up, down = (_thresholds(path, thresholds, sense) for sense in (1.0, -1.0))
    return PreisachDensity.between(up, down, steps, steepness)


def relay_outputs(relays: PreisachDensity, path: Path) -> Array:
    """Return each relay's output at the readings, shape (readings, relays)."""

    def plays(widths: Array) -> Array:
        out = np.empty((path.rows.size, widths.size))
        group = np.zeros(widths.size, dtype=np.int64)
        operator_outputs(np.ascontiguousarray(path.inputs[:, None]), path.side, widths, group, np.inf, path.rows, out)
        return out

    return relays.outputs(plays)


def _thresholds(path: Path, count: int, sense: float) -> Array:
    """Temperatures between which the output changes by about as much in each, while it goes in a sense; (count,)."""
    v = path.inputs[path.rows]
    edges = np.linspace(float(np.min(v)), float(np.max(v)), BINS + 1)
    density = slope_density(path, edges, sense=sense)
    cumulative = np.concatenate(([0.0], np.cumsum(density) / np.sum(density)))
    place = BY_OUTPUT * cumulative + (1.0 - BY_OUTPUT) * np.linspace(0.0, 1.0, edges.size)
    return np.interp((np.arange(count) + 0.5) / count, place, edges)


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """The fitted operators of a PI film and the relays with it, those without weight left out. plain: the PI film,
    whose envelopes and form of D are kept; pi_weights: of its operators, (operators,), 0 where one has none; plane: all
    relays; width: of their prior, as in `fit_plane`; parameters: the effective number of them, as far as the readings
    and not the prior determine them.

    Envelopes, thresholds, slopes and D's shape were chosen, not fitted: a band from `jacobian` holds them fixed.
    """

    plain: PlainFit
    pi_weights: Array
    relays: PreisachDensity
    weights: Array
    coefficients: Array
    offset: float
    parameters: float
    plane: PreisachDensity
    width: float

    @property
    def form(self) -> Form:
        """Of D."""
        return self.plain.form

    @property
    def operators(self) -> int:
        """How many operators have weight."""
        return int(np.sum(self.pi_weights > 0.0)) + self.weights.size

    @property
    def outer_names(self) -> tuple[str, ...]:
        """There are no nonlinear parameters."""
        return ()

    @property
    def outer_values(self) -> Array:
        """There are none."""
        return np.empty(0)

    def at(self, path: Path) -> Array:
        """Return the fit at another path's readings, shape (readings,)."""
        memoryless = self.form.columns(path.inputs[path.rows], self.plain.shape) @ self.coefficients
        weights = np.append(self.pi_weights[self.pi_weights > 0.0], self.weights)
        return np.asarray(self.offset + memoryless + self.play_outputs(path) @ weights, dtype=np.float64)

    def play_outputs(self, path: Path) -> Array:
        """Return each operator's output at the readings, shape (readings, operators)."""
        plays = self.plain.play_outputs(path)[:, self.pi_weights > 0.0]
        return np.concatenate((plays, relay_outputs(self.relays, path)), axis=1)

    @property
    def precision(self) -> Array:
        """Return the precision of the prior of all parameters, over that of the readings: 0 but for the relays'."""
        others = 1 + int(np.sum(self.coefficients != 0.0)) + int(np.sum(self.pi_weights > 0.0))
        return np.diag(np.append(np.zeros(others), np.full(self.weights.size, self.width**-2.0)))

    def jacobian(self, path: Path) -> Array:
        """Return the derivatives by the offset, D's coefficients and the weights, shape (readings, parameters)."""
        v = path.inputs[path.rows]
        memoryless = self.form.columns(v, self.plain.shape)[:, self.coefficients != 0.0]
        return np.concatenate((np.ones((v.size, 1)), memoryless, self.play_outputs(path)), axis=1)

    def model(self, output: str, initial: str) -> FilmModel:
        """Return the film as a model with an envelope pair for each operator."""
        theta, active = self.plain.solution.theta, self.pi_weights > 0.0
        radii = self.plain.problem.structure.radii(self.plain.problem.shapes(theta))[0][active]
        a_r, a_l = math.exp(theta[0]), math.exp(theta[2])
        rising, falling = self.relays.envelopes()
        of_pi = Envelope("tanh", a_r, -a_r * float(theta[1])), Envelope("tanh", a_l, -a_l * float(theta[3]))
        rising, falling = (of_pi[0],) * radii.size + rising, (of_pi[1],) * radii.size + falling
        return FilmModel(
            np.append(radii, np.zeros(self.weights.size)),
            np.append(self.pi_weights[active], self.weights),
            rising,
            falling,
            self.form.memoryless(self.coefficients, self.plain.shape, self.offset),
            "mixed_envelopes",
            output,
            "heated" if initial == "heated" else "cooled",
        )


def fit_plane(path: Path, plane: PreisachDensity, plain: PlainFit, width: float) -> PlaneFit:
    """Return the likeliest weights of a PI film's operators, D and the relays. width: of the relays' prior, over the
    noise's standard deviation."""
    columns = _Columns(path, plane, plain)
    return columns.fit(columns.solved(width), width)


def fit_plane_judged(path: Path, judges: Path, plane: PreisachDensity, plain: PlainFit) -> tuple[PlaneFit, float]:
    """Return the fit whose width predicts the rows of `judges` best, and its RMS error there."""
    columns = _Columns(path, plane, plain)
    others = _columns(judges, plane, plain)
    tried: dict[int, tuple[float, Array]] = {}

    def error(place: int) -> float:
        if place not in tried:
            x = columns.solved(float(WIDTHS[place]))
            left = judges.output - columns.offset(x) - others[:, :-1] @ x
            tried[place] = math.sqrt(float(np.mean(left**2))), x
        return tried[place][0]

    place = WIDTHS.size // 2
    for step in (-1, 1):  # downhill from the middle
        while 0 <= place + step < WIDTHS.size and error(place + step) < error(place):
            place += step
    least, x = tried[place]
    return columns.fit(x, float(WIDTHS[place])), least


def _columns(path: Path, plane: PreisachDensity, plain: PlainFit) -> Array:
    """Columns of D, of the PI film's operators, of the relays, and the output, (readings, columns)."""
    memoryless = plain.form.columns(path.inputs[path.rows], plain.shape)
    plays = plain.play_outputs(path)
    return np.concatenate((memoryless, plays, relay_outputs(plane, path), path.output[:, None]), axis=1)


class _Columns:
    """The linear problem min |y - offset - D c - M p|^2 + |p|^2 / width^2 over p >= 0, the last term of the relays
    alone, for any width."""

    def __init__(self, path: Path, plane: PreisachDensity, plain: PlainFit) -> None:
        self.plane, self.plain = plane, plain
        columns = _columns(path, plane, plain)
        self.mean = columns.mean(axis=0)
        columns -= self.mean
        self.products = columns.T @ columns
        self.relays = slice(self.mean.size - 1 - plane.centre.size, self.mean.size - 1)
        self.d = self.relays.start - plain.problem.structure.group.size

    def solved(self, width: float) -> Array:
        """Return the coefficients of all columns but the output."""
        prior = np.zeros(self.mean.size)
        prior[self.relays] = width**-2.0
        unsigned = 0 if self.plain.form.monotone else self.d
        x, _ = solve_triangle(reduced(self.products + np.diag(prior)), unsigned)
        plays = x[self.d :]
        plays[plays <= NEGLIGIBLE * float(np.sum(plays))] = 0.0
        return x

    def offset(self, x: Array) -> float:
        """Return the offset that goes with some coefficients."""
        return float(self.mean[-1] - self.mean[:-1] @ x)

    def fit(self, x: Array, width: float) -> PlaneFit:
        """Return the fit with the coefficients of a width."""
        relays, d = self.relays, self.d
        kept = np.flatnonzero(x[relays])
        inner = self.products[np.ix_(relays.start + kept, relays.start + kept)]
        known = np.maximum(np.linalg.eigvalsh(inner), 0.0) * width**2
        return PlaneFit(
            self.plain,
            x[d : relays.start].copy(),
            self.plane.only(kept),
            x[relays][kept],
            x[:d].copy(),
            self.offset(x),
            1.0 + float(np.sum(x[: relays.start] != 0.0)) + float(np.sum(known / (1.0 + known))),
            self.plane,
            width,
        )
