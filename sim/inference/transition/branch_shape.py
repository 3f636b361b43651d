"""One major branch as a curve: where it is steepest, how wide the transition is, and the output at any temperature.

The derivative is that of a local fit of the fifth degree (`local_fit`) over a window as wide as its own peak: half of
the peak's full width at half maximum to either side, with weights that fade. That window is the number's resolution: of
structure that is finer, such as the switching of single grains, the derivative over the window is meant. The residuals
of a fit over a somewhat wider window give the noise, and 400 draws of it the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.inference.quantity import Quantity, told, untold
from sim.inference.transition.local_fit import draw_noise, local_fit
from sim.inference.transition.major_branch import MajorBranch

# of the fit in a window as wide as the transition's own peak (docs/decisions.md, 9)
DEGREE: Final = 5
PILOT_DEGREE: Final = 3  # of the fit that only finds the peak's place and width
PILOT_SHARE: Final = 0.1  # of the branch's range: the first window's half width
PILOT_WIDTHS: Final = 0.6  # of the width that the window before found
WINDOW_WIDTHS: Final = 0.5  # of the width, to either side: the bias of the steepest place is then 1e-3 of the width
RESIDUAL_SHARE: Final = 1.2  # of the window: what a wider fit leaves of the curve counts as noise, to be sure
FEWEST_IN_WINDOW: Final = 16  # rows: more than twice the fit's coefficients
PLACES: Final = 201  # over the branch, and again about the peak
NEAR_WIDTHS: Final = 1.5  # of the width to either side of the peak: where it is looked at closely
DRAWS: Final = 400
LEAST_LEFT: Final = 0.05  # of the variance of white noise: where a fit leaves less, its residuals say nothing
MIDDLE_SHARE: Final = 0.5  # of the window, for a value: a derivative's window bends the curve of a film of few grains
MIDDLE_DEGREE: Final = 3
END_DEGREE: Final = 2  # where a window has readings to one side only, higher ones run away
UNSURE: Final = 0.5  # of the width: a steepest place that is known no better is none
FEWEST_STEPS: Final = 2.0  # from row to row: a step of the output itself, in a sweep, looks 3.7 of them wide


@dataclass(frozen=True, eq=False)
class BranchShape:
    """degC, output and slope (per K), shape (places,), with half the width of the slope's 95 % band; the steepest place
    (degC) and the full width at half maximum (K) of the slope's peak, with draws of the first, shape (draws,)."""

    branch: MajorBranch
    window_K: float
    degC: Array
    output: Array
    slope: Array
    slope_half_width: Array
    steepest_degC: Quantity
    width_K: Quantity
    steepest_draws: Array
    noise: Array
    sign: float

    def at(self, degC: float) -> tuple[float, Array]:
        """The output at a temperature, and draws of it, shape (draws,)."""
        row = local_fit(self.branch.temperature_degC, np.array([degC]), self.window_K, END_DEGREE).value[0]
        value = float(row @ self.branch.output)
        return value, value + self.noise @ row

    def crossing(self, low_degC: float, high_degC: float) -> Quantity:
        """Where the output is halfway between what it is at two temperatures."""
        x = self.branch.temperature_degC
        places = np.linspace(low_degC, high_degC, PLACES)
        fit = local_fit(x, places, self.window_K, DEGREE).value
        (low, low_draws), (high, high_draws) = self.at(low_degC), self.at(high_degC)
        curve = fit @ self.branch.output
        found = _crossing(places, curve, 0.5 * (low + high))
        if found is None:
            return untold("the branch does not go through the middle between its ends")
        slope = float(np.interp(found, places, np.gradient(curve, places)))
        reach = float(np.sort(np.abs(x - found))[min(FEWEST_IN_WINDOW, x.size) - 1])
        half = max(MIDDLE_SHARE * self.window_K, reach)
        closely = np.linspace(max(low_degC, found - half), min(high_degC, found + half), PLACES)
        value = local_fit(x, closely, half, MIDDLE_DEGREE).value
        near = _crossing(closely, value @ self.branch.output, 0.5 * (low + high))
        found = found if near is None else near
        row = local_fit(x, np.array([found]), half, MIDDLE_DEGREE).value[0]
        moved = self.noise @ row - 0.5 * (low_draws - low + high_draws - high)
        return told(found, found - moved / slope)


def shape_of(branch: MajorBranch, seed: int = 0) -> BranchShape:
    """The shape of a branch; seed: of the draws."""
    x, y = branch.temperature_degC, branch.output
    low, high = float(x.min()), float(x.max())
    places = np.linspace(low, high, PLACES)
    half = PILOT_SHARE * (high - low)
    for _ in range(3):
        slope = local_fit(x, places, half, PILOT_DEGREE).slope @ y
        sign = float(np.sign(slope[np.argmax(np.abs(slope))])) or 1.0
        width = _width_about(places, sign * slope, 2.0 * half)
        half = PILOT_WIDTHS * width
    peak = float(places[np.argmax(sign * slope)])
    reach = np.sort(np.abs(x - peak))[min(FEWEST_IN_WINDOW, x.size - 1)]
    window = max(WINDOW_WIDTHS * width, float(reach))
    noise, of_values = _noise(branch, RESIDUAL_SHARE * window, seed)
    fit = local_fit(x, places, window, DEGREE)
    near = np.linspace(max(low, peak - NEAR_WIDTHS * width), min(high, peak + NEAR_WIDTHS * width), PLACES)
    by_readings = sign * local_fit(x, near, window, DEGREE).slope
    around, drawn = by_readings @ y, noise @ by_readings.T
    steepest, draws = _steepest(near, around, around + drawn, width)
    if steepest.value is None or not low + 0.5 * width < steepest.value < high - 0.5 * width:
        end = low if peak - low < high - peak else high
        text = f"it is steepest at {peak:.1f} degC, where the record ends at {end:.1f} degC"
        steepest = steepest if steepest.value is None else untold(text)
    standstill = _standstill(x, near, around)
    steepest = untold(standstill) if standstill else steepest
    return BranchShape(
        branch,
        window,
        places,
        local_fit(x, places, RESIDUAL_SHARE * window, DEGREE).value @ y,
        fit.slope @ y,
        np.quantile(np.abs(noise @ fit.slope.T), 0.95, axis=0),
        steepest,
        _width(near, around, around + drawn) if steepest.value is not None else untold(steepest.reason),
        draws,
        of_values,
        sign,
    )


def _noise(branch: MajorBranch, half: float, seed: int) -> tuple[Array, Array]:
    """Noise of which the fit leaves residuals like those that it left, shape (DRAWS, rows); and the same with what a
    thermometer's rounding does so slowly that the fit takes it with it, and leaves none. Values are told with the
    second alone: places of a slope, which are known far less closely, have intervals that hold it.

    Towards the ends a fit follows the readings more closely and leaves less of their noise; its local size is taken
    over what the fit leaves of white noise there.
    """
    x, y = branch.temperature_degC, branch.output
    both = local_fit(x, x, half, DEGREE)
    fit = both.value

    def left_over(readings: Array) -> Array:
        return readings - readings @ fit.T

    residual = left_over(y[None])[0]
    smooth = local_fit(x, x, half, 0).value
    left = np.sum((np.eye(x.size) - fit) ** 2, axis=1)
    square = (smooth @ residual**2) / np.maximum(smooth @ left, LEAST_LEFT)
    scale = np.sqrt(np.maximum(square, 1e-6 * float(np.max(square)) + 1e-30))
    noise = draw_noise(residual, scale, left_over, DRAWS, seed)
    rounding = branch.rounding_K
    if not rounding.shape[0]:
        return noise, noise
    slow = (rounding * (both.slope @ y)) @ fit.T
    return noise, noise + slow[np.random.default_rng(seed).integers(0, rounding.shape[0], DRAWS)]


def _width_about(x: Array, slope: Array, else_K: float) -> float:
    """Full width at half maximum; twice the one side where the other does not end; `else_K` where neither does."""
    k = int(np.argmax(slope))
    sides = [_half_way(x[:k][::-1], slope[:k][::-1], slope[k]), _half_way(x[k:], slope[k:], slope[k])]
    found = [abs(side - x[k]) for side in sides if side is not None]
    return max(2.0 * float(np.mean(found)) if found else else_K, float(x[1] - x[0]))


def _half_way(x: Array, slope: Array, most: float) -> float | None:
    """Where the slope first falls below half of the most."""
    below = np.flatnonzero(slope < 0.5 * most)
    if not below.size or below[0] == 0:
        return float(x[0]) if below.size else None
    j = int(below[0])
    share = (slope[j - 1] - 0.5 * most) / (slope[j - 1] - slope[j])
    return float(x[j - 1] + share * (x[j] - x[j - 1]))


def _crossing(x: Array, y: Array, level: float) -> float | None:
    """Where y first comes to the level."""
    over = np.flatnonzero((y[:-1] - level) * (y[1:] - level) <= 0.0)
    if not over.size or y[over[0]] == y[over[0] + 1]:
        return None
    k = int(over[0])
    return float(x[k] + (level - y[k]) / (y[k + 1] - y[k]) * (x[k + 1] - x[k]))


def summits(x: Array, slopes: Array) -> Array:
    """Where each of several curves, shape (curves, places), is largest: by a parabola through three even places."""
    k = np.clip(np.argmax(slopes, axis=-1), 1, x.size - 2)
    rows = np.arange(k.size)
    before, at, after = (slopes[rows, k + j] for j in (-1, 0, 1))
    bend = before - 2.0 * at + after
    shift = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(x[k] + np.clip(shift, -1.0, 1.0) * (x[1] - x[0]), dtype=np.float64)


def _steepest(x: Array, slope: Array, drawn: Array, width: float) -> tuple[Quantity, Array]:
    place, draws = float(summits(x, slope[None])[0]), summits(x, drawn)
    found = told(place, draws)
    assert found.ci95 is not None
    half = place - found.ci95[0]
    if half > UNSURE * width:
        return untold(f"noise: it is steepest at {place:.1f} +- {half:.1f} degC, known no better"), draws
    return found, draws


def _width(x: Array, slope: Array, drawn: Array) -> Quantity:
    found = _full_width(x, slope)
    if found is None:
        k = int(np.argmax(slope))
        side = x[0] if _half_way(x[:k][::-1], slope[:k][::-1], slope[k]) is None else x[-1]
        return untold(f"the derivative is above half of its maximum still at {side:.1f} degC, where the record ends")
    draws = [_full_width(x, one) for one in drawn]
    quantity = told(found, np.array([found if one is None else one for one in draws]))
    assert quantity.ci95 is not None
    if quantity.ci95[0] <= 0.0:
        return untold(f"noise: the width is {found:.2g} +- {found - quantity.ci95[0]:.2g} K, which may be none")
    return quantity


def _standstill(temperature_degC: Array, near: Array, slope: Array) -> str:
    """Why the steepest place is none of the film's, where the output changed while the temperature hardly moved; else
    empty. A sweep cannot show a peak of so few of its rows; a plate that rests while the output goes on can."""
    step = float(np.median(np.abs(np.diff(temperature_degC))))
    width = _full_width(near, slope)
    if width is None or width >= FEWEST_STEPS * step:
        return ""
    place = float(near[np.argmax(slope)])
    return (
        f"the output changes most at {place:.1f} degC while the temperature hardly moves ({width:.2g} K; rows of the "
        f"sweep are {step:.2g} K apart): the plate stands still there, or the film follows it late"
    )


def _full_width(x: Array, slope: Array) -> float | None:
    k = int(np.argmax(slope))
    left, right = _half_way(x[:k][::-1], slope[:k][::-1], slope[k]), _half_way(x[k:], slope[k:], slope[k])
    return None if left is None or right is None else right - left
