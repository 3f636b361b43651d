"""Forms of film that a record can have: columns of a linear model, for given values of a few nonlinear unknowns.

    PI film         y = D(T) + sum_j c_j F_j[T],  F_j generalized plays with two envelopes, radii evenly spaced
    Preisach film   y = D(T) + sum_j c_j tanh(s_j (F_h[T] - centre_j)),  F_h classical plays of half-width h

D(T) is a smooth curve of either sign over the record's range (`SmoothCurve`): a straight line by its first coefficient,
and what bends it by the others. Or it has one of the forms of a model file (`NamedCurve`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import ENVELOPE_CODES, Array, envelope_inverse
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.preisach_density import PreisachDensity
from sim.inference.joint.domains import Relays
from sim.inference.joint.likelihood import Unknown
from sim.model.film_columns import SmoothCurve, operator_columns, play_columns
from sim.model.film_nodes import FilmNodes
from sim.model.operator_outputs import radius_floor
from sim.model.record_own import FilmStart

ENVELOPES: Final = ("tanh", "erf", "arctan")  # that saturate: with the tails of the usual spreads
OPERATORS: Final = 48  # radii: finer than a usual noise can tell apart, and
FINER: Final = 4  # times as many where it can
CONSTANT_DEC: Final = 30.0  # prior deviation of the offset: any resistance there is
CURVE_DEC: Final = (1.0, 0.5, 0.2)  # of D's slope and bends over the range (degrees 1 to 3): less than any transition
WAVE_DEC: Final = 0.03  # of what else D may do
WEIGHT_DEC: Final = 0.3  # of an operator's or step's weight: a tenth of a usual transition
MARGIN_K: Final = 5.0  # beyond the record's range: a lagging or self-heated film goes there
SLOPES: Final = (0.5, 150.0)  # of envelopes, times the record's range: from wider than it to a hundredth of it


def curve_over(low_degC: float, high_degC: float) -> SmoothCurve:
    """D's curves over a range of temperatures."""
    return SmoothCurve.over(low_degC - MARGIN_K, high_degC + MARGIN_K)


def _curve_precision(curve: Curve) -> Array:
    deviations = np.full(1 + curve.count, WAVE_DEC)
    deviations[0] = CONSTANT_DEC
    deviations[1 : 1 + len(CURVE_DEC)] = CURVE_DEC[: curve.count]
    return deviations**-2.0


def _with_curve(curve: Curve, nodes: FilmNodes, steps: Array) -> Array:
    """A constant, D's columns and the steps, one beside the other."""
    at = nodes.film_degC[nodes.points]
    out = np.empty((at.size, 1 + curve.count + steps.shape[1]))
    out[:, 0] = 1.0
    out[:, 1 : 1 + curve.count] = curve.columns(at)
    out[:, 1 + curve.count :] = steps
    return out


class Curve(Protocol):
    """D(T) without its constant: columns over temperatures, (samples, count)."""

    @property
    def count(self) -> int: ...

    def columns(self, temperature: Array) -> Array: ...


@dataclass(frozen=True, eq=False)
class NamedCurve:
    """D(T) of a named form. shape: its nonlinear parameters, with which a fit begins."""

    form: Form
    shape: Array

    @property
    def count(self) -> int:
        """How many columns."""
        return int(self.columns(np.array([self.form.middle])).shape[1])

    def columns(self, temperature: Array) -> Array:
        """Return the columns without the constant, shape (samples, count)."""
        return self.form.columns(temperature, self.shape)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        """Of a fit of the shape."""
        names, steps = ("log_memoryless_slope", "memoryless_centre_degC"), (1e-3, 0.01)
        each = zip(names, self.shape.tolist(), steps, *(end.tolist() for end in self.form.bounds()), strict=False)
        return tuple(Unknown(name, at, step, low, high, None, False) for name, at, step, low, high in each)


def _free(curve: Curve) -> int:
    """How many coefficients of D may have either sign, the constant's first."""
    return 1 if isinstance(curve, NamedCurve) and curve.form.monotone else 1 + curve.count


@dataclass(frozen=True, eq=False)
class PIFilm:
    """A generalized Prandtl-Ishlinskii film with D(T). ordered: whether its radii keep the order condition below paper
    eq (6); places: of the radii between the smallest that is allowed and 1, (operators,); function: envelopes'."""

    curve: Curve
    centres_degC: tuple[float, float]
    slope_per_K: float
    range_degC: tuple[float, float]
    start: FilmStart = field(default_factory=FilmStart)
    operators: int = OPERATORS
    ordered: bool = False
    chosen: Array | None = None
    function: str = "tanh"

    @cached_property
    def places(self) -> Array:
        return np.arange(self.operators) / self.operators if self.chosen is None else self.chosen

    def radii(self, values: Array) -> Array:
        """Return the radii for given values of the unknowns."""
        floor = radius_floor(values[:4], float(ENVELOPE_CODES[self.function])) if self.ordered else 0.0
        return np.asarray(floor + (1.0 - floor) * self.places)

    def enveloped(self, function: str, values: Array) -> tuple[PIFilm, Array]:
        """The same with envelopes of another function, and the values of the unknowns at which half of each transition
        is as wide."""
        half, of_other = (envelope_inverse(float(ENVELOPE_CODES[f]), 1.0, 0.0, 0.5) for f in (self.function, function))
        values = values.copy()
        values[[0, 2]] += math.log(of_other / half)
        return replace(self, function=function), values

    def finer(self) -> PIFilm:
        """The same with its radii closer to each other."""
        return replace(self, operators=FINER * OPERATORS)

    def at_places(self, places: Array) -> PIFilm:
        """The same with few radii."""
        return replace(self, operators=places.size, chosen=places)

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        low, high = self.range_degC
        reach = 0.5 * (high - low)
        slope, least, most = (math.log(slope) for slope in (self.slope_per_K, *(s / (high - low) for s in SLOPES)))
        out = []
        for side, centre in zip(("rising", "falling"), self.centres_degC, strict=True):
            out.append(Unknown(f"{side}_log_slope", slope, 1e-3, least, most, None, False))
            out.append(Unknown(f"{side}_centre_degC", centre, 0.01, low - reach, high + reach, None, False))
        return (*out, *(self.curve.unknowns if isinstance(self.curve, NamedCurve) else ()))

    @cached_property
    def precision(self) -> Array:
        return np.append(_curve_precision(self.curve), np.full(self.operators, WEIGHT_DEC**-2.0))

    @property
    def free(self) -> int:
        return _free(self.curve)

    def columns(self, values: Array, nodes: FilmNodes) -> Array:
        operators = operator_columns(nodes, values[:4], self.radii(values), self.function)
        return _with_curve(self.curve_at(values), nodes, operators)

    def curve_at(self, values: Array) -> Curve:
        """Return D's curve for given values of the unknowns."""
        return replace(self.curve, shape=values[4:]) if isinstance(self.curve, NamedCurve) else self.curve

    def starting_with(self, start: FilmStart) -> PIFilm:
        """The same with another memory at the first row."""
        return replace(self, start=start)


@dataclass(frozen=True, eq=False)
class PreisachFilm:
    """A film of smooth relays. weight_dec: prior deviation of their weights; of_all: the film of all relays, of which
    this one has a part."""

    curve: Curve
    density: PreisachDensity
    start: FilmStart
    weight_dec: float = WEIGHT_DEC
    of_all: PreisachFilm | None = None

    @property
    def unknowns(self) -> tuple[Unknown, ...]:
        return ()

    @cached_property
    def precision(self) -> Array:
        return np.append(_curve_precision(self.curve), np.full(self.density.centre.size, self.weight_dec**-2.0))

    @property
    def free(self) -> int:
        return _free(self.curve)

    def columns(self, values: Array, nodes: FilmNodes) -> Array:
        return _with_curve(self.curve, nodes, self.density.outputs(lambda widths: play_columns(nodes, widths)))

    def relays(self, coefficients: Array) -> Relays:
        """Return sharp relays of about the film's density."""
        return self.density.sharp(coefficients[1 + self.curve.count :])

    def only(self, active: NDArray[np.bool_]) -> PreisachFilm:
        """The same with some of the columns."""
        return replace(self, density=self.density.only(active[1 + self.curve.count :]), of_all=self.of_all or self)

    def starting_with(self, start: FilmStart) -> PreisachFilm:
        """The same with another memory at the first row."""
        of_all = self.of_all.starting_with(start) if self.of_all else None
        return replace(self, start=start, of_all=of_all)
