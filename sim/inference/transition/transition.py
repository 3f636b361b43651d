"""What papers on such films report: where it switches on heating and on cooling, how sharply, how wide the loop is.

    transition temperature   where |d log10 R / dT| is largest, on the major branch of each sense
    width                    full width at half maximum of that peak
    hysteresis               difference of both transition temperatures
    midpoint                 where log10 R is halfway between its values at the ends of what both branches have
    decades                  change of log10 R between these ends
    activation energy        of the insulating side: the slope of ln R over 1 / (k T), away from the transition

Of another output than a resistance the same is reported. Every number is a function of the fitted film on the branches
that the record holds, and its 95 % interval comes from draws of all that was fitted, from the film's covariance, and of
the thermometer's rounding (`last_digit`). The derivative is that of a fit of the fifth degree over a window as wide as
its own peak: a sum of play operators has a kink at each of them, and of a film whose grains switch one by one the
derivative over a window is meant, too. No interval holds what shifts a whole branch: a thermometer that lags behind the
film shows what the film had before, so that heating moves down and cooling up by the rate times its lag; a film that
lags behind the thermometer, the other way. Where the record does not determine a number, it says why.

A run of the record between two turning points is a major branch where it goes through `WHOLE` of the range that counts,
so that the film comes from saturation if that is wide enough. The range that counts is the one that heating and cooling
both reach, where both show `WHOLE` of all that the output does in the record: the way up from a room that the film is
not cooled to again does not make the loop wider. Else it is the record's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import Boltzmann, elementary_charge

from compensator.hysteresis.functions import KELVIN, Array
from sim.inference.covariance import NORMAL_95
from sim.inference.film.result import FilmFit, along
from sim.inference.readings.temperature_path import turning_points
from sim.model.record_own import FilmStart

Sense = Literal["heating", "cooling"]
SENSES: Final[tuple[Sense, Sense]] = ("heating", "cooling")
WHOLE: Final = 0.85  # of the range that counts: a first sweep from a room somewhat warmer than the cold end is one
RIPPLE: Final = 0.02  # of the range: a controller's overshoot, no reversal that was meant
RIPPLE_NOISE: Final = 3.0  # standard deviations of the thermometer's noise
UNSEEN: Final = 0.05  # of the range without a reading, and ...
MANY: Final = 8.0  # ... median steps: what lies between was not measured
FEWEST_ROWS: Final = 20  # of a branch, below which it has no shape

INSIDE: Final = 0.95  # the intervals' coverage, as everywhere here
NOT_ASKED: Final = "the output is no resistance"
PLACES: Final = 801  # over the range of a branch: a tenth of a kelvin
NEAR: Final = 201  # about the peak of the derivative
NEAR_WIDTHS: Final = 1.5  # of the width to either side of the peak: where it is looked at closely
DEGREE: Final = 5  # of the fit in a window as wide as the transition's own peak (docs/decisions.md, 31)
FIRST_SHARE: Final = 0.1  # of the branch's range: the first window's half width
WINDOW_WIDTHS: Final = 0.5  # of the width, to either side: the bias of the steepest place is then 1e-3 of the width
MIDDLE_SHARE: Final = 0.15  # of the window: a value of the fitted curve follows the nearest few readings
FEWEST_PLACES: Final = 4.0  # of the grid, to either side: more than the fit's coefficients
DRAWS: Final = 400  # tell the ends of a 95 % interval to 5 % of its width
UNSURE: Final = 0.5  # of the width: a steepest place that is known no better is none
ON_THE_LATTICE: Final = 0.02  # of a step
MOST_ON_IT: Final = 0.98  # of the readings; outliers may lie off it
SAME: Final = 1e-6  # of the largest reading: two readings that differ by less are the same in floating point
BOLTZMANN_eV_PER_K: Final = Boltzmann / elementary_charge
FOOT_WIDTHS: Final = 1.25  # widths (FWHM): nearer than this it is the transition, whatever the film
LEAST_K: Final = 8.0  # over less, ln R over 1/T is a straight line for any film
KEPT: Final = 0.9  # of the range of the activation energy, in each step
ALIKE: Final = 0.02  # of the energy: two deviations of it are as much as films' energies are known to at best


@dataclass(frozen=True)
class Quantity:
    """value and the ends of its 95 % interval; both None where the record does not determine it, for the `reason`."""

    value: float | None
    ci95: tuple[float, float] | None
    reason: str = ""

    def table(self) -> dict[str, object]:
        """As JSON has it."""
        found: dict[str, object] = {"value": self.value, "ci95": list(self.ci95) if self.ci95 else None}
        return found | ({"reason": self.reason} if self.reason else {})


def untold(reason: str) -> Quantity:
    """Return no number, and why."""
    return Quantity(None, None, reason)


def told(value: float, draws: Array, more: float = 0.0) -> Quantity:
    """Return the number with an interval about it that holds 95 % of its draws, and the film's misfit.

    draws: shape (1 + draws,), the first one of the film with what the readings near by are off it; more: half the
    interval of a further, independent error.
    """
    by_fit, by_misfit = float(np.quantile(np.abs(draws[1:] - value), INSIDE)), NORMAL_95 * float(draws[0] - value)
    half = math.hypot(by_fit, by_misfit, more)
    return Quantity(value, (value - half, value + half))


@dataclass(frozen=True, eq=False)
class BranchShape:
    """A major branch of the fitted film: degC, output and slope (per K), shape (places,), with half the width of the
    slope's 95 % band; draws of the output, shape (draws, places).

    window_K: half width of the derivative's window. steepest_degC, width_K: the place and the full width at half
    maximum of the slope's peak, with draws of the first, shape (draws,). rows_degC, rounded_K: temperatures of the
    readings, shape (rows,), and draws of what the thermometer's rounding adds to them, shape (draws, rows).
    """

    branch: MajorBranch
    window_K: float
    degC: Array
    output: Array
    draws: Array
    slope: Array
    slope_half_width: Array
    steepest_degC: Quantity
    width_K: Quantity
    steepest_draws: Array
    rows_degC: Array
    rounded_K: Array

    def midpoint(self) -> tuple[Quantity, Array]:
        """Return where the output is halfway between its values at both ends, and draws of it."""
        level = 0.5 * (self.output[0] + self.output[-1])
        over = np.flatnonzero((self.output[:-1] - level) * (self.output[1:] - level) <= 0.0)
        if not over.size or self.output[over[0]] == self.output[over[0] + 1]:
            return untold("the branch does not go through the middle between its ends"), self.steepest_draws
        k = int(over[0])
        slope = float(self.output[k + 1] - self.output[k]) / float(self.degC[k + 1] - self.degC[k])
        found = float(self.degC[k]) + float(level - self.output[k]) / slope
        moved = (self.draws - self.output)[:, k] - 0.5 * (self.draws - self.output)[:, [0, -1]].sum(axis=1)
        near = MIDDLE_SHARE * self.window_K
        draws = found - moved / slope + _mean_about(self.rows_degC, self.rounded_K, found, near)
        return told(found, draws), draws


@dataclass(frozen=True)
class Activation:
    """The energy (eV) and the temperatures (degC) that it was taken from; nan where there are none."""

    energy_eV: Quantity
    low_degC: float = float("nan")
    high_degC: float = float("nan")


@dataclass(frozen=True, eq=False)
class Transition:
    """The numbers of a record's major loop by name (unit at its end), and the branches that they were read off.

    in_decades: the output is -log10(R / 1 ohm), so that slopes and changes are decades.
    """

    quantities: dict[str, Quantity]
    shapes: dict[Sense, BranchShape]
    activation: Activation | None
    in_decades: bool
    range_degC: tuple[float, float]

    def rates_K_per_s(self) -> dict[Sense, float]:
        """Return the median rate of each branch, > 0."""
        return {sense: shape.branch.rate_K_per_s for sense, shape in self.shapes.items()}

    def derivatives(self) -> dict[Sense, tuple[Array, Array, Array]]:
        """Return (degC, d log10 R / dT or d output / dT, half its 95 % band) of each branch: as papers draw it."""
        found = {}
        for sense, shape in self.shapes.items():
            margin = 0.5 * shape.window_K  # nearer to an end a window is too one-sided to look at
            inside = (shape.degC > shape.degC[0] + margin) & (shape.degC < shape.degC[-1] - margin)
            slope = -shape.slope if self.in_decades else shape.slope
            found[sense] = (shape.degC[inside], slope[inside], shape.slope_half_width[inside])
        return found

    def shift_K(self, lag_s: float) -> float:
        """Return by how much a thermometer's lag behind the film makes the loop look narrower; a film's behind it,
        wider."""
        return lag_s * sum(self.rates_K_per_s().values())


def transition(
    fit: FilmFit,
    time_s: ArrayLike,
    temperature_degC: ArrayLike,
    output: ArrayLike,
    *,
    number: int = 0,
    sign: float = 1.0,
    in_decades: bool = True,
    seed: int = 0,
) -> Transition:
    """Return the numbers of one of the records that a film was fitted to.

    time_s, temperature_degC, output: as they were fitted, shape (rows,), nan where there is no reading. number: of the
    record in the fit. sign: of -log10(R / 1 ohm), or (not in_decades) of the column, in the film's output. seed: of the
    draws that give the intervals.
    """
    time, readings = (np.asarray(values, dtype=np.float64) for values in (time_s, temperature_degC))
    course, y = fit.course_degC[number], np.array(output, dtype=np.float64)
    y[fit.outliers[number]] = np.nan
    y[~np.isfinite(readings)] = np.nan
    noise_K = fit.temperature_noise_K[number]
    branches, (low, high) = major_branches(time, course, y, noise_K)
    random = np.random.default_rng(seed)
    spread, axes = np.linalg.eigh(fit.fitted.covariance.matrix)
    drawn = random.standard_normal((1 + DRAWS, spread.size)) * np.sqrt(np.maximum(spread, 0.0)) @ axes.T
    digit, shapes = last_digit(readings), {}
    for sense, branch in branches.items():
        degC, v = np.linspace(low, high, PLACES), course[branch.rows]
        curve, by = _curve(fit, degC, sense, alone=len(branches) == 1)
        beyond = sign * (y[branch.rows] - np.interp(v, degC, curve))
        rounded = rounding_errors(v, digit, noise_K, random)
        shapes[sense] = _shape(branch, degC, sign * curve, sign * drawn @ by.T, v, beyond, rounded)
    return Transition(*_numbers(shapes, in_decades, low, high), in_decades, (low, high))


def _curve(fit: FilmFit, degC: Array, sense: Sense, alone: bool) -> tuple[Array, Array]:
    """Return the film's output on a branch, shape (places,), and its derivatives by all that was fitted, shape (places,
    parameters). alone: whether the record has no other branch, so that this one begins in saturation."""
    forward = degC if sense == "heating" else degC[::-1]
    v = forward if alone else np.append(forward[-1], forward)
    nodes = along(v, FilmStart("heated" if (sense == "heating") == alone else "cooled"))
    nodes = replace(nodes, points=np.arange(v.size - degC.size, v.size))
    order = slice(None) if sense == "heating" else slice(None, None, -1)
    return fit.fitted.at(nodes)[order], fit.fitted.jacobian(nodes)[order]


def last_digit(readings: Array) -> float:
    """Return the step that readings are rounded to, 0 where there is none; nan: no reading."""
    distinct = np.unique(readings[np.isfinite(readings)])
    gaps = np.diff(distinct)
    gaps = gaps[gaps > SAME * max(float(np.max(np.abs(distinct), initial=0.0)), 1.0)]
    if gaps.size < 2:
        return 0.0
    step = float(np.min(gaps))
    index = (distinct - distinct[0]) / step
    return step if np.mean(np.abs(index - np.round(index)) < ON_THE_LATTICE) >= MOST_ON_IT else 0.0


def rounding_errors(course: Array, step: float, noise: float, random: np.random.Generator) -> Array:
    """Return draws of what a rounding adds to each reading of a course, in its unit, shape (draws, rows).

    Where a ramp goes on by about as much in a row as the readings are rounded to, the error drifts slowly from row to
    row, and all readings of a transition are off to the same side. The readings do not say where the lattice lies: each
    draw tries another place. noise: standard deviation of the readings' noise, the rounding's own in it; what was there
    before the rounding breaks the beat.
    """
    if step == 0.0:
        return np.zeros((1 + DRAWS, course.size))
    before = np.sqrt(max(noise**2 - step**2 / 12.0, 0.0))
    place = (np.arange(1 + DRAWS)[:, None] + random.random()) / (1 + DRAWS) * step
    true = course + place + before * random.standard_normal((1 + DRAWS, course.size))
    found = step * np.round(true / step) - true
    found[0] = 0.0
    return np.asarray(found, dtype=np.float64)


def _shape(
    branch: MajorBranch, degC: Array, output: Array, noise: Array, rows_degC: Array, beyond: Array, rounded: Array
) -> BranchShape:
    """Return the shape of a branch. noise: draws of the output's error, shape (1 + draws, places); rows_degC, beyond,
    rounded: of the readings, their temperatures, what they are off the film, and draws of the temperatures' errors."""
    low, high = float(degC[0]), float(degC[-1])
    window = FIRST_SHARE * (high - low)
    least = FEWEST_PLACES * float(degC[1] - degC[0])
    for _ in range(3):  # the window's own width is 1e-2 of the peak's then
        slope = window_slopes(degC, degC, window) @ output
        sign = float(np.sign(slope[np.argmax(np.abs(slope))])) or 1.0
        width = _width_about(degC, sign * slope, 2.0 * window)
        window = max(WINDOW_WIDTHS * width, least)
    noise[0] = _smoothed(degC, rows_degC, beyond, window)
    peak = float(degC[np.argmax(sign * slope)])
    near = np.linspace(max(low, peak - NEAR_WIDTHS * width), min(high, peak + NEAR_WIDTHS * width), NEAR)
    operator = sign * window_slopes(degC, near, window)
    around = operator @ output
    drawn = around + noise @ operator.T
    shift = _mean_about(rows_degC, rounded, peak, window)
    place, draws = float(summits(near, around[None])[0]), summits(near, drawn) + shift
    steepest = told(place, draws)
    assert steepest.ci95 is not None
    half = place - steepest.ci95[0]
    if half > UNSURE * width:
        steepest = untold(f"the steepest point, {place:.1f} +- {half:.1f} degC, is too uncertain")
    elif not low + 0.5 * width < place < high - 0.5 * width:
        end = low if peak - low < high - peak else high
        steepest = untold(f"the steepest point, {peak:.1f} degC, is too close to the record's end at {end:.1f} degC")
    every = window_slopes(degC, degC, window)
    return BranchShape(
        branch,
        window,
        degC,
        output,
        output + noise,
        every @ output,
        np.quantile(np.abs(noise[1:] @ every.T), INSIDE, axis=0),
        steepest,
        _width(near, around, drawn) if steepest.value is not None else untold(steepest.reason),
        draws,
        rows_degC,
        rounded,
    )


def window_slopes(degC: Array, places: Array, half_width: float) -> Array:
    """Return the matrix, shape (places, values), that takes a curve's values at increasing temperatures to its
    derivative over a window: of a polynomial fitted with weights (1 - |u|^3)^3 that fade towards the window's ends
    (W. S. Cleveland, J. Am. Stat. Assoc. 74 (1979) 829)."""
    first = np.searchsorted(degC, places - half_width)
    last = np.searchsorted(degC, places + half_width, "right")
    found = np.zeros((places.size, degC.size))
    for k, place in enumerate(places):
        u = (degC[first[k] : last[k]] - place) / half_width
        weight = np.maximum(1.0 - np.abs(u) ** 3, 0.0) ** 1.5
        powers = np.vander(u, DEGREE + 1, increasing=True)
        found[k, first[k] : last[k]] = np.linalg.pinv(weight[:, None] * powers)[1] * weight / half_width
    return found


def _mean_about(rows_degC: Array, values: Array, degC: float, half_width: float) -> Array:
    """Return the means of values, shape (draws, rows), over the rows within half a window of a temperature, or over the
    nearest one, shape (draws,)."""
    away = np.abs(rows_degC - degC)
    return np.asarray(np.mean(values[:, away <= max(half_width, float(np.min(away)))], axis=1), dtype=np.float64)


def _smoothed(degC: Array, rows_degC: Array, values: Array, half_width: float) -> Array:
    """Return the mean of values of rows over a window about each place, with the weights of `window_slopes`; 0 where
    there are none, shape (places,)."""
    place = np.clip(np.rint((rows_degC - degC[0]) / (degC[1] - degC[0])).astype(np.int64), 0, degC.size - 1)
    count, total = (np.bincount(place, weights=w, minlength=degC.size) for w in (None, values))
    u = np.minimum(np.abs(degC[:, None] - degC) / half_width, 1.0)
    weight = (1.0 - u**3) ** 3
    return np.asarray(weight @ total / np.maximum(weight @ count, 1e-300), dtype=np.float64)


def summits(x: Array, slopes: Array) -> Array:
    """Return where each of several curves, shape (curves, places), is largest: by a parabola through three places."""
    k = np.clip(np.argmax(slopes, axis=-1), 1, x.size - 2)
    rows = np.arange(k.size)
    before, at, after = (slopes[rows, k + j] for j in (-1, 0, 1))
    bend = before - 2.0 * at + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(x[k] + np.clip(shift, -1.0, 1.0) * (x[1] - x[0]), dtype=np.float64)


def _width_about(x: Array, slope: Array, else_K: float) -> float:
    """Return the full width at half maximum; twice the one side where the other does not end; `else_K` where neither
    does."""
    k = int(np.argmax(slope))
    sides = [_half_way(x[:k][::-1], slope[:k][::-1], slope[k]), _half_way(x[k:], slope[k:], slope[k])]
    found = [abs(side - x[k]) for side in sides if side is not None]
    return max(2.0 * float(np.mean(found)) if found else else_K, float(x[1] - x[0]))


def _half_way(x: Array, slope: Array, most: float) -> float | None:
    """Return where the slope first falls below half of the most."""
    below = np.flatnonzero(slope < 0.5 * most)
    if not below.size or below[0] == 0:
        return float(x[0]) if below.size else None
    j = int(below[0])
    share = (slope[j - 1] - 0.5 * most) / (slope[j - 1] - slope[j])
    return float(x[j - 1] + share * (x[j] - x[j - 1]))


def _full_width(x: Array, slope: Array) -> float | None:
    """Return the full width at half maximum, None where the curve ends before."""
    k = int(np.argmax(slope))
    left, right = _half_way(x[:k][::-1], slope[:k][::-1], slope[k]), _half_way(x[k:], slope[k:], slope[k])
    return None if left is None or right is None else right - left


def _width(x: Array, slope: Array, drawn: Array) -> Quantity:
    found = _full_width(x, slope)
    if found is None:
        k = int(np.argmax(slope))
        side = x[0] if _half_way(x[:k][::-1], slope[:k][::-1], slope[k]) is None else x[-1]
        return untold(f"the record ends at {side:.1f} degC, where the derivative is still above half of its maximum")
    draws = [_full_width(x, one) for one in drawn]
    quantity = told(found, np.array([found if one is None else one for one in draws]))
    assert quantity.ci95 is not None
    if quantity.ci95[0] <= 0.0:
        return untold(f"the width, {found:.2g} +- {found - quantity.ci95[0]:.2g} K, is not distinguishable from zero")
    return quantity


def _numbers(
    shapes: dict[Sense, BranchShape], in_decades: bool, low: float, high: float
) -> tuple[dict[str, Quantity], dict[Sense, BranchShape], Activation | None]:
    found: dict[str, Quantity] = {}
    middles: dict[Sense, Array] = {}
    missing = {sense: f"no single {sense} ramp crosses {100.0 * WHOLE:.0f} % of the record's range" for sense in SENSES}
    for sense in SENSES:
        shape = shapes.get(sense)
        found[f"{sense}_degC"] = shape.steepest_degC if shape else untold(missing[sense])
        found[f"width_{sense}_K"] = shape.width_K if shape else untold(missing[sense])
    steepest = {sense: shape.steepest_draws for sense, shape in shapes.items()}
    found["hysteresis_K"] = _difference(found["heating_degC"], found["cooling_degC"], steepest)
    for sense in SENSES:
        found[name := f"midpoint_{sense}_degC"] = untold(missing[sense])
        if sense in shapes:
            found[name], middles[sense] = shapes[sense].midpoint()
    found["hysteresis_at_midpoint_K"] = _difference(
        found["midpoint_heating_degC"], found["midpoint_cooling_degC"], middles
    )
    reason = "there is no major branch"
    change = untold(reason)
    if shapes:  # decades that R falls by (below 0 where it rises), or the output's own rise: mean over the branches
        value = np.mean([shape.output[-1] - shape.output[0] for shape in shapes.values()])
        change = told(float(value), np.mean([s.draws[:, -1] - s.draws[:, 0] for s in shapes.values()], axis=0))
    found["change_dec" if in_decades else "change"] = change
    activation = _activation(list(shapes.values())) if in_decades and shapes else None
    found["activation_energy_eV"] = activation.energy_eV if activation else untold(reason if in_decades else NOT_ASKED)
    return found, shapes, activation


def _difference(one: Quantity, other: Quantity, draws: Mapping[Sense, Array]) -> Quantity:
    """Return heating less cooling of a number that both branches have."""
    if one.value is None or other.value is None:
        return untold(one.reason or other.reason)
    return told(one.value - other.value, draws["heating"] - draws["cooling"])


def _activation(shapes: Sequence[BranchShape]) -> Activation:
    """Return the slope of ln R over 1 / (k T) on the insulating side of all branches.

    How far the foot of the transition reaches cannot be known beforehand. So the fit begins with all that is further
    than `FOOT_WIDTHS` from where it is steepest, and gives up temperatures from there until both halves of the rest
    give the same energy within noise or `ALIKE`; the difference that remains is added to the interval.
    """
    known = [(shape.steepest_degC.value, shape.width_K.value) for shape in shapes]
    if any(c is None or w is None for c, w in known):
        return Activation(untold("the cold end of the transition is not known"))
    cold = float(shapes[0].output[-1] - shapes[0].output[0]) > 0.0  # the insulator is at the cold end
    feet = [c - FOOT_WIDTHS * w if cold else c + FOOT_WIDTHS * w for c, w in known if c is not None and w is not None]
    degC = shapes[0].degC
    foot, end = (min(feet), float(degC[0])) if cold else (max(feet), float(degC[-1]))
    span = abs(foot - end) if (foot > end) == cold else 0.0
    if span < LEAST_K:
        text = f"the record {'begins' if cold else 'ends'} at {end:.1f} degC and the transition's foot is at "
        return Activation(untold(f"{text}{foot:.1f} degC; expected at least {LEAST_K:g} K between them"))
    found = Activation(untold("no temperatures on the insulating side"))
    while span >= LEAST_K:
        low, high = (end, end + span) if cold else (end - span, end)
        part = (degC >= low) & (degC <= high)
        log = -np.mean([shape.output[part] for shape in shapes], axis=0)
        drawn = -np.mean([shape.draws[:, part] for shape in shapes], axis=0)
        energy, draws, apart, apart_draws = _energies(degC[part], log, drawn)
        quantity = told(energy, draws, NORMAL_95 * abs(apart))
        assert quantity.ci95 is not None
        if quantity.ci95[0] <= 0.0:
            quantity = untold(f"the resistance does not fall with temperature between {low:.1f} and {high:.1f} degC")
        found = Activation(quantity, low, high)
        if abs(apart) <= max(float(np.quantile(np.abs(apart_draws[1:] - apart), INSIDE)), ALIKE * abs(energy)):
            break
        span *= KEPT
    return found


def _energies(degC: Array, log10_ohm: Array, drawn: Array) -> tuple[float, Array, float, Array]:
    """Return the energy (eV), draws of it, and half the difference between both halves of the range, with its draws.
    log10_ohm: shape (places,); drawn: of it, shape (draws, places)."""
    x = 1.0 / (math.log(10.0) * BOLTZMANN_eV_PER_K * (degC + KELVIN))
    half = 0.5 * float(np.ptp(x))
    u = (x - 0.5 * float(x.min() + x.max())) / half
    line, bent = (np.linalg.pinv(np.vander(u, degree + 1, increasing=True)) for degree in (1, 2))
    # a bend c u^2 has slopes -c and c in the middles of both halves
    slope, bend = line[1] / half, bent[2] / half
    return float(slope @ log10_ohm), drawn @ slope, float(bend @ log10_ohm), drawn @ bend


@dataclass(frozen=True, eq=False)
class Run:
    """Rows first..last (both included) between two turning points of the temperature."""

    first: int
    last: int
    heating: bool


@dataclass(frozen=True, eq=False)
class MajorBranch:
    """How a record shows a major branch: the rows of its readings; how many runs; the median rate, K/s, > 0."""

    rows: NDArray[np.int64]
    runs: int
    rate_K_per_s: float


def runs_of(degC: Array, noise_K: float) -> list[Run]:
    """Return the runs of a record in the order of time. noise_K: of its thermometer."""
    least = max(RIPPLE * float(np.ptp(degC)), RIPPLE_NOISE * noise_K)
    return [Run(int(a), int(b), bool(degC[b] > degC[a])) for a, b in pairwise(turning_points(degC, least))]


def onward_rows(degC: Array, run: Run) -> NDArray[np.int64]:
    """Return the rows of a run in which the temperature is further than in any row of the run before: in the others, of
    a ripple, the film is inside a minor loop."""
    part = degC[run.first : run.last + 1]
    furthest = np.maximum.accumulate(part) if run.heating else np.minimum.accumulate(part)
    return np.asarray(run.first + np.flatnonzero(part == furthest), dtype=np.int64)


def major_branches(
    time_s: Array, degC: Array, output: Array, noise_K: float
) -> tuple[dict[Sense, MajorBranch], tuple[float, float]]:
    """Return the branches that a record has, none to two, and the range that counts, degC. Arrays of shape (rows,): s,
    the temperature's path in degC, the film's output (nan: no reading)."""
    good, runs, found = np.isfinite(output), runs_of(degC, noise_K), {}
    low, high = _range_that_counts(runs, degC, output, good)
    span = float(np.ptp(output[good])) if np.any(good) else 0.0
    for sense in SENSES:
        rows = []
        for run in runs:
            if run.heating != (sense == "heating"):
                continue
            ends, row = np.sort(degC[[run.first, run.last]]), onward_rows(degC, run)
            row = row[good[row]]
            seen = (min(ends[1], high) - max(ends[0], low)) / (high - low)
            if seen - _unseen(degC[row], output[row], high - low, span) >= WHOLE:
                rows.append(row)
        if sum(row.size for row in rows) >= FEWEST_ROWS:
            rate = float(np.median([_rate(time_s[row], degC[row]) for row in rows]))
            found[sense] = MajorBranch(np.concatenate(rows), len(rows), rate)
    return found, (low, high)


def _range_that_counts(runs: list[Run], degC: Array, output: Array, good: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the range that the widest runs of both senses share, degC, where each shows nearly all that the output
    does there; else the range of the record."""
    whole = float(degC.min()), float(degC.max())
    senses = ([run for run in runs if run.heating], [run for run in runs if not run.heating])
    if not all(senses) or not np.any(good):
        return whole
    widest = [max(of, key=lambda run: abs(float(degC[run.last] - degC[run.first]))) for of in senses]
    ends = np.sort([degC[[run.first, run.last]] for run in widest], axis=1)
    low, high = float(np.max(ends[:, 0])), float(np.min(ends[:, 1]))
    for run in widest:
        rows = np.arange(run.first, run.last + 1)
        seen = output[rows[good[rows] & (degC[rows] >= low) & (degC[rows] <= high)]]
        if seen.size < FEWEST_ROWS or np.ptp(seen) < WHOLE * np.ptp(output[good]):
            return whole
    return low, high


def _unseen(degC: Array, output: Array, range_K: float, span: float) -> float:
    """Return the share of a run that has no readings, in the range of temperatures or in the output's span, whichever
    is more: steps between readings that are far longer than the others."""
    steps, moved = np.abs(np.diff(degC)), np.abs(np.diff(output))
    if not steps.size:
        return 0.0
    holes = steps > max(UNSEEN * range_K, MANY * float(np.median(steps)))
    return max(float(np.sum(steps[holes])) / range_K, float(np.sum(moved[holes])) / max(span, 1e-300))


def _rate(time_s: Array, degC: Array) -> float:
    """Return the rate of a run in the middle half of its range, K/s: without what it waits at its ends."""
    share = np.abs(degC - degC[0]) / max(abs(float(degC[-1] - degC[0])), 1e-300)
    inside = np.flatnonzero((share >= 0.25) & (share <= 0.75))
    first, last = (int(inside[0]), int(inside[-1])) if inside.size > 1 else (0, degC.size - 1)
    return abs(float(degC[last] - degC[first])) / max(float(time_s[last] - time_s[first]), 1e-300)
