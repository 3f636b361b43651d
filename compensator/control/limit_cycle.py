"""Limit cycles that a describing function predicts: a loop with one part that is not linear.

    1 + N(A) L(e^(j omega h)) = 0

N: what the part makes of a sine of amplitude A, its first harmonic over A; L: the loop without it, broken where it is.
Source: Gelb and Vander Velde, Multiple-Input Describing Functions (McGraw-Hill 1968), ch. 3. It holds as far as the
loop is a low-pass.

play           a film whose loop is wider than the model's by 2 b K:  the describing function of backlash
steps          a thermometer that reads in steps of q:                0 below q / 2, at most 4 / pi above it
dead band      a driver that gives nothing below b, swinging about 0:  from 0 to 1
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, root

from compensator.control.operating_points import Point
from compensator.control.whole_law import frequencies, loops
from compensator.hysteresis.functions import Array

AMPLITUDES = 160  # in which a describing function is looked at, each 6 % more than the one before
NEAR = 0.5  # of 1 + N L on the grid, from where a zero of it is looked for

Part = Callable[[float], complex]
Broken = Callable[[Array], Array]


@dataclass(frozen=True)
class LimitCycle:
    """amplitude: at the part's input, one way, in its unit; period_s. keeps: it comes back after a small push."""

    amplitude: float
    period_s: float
    keeps: bool


def backlash(halfwidth: float) -> Part:
    """N(A) of a play that wide, by python-control."""
    import control

    part = control.friction_backlash_nonlinearity(2.0 * halfwidth)
    return lambda amplitude: complex(control.describing_function(part, amplitude)) if amplitude > halfwidth else 0j


def steps(step: float) -> Part:
    """N(A) of readings rounded to the next of equal steps: the sum of its relays with dead zones."""

    def harmonic(amplitude: float) -> complex:
        edges = step * (np.arange(math.ceil(amplitude / step)) + 0.5)
        edges = edges[edges < amplitude]
        return complex(4.0 * step / (math.pi * amplitude) * np.sum(np.sqrt(1.0 - (edges / amplitude) ** 2)))

    return harmonic


def dead_band(halfwidth: float) -> Part:
    """N(A) of an output that is 0 below the half-width and as commanded above it."""

    def harmonic(amplitude: float) -> complex:
        if amplitude <= halfwidth:
            return 0j
        r = halfwidth / amplitude
        return complex(1.0 - 2.0 / math.pi * (math.asin(r) - r * math.sqrt(1.0 - r * r)))

    return harmonic


def at_ohmmeter(point: Point, ratio: float, omega: Array) -> Array:
    """The loop broken at the film's output, that through the thermometer closed."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_output / (1.0 + by_degC))


def at_thermometer(point: Point, ratio: float, omega: Array) -> Array:
    """The loop broken at the thermometer, that through the ohmmeter closed."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_degC / (1.0 + by_output))


def at_command(point: Point, ratio: float, omega: Array) -> Array:
    """The loop broken at the command."""
    return np.asarray(sum(loops(point, ratio, omega)))


def limit_cycles(broken: Broken, part: Part, least: float, period_s: float) -> list[LimitCycle]:
    """All that are predicted, the smallest amplitude first.

    broken: the loop's response at frequencies (rad/s). part: N(A); least: the amplitude at which it begins to answer.
    """
    omega = frequencies(period_s, 600)
    amplitudes: Array = least * 1.001 * 1.06 ** np.arange(AMPLITUDES, dtype=np.float64)
    response, harmonic = broken(omega), np.array([part(float(a)) for a in amplitudes])

    if np.all(harmonic.imag == 0.0):
        at = _real(broken, part, omega, response, amplitudes, harmonic.real)
    else:
        at = _complex(broken, part, omega, response, amplitudes, harmonic)
    found: list[LimitCycle] = []
    for w, amplitude in at:
        if not any(abs(c.amplitude / amplitude - 1.0) < 1e-3 for c in found):
            found.append(LimitCycle(amplitude, 2.0 * math.pi / w, _keeps(broken, part, w, amplitude)))
    return sorted(found, key=lambda cycle: cycle.amplitude)


def _real(
    broken: Broken, part: Part, omega: Array, response: Array, amplitudes: Array, harmonic: Array
) -> list[tuple[float, float]]:
    """(frequency, amplitude) where the loop crosses the negative real axis and N is what is missing to -1."""
    found = []
    for j in np.flatnonzero((np.diff(np.sign(response.imag)) != 0) & (response.real[:-1] < 0.0)):
        w = brentq(lambda v: broken(np.array([v]))[0].imag, omega[j], omega[j + 1])
        missing = harmonic + 1.0 / broken(np.array([w]))[0].real
        wanted = -1.0 / broken(np.array([w]))[0].real
        for i in np.flatnonzero(np.diff(np.sign(missing)) != 0):
            among = amplitudes[i], amplitudes[i + 1]
            found.append((float(w), float(brentq(lambda a, n=wanted: part(a).real - n, *among))))
    return found


def _complex(
    broken: Broken, part: Part, omega: Array, response: Array, amplitudes: Array, harmonic: Array
) -> list[tuple[float, float]]:
    """(frequency, amplitude) where 1 + N L is 0, from the grid's own least values on."""
    away = np.abs(1.0 + harmonic[:, None] * response[None, :])
    inner = away[1:-1, 1:-1]
    lowest = np.minimum.reduce([away[:-2, 1:-1], away[2:, 1:-1], away[1:-1, :-2], away[1:-1, 2:]])
    bounds = np.log([[omega[0], amplitudes[0]], [omega[-1], amplitudes[-1]]])

    def off(x: Array) -> Array:
        w, amplitude = np.exp(np.clip(x, *bounds))
        value = 1.0 + part(float(amplitude)) * broken(np.array([w]))[0]
        return np.array([value.real, value.imag])

    found = []
    for i, j in np.argwhere((inner <= lowest) & (inner < NEAR)) + 1:
        solved = root(off, np.log([omega[j], amplitudes[i]]))
        inside = np.all((solved.x > bounds[0]) & (solved.x < bounds[1]))
        if inside and np.hypot(*off(solved.x)) < 1e-6:
            w, amplitude = np.exp(solved.x)
            found.append((float(w), float(amplitude)))
    return found


def _keeps(broken: Broken, part: Part, w: float, amplitude: float) -> bool:
    """Loeb's criterion: a larger swing dies down, a smaller one grows.

    With 1 + N(A) L(w) = 0 for A + dA at a complex frequency w + dw, j sigma: sigma dA has to be negative.
    """
    small = 1e-4
    d_loop = (broken(np.array([w * (1.0 + small)])) - broken(np.array([w * (1.0 - small)])))[0] / (2.0 * small * w)
    d_part = (part(amplitude * (1.0 + small)) - part(amplitude * (1.0 - small))) / (2.0 * small * amplitude)
    loop, harmonic = broken(np.array([w]))[0], part(amplitude)
    complex_w = -d_part * loop / (harmonic * d_loop)  # dw / dA, growth where its imaginary part is negative
    return bool(complex_w.imag > 0.0)
