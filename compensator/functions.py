"""The scalar functions that envelopes and memoryless functions are made of, compiled.

    envelope:    gamma(v) = f(a v + b)                                  paper eqs (28), (29)
    memoryless:  D(v)     = amplitude * f(a v + b) + offset             paper eqs (30), (31)
                 D(v)     = sum_k coefficients[k] v^k + offset          "polynomial", lowest power first
                 D(v)     = amplitude / (v + 273.15) + offset           "arrhenius"

v in degC. A compiled loop gets an envelope as the row (code, a, b) and a memoryless function as a code and the
array (amplitude, a, b, offset, c_0, c_1, ...).

Source: Zhang, Merced, Sepulveda, Tan, Smart Mater. Struct. 23 (2014) 125017; "arrhenius" is an insulator's
thermally activated conduction, log R = E_a / (k T) + const.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

ENVELOPE_CODES: Final = {"linear": 0, "tanh": 1}
MEMORYLESS_CODES: Final = {
    "none": 0,
    "tanh": 1,
    "sin": 2,
    "cos": 3,
    "linear": 4,
    "polynomial": 5,
    "arrhenius": 6,
}
KELVIN: Final = 273.15
FIRST_COEFFICIENT: Final = 4  # index of c_0 in a memoryless function's array

Array = NDArray[np.float64]


@njit(cache=True)
def envelope(code: float, a: float, b: float, v: float) -> tuple[float, float]:
    """Value and slope dgamma/dv (1/K) of an envelope function at v in degC."""
    if code == 1.0:
        value = math.tanh(a * v + b)
        return value, a * (1.0 - value * value)
    return a * v + b, a


@njit(cache=True)
def envelope_value(code: float, a: float, b: float, v: float) -> float:
    """Value of an envelope function at v in degC."""
    if code == 1.0:
        return math.tanh(a * v + b)
    return a * v + b


@njit(cache=True)
def envelope_inverse(code: float, a: float, b: float, value: float) -> float:
    """The v in degC at which the envelope has the value; +-inf beyond the ends of its range."""
    if code == 1.0:
        if value >= 1.0:
            return math.copysign(math.inf, a)
        if value <= -1.0:
            return math.copysign(math.inf, -a)
        return (math.atanh(value) - b) / a
    return (value - b) / a


@njit(cache=True)
def envelope_limits(code: float, a: float) -> tuple[float, float]:
    """The values of an increasing envelope (a > 0) at v = -inf and v = +inf."""
    if code == 1.0:
        return -1.0, 1.0
    return -math.inf, math.inf


@njit(cache=True)
def memoryless(code: int, par: Array, v: float) -> tuple[float, float, float]:
    """D, dD/dv and d2D/dv2 at v in degC."""
    amplitude, a, b, offset = par[0], par[1], par[2], par[3]
    if code == 1:
        f = math.tanh(a * v + b)
        slope = amplitude * a * (1.0 - f * f)
        return amplitude * f + offset, slope, -2.0 * a * f * slope
    if code == 2:
        s, c = math.sin(a * v + b), math.cos(a * v + b)
        return amplitude * s + offset, amplitude * a * c, -amplitude * a * a * s
    if code == 3:
        s, c = math.sin(a * v + b), math.cos(a * v + b)
        return amplitude * c + offset, -amplitude * a * s, -amplitude * a * a * c
    if code == 4:
        return amplitude * (a * v + b) + offset, amplitude * a, 0.0
    if code == 5:
        value, slope, half_curvature = 0.0, 0.0, 0.0
        for k in range(par.size - 1, FIRST_COEFFICIENT - 1, -1):
            half_curvature = half_curvature * v + slope
            slope = slope * v + value
            value = value * v + par[k]
        return value + offset, slope, 2.0 * half_curvature
    if code == 6:
        absolute = v + KELVIN
        value = amplitude / absolute
        return value + offset, -value / absolute, 2.0 * value / (absolute * absolute)
    return offset, 0.0, 0.0


@njit(cache=True)
def _cosine_range(low: float, high: float) -> tuple[float, float]:
    """Smallest and largest value of cos on [low, high]."""
    ends = math.cos(low), math.cos(high)
    least, most = min(ends[0], ends[1]), max(ends[0], ends[1])
    turn = 2.0 * math.pi
    if math.floor(high / turn) > math.floor(low / turn) or low == math.floor(low / turn) * turn:
        most = 1.0
    if math.floor((high - math.pi) / turn) > math.floor((low - math.pi) / turn):
        least = -1.0
    return least, most


@njit(cache=True)
def _polynomial_slope_range(par: Array, low: float, high: float) -> tuple[float, float]:
    """An enclosure of the polynomial's slope on [low, high], expanded about the middle."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    degree = par.size - FIRST_COEFFICIENT - 1
    shifted = par[FIRST_COEFFICIENT:].copy()
    for first in range(degree):  # Taylor shift by synthetic division
        for k in range(degree - 1, first - 1, -1):
            shifted[k] += middle * shifted[k + 1]
    spread, power = 0.0, 1.0
    for k in range(2, degree + 1):
        power *= half
        spread += k * abs(shifted[k]) * power
    centre = shifted[1] if degree >= 1 else 0.0
    return centre - spread, centre + spread


@njit(cache=True)
def memoryless_slope_range(code: int, par: Array, low: float, high: float) -> tuple[float, float]:
    """An enclosure of dD/dv on [low, high] degC: exact but for a polynomial, where it tightens with the width."""
    amplitude, a, b = par[0], par[1], par[2]
    if code == 1:
        first, last = memoryless(code, par, low)[1], memoryless(code, par, high)[1]
        least, most = min(first, last), max(first, last)
        centre = -b / a if a != 0.0 else low
        if low < centre < high:
            least, most = min(least, amplitude * a), max(most, amplitude * a)
        return least, most
    if code == 2 or code == 3:
        phase_low, phase_high = min(a * low, a * high) + b, max(a * low, a * high) + b
        if code == 3:  # d cos(s) = -sin(s) = cos(s + pi / 2)
            phase_low, phase_high = phase_low + 0.5 * math.pi, phase_high + 0.5 * math.pi
        least, most = _cosine_range(phase_low, phase_high)
        scale = amplitude * a
        return min(scale * least, scale * most), max(scale * least, scale * most)
    if code == 4:
        return amplitude * a, amplitude * a
    if code == 5:
        return _polynomial_slope_range(par, low, high)
    if code == 6:
        first, last = memoryless(code, par, low)[1], memoryless(code, par, high)[1]
        return min(first, last), max(first, last)
    return 0.0, 0.0


@njit(cache=True)
def memoryless_range(
    code: int, par: Array, low: float, high: float, at_low: float, at_high: float
) -> tuple[float, float]:
    """An enclosure of D on [low, high] degC, given D at its two ends."""
    if code == 2 or code == 3:
        phase_low, phase_high = min(par[1] * low, par[1] * high), max(par[1] * low, par[1] * high)
        shift = par[2] - (0.5 * math.pi if code == 2 else 0.0)
        least, most = _cosine_range(phase_low + shift, phase_high + shift)
        first, last = par[0] * least + par[3], par[0] * most + par[3]
        return min(first, last), max(first, last)
    if code == 5:
        down, up = memoryless_slope_range(code, par, low, high)
        width = high - low
        if down >= 0.0 or up <= 0.0:
            return min(at_low, at_high), max(at_low, at_high)
        return (
            max(at_low + min(down, 0.0) * width, at_high - max(up, 0.0) * width),
            min(at_low + max(up, 0.0) * width, at_high - min(down, 0.0) * width),
        )
    return min(at_low, at_high), max(at_low, at_high)
