"""The scalar functions that envelopes and memoryless functions are made of, compiled.

    envelope:    gamma(v) = f(a v + b)                                  paper eqs (28), (29)
                 f: tanh, erf, arctan (2/pi atan) or linear: switching temperatures whose spread has the tails of a
                 logistic, a normal or a Cauchy distribution
    memoryless:  D(v)     = amplitude * f(a v + b) + offset             paper eqs (30), (31)
                 D(v)     = sum_k coefficients[k] v^k + offset          "polynomial", lowest power first
                 D(v)     = amplitude / (v + 273.15) + offset           "arrhenius"

v in degC. A compiled loop gets an envelope as the row (code, a, b) and a memoryless function as a code and the
array (amplitude, a, b, offset, c_0, c_1, ...).

tanh is computed from one exponential, (1 - t) / (1 + t) with t = exp(-2 |s|): within 2.3e-16 of the exact value,
twice as fast as libm's, and its slope 4 t / (1 + t)^2 stays exact in saturation, where 1 - tanh^2 is all rounding.

Source: Zhang, Merced, Sepulveda, Tan, Smart Mater. Struct. 23 (2014) 125017; "arrhenius" is an insulator's
thermally activated conduction, log R = E_a / (k T) + const.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit

ENVELOPE_CODES: Final = {"linear": 0, "tanh": 1, "erf": 2, "arctan": 3}  # by which compiled loops know them
ERF_SLOPE: Final = 2.0 / math.sqrt(math.pi)  # of erf at 0
ARCTAN_SLOPE: Final = 2.0 / math.pi  # of (2/pi) atan at 0
WINITZKI: Final = 0.147  # of S. Winitzki's formula (2008) for the inverse of erf, within 2e-3: Newton does the rest
ROUNDS: Final = 4  # of Newton's method: to the last digits
MEMORYLESS_CODES: Final = {  # the same of D
    "none": 0,
    "tanh": 1,
    "sin": 2,
    "cos": 3,
    "linear": 4,
    "polynomial": 5,
    "arrhenius": 6,
}
KELVIN: Final = 273.15  # 0 degC in K
COLDEST_K: Final = 1.0  # below it "arrhenius" stays as it is there: it has a pole at absolute zero
FIRST_COEFFICIENT: Final = 4  # index of c_0 in a memoryless function's array

Array = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])


def lean(function: Function) -> Function:
    """Compile a small function of a hot loop that allocates nothing, without counting references to arrays.

    Counting costs two locked instructions an array and call, two thirds of the inverse's time. The caller holds the
    arrays. A division by zero gives inf or nan.
    """
    return njit(error_model="numpy", _nrt=False)(function)


@njit
def tanh_and_slope(s: float) -> tuple[float, float]:
    """Return tanh(s) and its slope 1 / cosh(s)^2."""
    t = math.exp(-2.0 * abs(s))
    inverse = 1.0 / (1.0 + t)
    return math.copysign((1.0 - t) * inverse, s), 4.0 * t * inverse * inverse


@njit
def envelope(code: float, a: float, b: float, v: float) -> tuple[float, float]:
    """Return value and slope dgamma/dv (1/K) of an envelope function at v in degC."""
    s = a * v + b
    if code == 1.0:
        value, slope = tanh_and_slope(s)
        return value, a * slope
    if code == 2.0:
        return math.erf(s), a * ERF_SLOPE * math.exp(-s * s)
    if code == 3.0:
        return ARCTAN_SLOPE * math.atan(s), a * ARCTAN_SLOPE / (1.0 + s * s)
    return s, a


@njit
def envelope_value(code: float, a: float, b: float, v: float) -> float:
    """Return the value of an envelope function at v in degC: the same bits as `envelope` gives."""
    return tanh_and_slope(a * v + b)[0] if code == 1.0 else envelope(code, a, b, v)[0]


@njit
def envelope_values(row: Array, v: Array) -> Array:
    """Return the values of the envelope (code, a, b) at temperatures v in degC."""
    values = np.empty(v.size)
    for k in range(v.size):
        values[k] = envelope_value(row[0], row[1], row[2], v[k])
    return values


@njit
def envelope_inverse(code: float, a: float, b: float, value: float) -> float:
    """Return the v in degC at which the envelope has the value; +-inf beyond the ends of its range."""
    if code == 0.0:
        return (value - b) / a
    if value >= 1.0:
        return math.inf
    if value <= -1.0:
        return -math.inf
    if code == 1.0:
        return (0.5 * math.log((1.0 + value) / (1.0 - value)) - b) / a
    return ((_erf_inverse(value) if code == 2.0 else math.tan(value / ARCTAN_SLOPE)) - b) / a


@njit
def _erf_inverse(value: float) -> float:
    rest = math.log((1.0 - value) * (1.0 + value))
    half = 2.0 / (math.pi * WINITZKI) + 0.5 * rest
    s = math.copysign(math.sqrt(math.sqrt(half * half - rest / WINITZKI) - half), value)
    for _ in range(ROUNDS):
        # near the ends erfc keeps the digits that erf loses
        error = math.erfc(-s) - (1.0 + value) if s < 0.0 else (1.0 - value) - math.erfc(s)
        s -= error * math.exp(s * s) / ERF_SLOPE
    return s


@njit
def envelope_limits(code: float, a: float) -> tuple[float, float]:
    """Return the values of an increasing envelope (a > 0) at v = -inf and v = +inf."""
    return (-math.inf, math.inf) if code == 0.0 else (-1.0, 1.0)


@njit
def envelope_steepest(code: float, a: float, b: float) -> tuple[float, float]:
    """Return the one v at which the envelope is steepest, and its slope there; nan where its slope is everywhere a."""
    if code == 0.0:
        return math.nan, a
    return -b / a, a if code == 1.0 else a * (ERF_SLOPE if code == 2.0 else ARCTAN_SLOPE)


@njit
def memoryless_value(code: int, par: Array, v: float) -> float:
    """Return D at v in degC: the same bits as `memoryless` gives."""
    s = par[1] * v + par[2]
    if code == 1:
        return float(par[0] * tanh_and_slope(s)[0] + par[3])
    if code == 2:
        return float(par[0] * math.sin(s) + par[3])
    if code == 3:
        return float(par[0] * math.cos(s) + par[3])
    return memoryless(code, par, v)[0]


@njit
def memoryless(code: int, par: Array, v: float) -> tuple[float, float, float]:
    """Return D, dD/dv and d2D/dv2 at v in degC."""
    amplitude, a, b, offset = par[0], par[1], par[2], par[3]
    if code == 1:
        f, f_slope = tanh_and_slope(a * v + b)
        slope = amplitude * a * f_slope
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
        absolute = max(v + KELVIN, COLDEST_K)
        value = amplitude / absolute
        return value + offset, -value / absolute, 2.0 * value / (absolute * absolute)
    return offset, 0.0, 0.0
