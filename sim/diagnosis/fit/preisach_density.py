"""A film of another kind: a smooth density of relays over the whole Preisach plane, whatever its form.

N(c, h) = tanh((F_h[T] - c) / width of the grid) stand on a grid of centres c and half-widths h. What each adds has a
normal prior; its standard deviation falls off from the middle of the loop, and neighbours' are correlated (exponential
kernel): a density is smooth, but may bend anywhere. In the directions of the correlation matrix the prior is that of
independent columns of unlike width (C. Rasmussen, C. Williams, Gaussian Processes for Machine Learning, 2006, ch. 2 and
6); those with next to no variance are left out. One width for all is left, which a record decides.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import Whitens
from sim.diagnosis.data.record import Rows
from sim.effects.effect import Switched
from sim.model.film_columns import cubic_columns, play_outputs
from sim.model.film_nodes import FilmNodes
from sim.model.links import Effects, Links, columns_followed

PER_COLUMN = 2  # readings that a column needs at least; its prior does the rest
WIDEST = 0.2  # half-width, of the range of temperatures: of a film that is not understood, no loop's width is known
CLOSER_MIDDLE = 1.2  # how much closer the centres stand in the middle: sinh
CLOSER_NARROW = 2.2  # how much closer the half-widths stand where they are narrow: sinh
CORRELATED = (0.6, 0.3)  # over centres (-1 to 1) and half-widths (1 at WIDEST): the kernel's lengths, 0.3 of each
FALLS_OFF = 0.6  # standard deviation of the amplitude over the centres
STEEP = 0.9  # of a relay's step, times the distance of the centres
ROWS_AT_ONCE = 256  # times 576 relays in single precision stay in a processor's own cache
SATURATED = 8.0  # steps beyond which a relay has switched, to 2e-7
TABULATED = 0.1  # of a step, from knot to knot of a cubic: an error of 1e-6
FARTHEST_DEGC = 1e9  # a trial's plate may be without an end, single precision is not: all relays have switched there


@dataclass(frozen=True)
class Extent:
    """How much of the Preisach plane there is. grid: centres, and half-widths up to WIDEST; widest: half-width, of the
    range of temperatures; only_what_switches: without the relays that no temperature of the record switches both ways;
    fewest, most: columns, between which the readings decide."""

    grid: int
    widest: float
    only_what_switches: bool
    fewest: int
    most: int


MINOR_LOOPS = Extent(  # they tell of widths themselves; a fit costs the square of the 576 relays; 8 are no density yet
    grid=24, widest=WIDEST, only_what_switches=False, fewest=8, most=200
)
ONE_LOOP = Extent(  # its branches may meet at its ends only. With 24 centres a flank hangs on where the grid stands;
    # with half as many columns as readings what is wide is left out, and flanks hang on rounding
    grid=36,
    widest=0.5,
    only_what_switches=True,
    fewest=400,
    most=400,
)


@dataclass(frozen=True, eq=False)
class RelayPlane:
    """centre_degC, slope_per_K, half_width_K: of each relay, (relays,); mix: from columns to relays, (relays, columns),
    for columns of one prior width."""

    centre_degC: Array
    slope_per_K: Array
    half_width_K: Array
    mix: Array

    @classmethod
    def over(
        cls, middle_degC: float, reach_K: float, ends_degC: tuple[float, float], readings: int, extent: Extent
    ) -> RelayPlane:
        """The plane about a loop. reach_K: of the centres to either side; ends_degC: least and largest of the plate's
        temperatures; readings: of the film, that have to tell of it."""
        low_degC, high_degC = ends_degC
        last = math.asinh(extent.widest / WIDEST * math.sinh(CLOSER_NARROW)) / CLOSER_NARROW  # 1 at WIDEST
        further = round((extent.grid - 1) * last)
        u, v = np.linspace(-1.0, 1.0, extent.grid), np.linspace(0.0, further / (extent.grid - 1), further + 1)
        centre = middle_degC + reach_K * np.sinh(CLOSER_MIDDLE * u) / math.sinh(CLOSER_MIDDLE)
        half_width = WIDEST * (high_degC - low_degC) * np.sinh(CLOSER_NARROW * v) / math.sinh(CLOSER_NARROW)
        over_u, over_v = np.tile(u, v.size), np.repeat(v, u.size)
        of_centre, of_width = np.tile(centre, v.size), np.repeat(half_width, u.size)
        slope = np.tile(STEEP / np.gradient(centre), v.size)
        if extent.only_what_switches:
            switch = (of_centre + of_width <= high_degC) & (of_centre - of_width >= low_degC)
            over_u, over_v, slope = over_u[switch], over_v[switch], slope[switch]
            of_centre, of_width = of_centre[switch], of_width[switch]
        away = np.hypot(
            np.subtract.outer(over_u, over_u) / CORRELATED[0], np.subtract.outer(over_v, over_v) / CORRELATED[1]
        )
        amplitude = np.exp(-0.5 * (over_u / FALLS_OFF) ** 2)
        variances, directions = np.linalg.eigh(np.exp(-away) * np.outer(amplitude, amplitude))
        count = min(extent.most, max(readings // PER_COLUMN, extent.fewest))
        mix = directions[:, ::-1][:, :count] * np.sqrt(variances[::-1][:count])
        mix /= math.sqrt(float(np.sum(mix * mix)))
        return cls(of_centre, slope, of_width, mix)

    @property
    def count(self) -> int:
        """How many columns."""
        return int(self.mix.shape[1])

    def columns(self, nodes: FilmNodes) -> Array:
        """What each column is at the rows' readings, (rows, columns): single precision is 1e-6 of a step."""
        half_width, place = np.unique(self.half_width_K, return_inverse=True)
        plays = np.clip(play_outputs(nodes, half_width), -FARTHEST_DEGC, FARTHEST_DEGC)
        slope = self.slope_per_K.astype(np.float32)
        middle = (self.slope_per_K * self.centre_degC).astype(np.float32)
        mix = self.mix.astype(np.float32)
        out = np.empty((nodes.taken.size, self.count))
        for first in range(0, nodes.taken.size, ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            steps = plays[rows].astype(np.float32)[:, place]
            steps *= slope
            steps -= middle
            out[rows] = np.tanh(steps, out=steps) @ mix
        return out

    def signal(self, nodes: FilmNodes, coefficients: Array) -> Array:
        """The columns times coefficients, (rows,): all relays of one half-width are one function of their play. It is
        tabulated, within 1e-6 of a step."""
        half_width, of_width = np.unique(self.half_width_K, return_inverse=True)
        centre, first, of_centre = np.unique(self.centre_degC, return_index=True, return_inverse=True)
        slope, weights = self.slope_per_K[first], np.zeros((centre.size, half_width.size))
        weights[of_centre, of_width] = self.mix @ coefficients
        ends = SATURATED / np.min(slope)
        knots = np.arange(centre[0] - ends, centre[-1] + ends, TABULATED / np.max(slope))
        steps = np.tanh(slope * (knots[:, None] - centre))
        cubics = CubicHermiteSpline(knots, steps @ weights, (slope * (1.0 - steps * steps)) @ weights).c
        plays, added, out = play_outputs(nodes, half_width), np.empty((nodes.taken.size, 1)), np.zeros(nodes.taken.size)
        for k in range(half_width.size):
            cubic_columns(knots, np.ascontiguousarray(cubics[:, :, k].T)[:, :, None], plays[:, k], added)
            out += added[:, 0]
        return out


@dataclass(frozen=True, eq=False)
class Relays:
    """The relays' columns at one temperature of the film: as they are, of the film itself (times step, crept), behind
    the ohmmeter's filters, all (rows, columns); slope: by how much what is shown changes with the latter, (rows,),
    None: by as much; fitted: as they are shown in the fitted rows, over the noise; gram: its products. nodes: that
    temperature, None where there are no relays; through: the filters passed since; step: (rows,), None: 1."""

    nodes: FilmNodes | None
    columns: Array
    film: Array
    every: Array
    fitted: Array
    gram: Array
    through: tuple[Switched, ...] = ()
    slope: Array | None = None
    step: Array | None = None

    @classmethod
    def none(cls, rows: int, fitted: Rows) -> Relays:
        """A Prandtl-Ishlinskii film has none."""
        empty, nothing = np.empty((rows, 0)), np.empty((fitted.size, 0))
        return cls(None, empty, empty, empty, nothing, nothing.T @ nothing)

    def seen_by(self, slope: Array | None, fitted: Rows, noise: Whitens) -> Relays:
        """As they show in a reading that changes by `slope` with what is behind the filters, with the products."""
        chosen = np.take(self.every, fitted, axis=0)  # two to five times as fast as an index
        if slope is not None:
            chosen *= slope[fitted, None]
        chosen = noise.over(chosen)
        return replace(self, slope=slope, fitted=chosen, gram=chosen.T @ chosen)

    def shown(self, coefficients: Array) -> Array:
        """What they add to what is shown, (rows,)."""
        of_relays = self.every @ coefficients
        return np.asarray(of_relays if self.slope is None else self.slope * of_relays, dtype=np.float64)

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.every.shape[1])


class RelaysOfRecord:
    """The plane's relays on a record's rows, through the filters of the film and of the ohmmeter. Those that were
    computed last are kept, since the film's temperature moves with few of a fit's unknowns: they would be the same."""

    def __init__(self, plane: RelayPlane, taken_s: Array, fitted: Rows, noise: Whitens) -> None:
        self.plane, self.taken_s, self.fitted, self.noise = plane, taken_s, fitted, noise
        self.none = Relays.none(taken_s.size, fitted)
        self._last = deque([self.none], maxlen=1)

    def at(self, links: Links, nodes: FilmNodes, step: Array | None = None) -> Relays:
        """The relays at a temperature of the film, times `step` (rows,)."""
        (known,) = self._last
        through = (*links.hysteretic_part, *links.meter_lags)
        same = known.nodes is not None and nodes.same_film(known.nodes)
        if not (same and _alike(known.step, step) and same_effects(known.through, through)):
            columns = known.columns if same else self.plane.columns(nodes)
            film = columns if step is None else columns * step[:, None]
            film = followed_by(links.hysteretic_part, self.taken_s, film)
            every = followed_by(links.meter_lags, self.taken_s, film)
            plain = replace(self.none, nodes=nodes, columns=columns, film=film, every=every, through=through, step=step)
            known = plain.seen_by(None, self.fitted, self.noise)
            self._last.append(known)
        return known


def followed_by(effects: Effects, taken_s: Array, columns: Array) -> Array:
    """Behind filters, one after the other."""
    for effect in effects:
        columns = columns_followed(effect, taken_s, columns)
    return columns


def _alike(one: Array | None, other: Array | None) -> bool:
    """Whether these are the same steps."""
    return one is other if one is None or other is None else np.array_equal(one, other)


def same_effects(one: Sequence[Switched], other: Sequence[Switched]) -> bool:
    """Whether these are the same effects with the same values."""
    return len(one) == len(other) and all(
        a.name == b.name and np.array_equal(a.par, b.par) for a, b in zip(one, other, strict=True)
    )
