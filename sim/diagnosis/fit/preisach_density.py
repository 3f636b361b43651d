"""A film of another kind: a smooth density of relays over the whole Preisach plane, whatever its form.

N(c, h) = tanh((F_h[T] - c) / width of the grid) stand on a grid of centres c and half-widths h. What each adds has a
normal prior; its standard deviation falls off from the middle of the loop, and neighbours' are correlated (exponential
kernel): a density is smooth, but may bend anywhere. In the directions of the correlation matrix the prior is that of
independent columns of unlike width (C. Rasmussen, C. Williams, Gaussian Processes for Machine Learning, 2006, ch. 2 and
6); those with next to no variance are left out. One width for all is left, which a record decides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import Whitening
from sim.diagnosis.data.record import Rows
from sim.effects.effect import Switched
from sim.model.film_columns import play_outputs
from sim.model.film_nodes import FilmNodes
from sim.model.links import Effects, Links, columns_followed

CENTRES = WIDTHS = 24  # of the Preisach plane's grid: a fit costs the square of its 576 columns
PER_COLUMN = 2  # readings that a column needs at least; its prior does the rest
MOST_COLUMNS = 200
CLOSER_MIDDLE = 1.2  # how much closer the centres stand in the middle: sinh
CLOSER_NARROW = 2.2  # how much closer the half-widths stand where they are narrow: sinh
WIDEST = 0.2  # half-width, of the range of temperatures: of a film that is not understood, no loop's width is known
CORRELATED = (0.6, 0.3)  # over centres (-1 to 1) and half-widths (0 to 1): the kernel's lengths, 0.3 of either side
FALLS_OFF = 0.6  # standard deviation of the amplitude over the centres
STEEP = 0.9  # of a relay's step, times the distance of the centres
ROWS_AT_ONCE = 256  # times 576 relays in single precision stay in a processor's own cache


@dataclass(frozen=True, eq=False)
class RelayPlane:
    """centre_degC, slope_per_K, half_width_K: of each relay, (relays,); mix: from columns to relays, (relays, columns),
    for columns of one prior width."""

    centre_degC: Array
    slope_per_K: Array
    half_width_K: Array
    mix: Array

    @classmethod
    def over(cls, middle_degC: float, reach_K: float, range_K: float, readings: int) -> RelayPlane:
        """The plane about a loop. reach_K: of the centres to either side; range_K: of the plate's temperatures;
        readings: of the film, that have to tell of it."""
        u, v = np.linspace(-1.0, 1.0, CENTRES), np.linspace(0.0, 1.0, WIDTHS)
        centre = middle_degC + reach_K * np.sinh(CLOSER_MIDDLE * u) / math.sinh(CLOSER_MIDDLE)
        half_width = WIDEST * range_K * np.sinh(CLOSER_NARROW * v) / math.sinh(CLOSER_NARROW)
        slope = STEEP / np.gradient(centre)
        over_u, over_v = np.tile(u, WIDTHS), np.repeat(v, CENTRES)
        away = np.hypot(
            np.subtract.outer(over_u, over_u) / CORRELATED[0], np.subtract.outer(over_v, over_v) / CORRELATED[1]
        )
        amplitude = np.exp(-0.5 * (over_u / FALLS_OFF) ** 2)
        variances, directions = np.linalg.eigh(np.exp(-away) * np.outer(amplitude, amplitude))
        count = min(MOST_COLUMNS, max(readings // PER_COLUMN, 8))
        mix = directions[:, ::-1][:, :count] * np.sqrt(variances[::-1][:count])
        mix /= math.sqrt(float(np.sum(mix * mix)))
        return cls(np.tile(centre, WIDTHS), np.tile(slope, WIDTHS), np.repeat(half_width, CENTRES), mix)

    @property
    def count(self) -> int:
        """How many columns."""
        return int(self.mix.shape[1])

    def columns(self, nodes: FilmNodes) -> Array:
        """What each column is at the rows' readings, (rows, columns)."""
        return self._steps_times(nodes, self.mix)

    def signal(self, nodes: FilmNodes, coefficients: Array) -> Array:
        """The columns times coefficients, (rows,)."""
        return self._steps_times(nodes, (self.mix @ coefficients)[:, None])[:, 0]

    def _steps_times(self, nodes: FilmNodes, weights: Array) -> Array:
        """The relays' outputs times weights: single precision is 1e-6 of a step."""
        half_width, place = np.unique(self.half_width_K, return_inverse=True)
        plays = play_outputs(nodes, half_width)
        slope = self.slope_per_K.astype(np.float32)
        middle = (self.slope_per_K * self.centre_degC).astype(np.float32)
        weights_32 = weights.astype(np.float32)
        out = np.empty((nodes.taken.size, weights.shape[1]))
        for first in range(0, nodes.taken.size, ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            steps = plays[rows].astype(np.float32)[:, place]
            steps *= slope
            steps -= middle
            out[rows] = np.tanh(steps, out=steps) @ weights_32
        return out


@dataclass(frozen=True, eq=False)
class Relays:
    """The relays' columns: of the film itself, in every row; as they are shown in every row and, over the noise, in the
    fitted ones, (rows, columns), and the products of the latter."""

    film: Array
    every: Array
    fitted: Array
    gram: Array

    @classmethod
    def of(cls, film: Array, every: Array, fitted: Rows, noise: Whitening) -> Relays:
        """With the products."""
        chosen = noise.over(every[fitted])
        return cls(film, every, chosen, chosen.T @ chosen)

    @classmethod
    def none(cls, rows: int, fitted: Rows) -> Relays:
        """A film of the class has none."""
        empty, nothing = np.empty((rows, 0)), np.empty((fitted.size, 0))
        return cls(empty, empty, nothing, nothing.T @ nothing)

    def bent(self, slope: Array, fitted: Rows, noise: Whitening) -> Relays:
        """As they show where the reading changes by `slope` with the film's output, (rows,)."""
        return Relays.of(self.film, self.every * slope[:, None], fitted, noise)

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.every.shape[1])


class RelaysOfRecord:
    """The plane's relays on a record's rows, through the filters of the film and of the ohmmeter; the last ones that
    were computed are kept, since the film's temperature moves with few of a fit's unknowns."""

    def __init__(self, plane: RelayPlane, taken_s: Array, fitted: Rows, noise: Whitening) -> None:
        self.plane, self.taken_s, self.fitted, self.noise = plane, taken_s, fitted, noise
        self.none = Relays.none(taken_s.size, fitted)
        self._columns: tuple[FilmNodes, Array] | None = None
        self._relays: tuple[Array, list[Switched], Relays] | None = None

    def at(self, links: Links, nodes: FilmNodes) -> Relays:
        """The relays at a temperature of the film."""
        columns = self._columns_at(nodes)
        passed = [*links.hysteretic_part, *links.meter_lags]
        known = self._relays
        if known is None or known[0] is not columns or not _same(known[1], passed):
            film = self._through(columns, links.hysteretic_part)
            shown = self._through(film, links.meter_lags)
            self._relays = known = (columns, passed, Relays.of(film, shown, self.fitted, self.noise))
        return known[2]

    def signal(self, links: Links, nodes: FilmNodes, coefficients: Array) -> Array:
        """What the relays add to the film's output at the points."""
        if not coefficients.size:
            return np.zeros(nodes.points.size)
        if self._columns is not None and nodes.same_film(self._columns[0]):
            signal = self._columns[1] @ coefficients
        else:
            signal = self.plane.signal(nodes, coefficients)
        return nodes.at_points(self._through(signal[:, None], links.hysteretic_part)[:, 0])

    def _columns_at(self, nodes: FilmNodes) -> Array:
        if self._columns is None or not nodes.same_film(self._columns[0]):
            self._columns = nodes, self.plane.columns(nodes)
        return self._columns[1]

    def _through(self, columns: Array, effects: Effects) -> Array:
        for effect in effects:
            columns = columns_followed(effect, self.taken_s, columns)
        return columns


def _same(one: Sequence[Switched], other: Sequence[Switched]) -> bool:
    """Whether these are the same effects with the same values."""
    return len(one) == len(other) and all(
        a.name == b.name and np.array_equal(a.par, b.par) for a, b in zip(one, other, strict=True)
    )
