"""Margins of the whole law: estimator, resistance feedback through the inverse, temperature PID, delays, plate, film.

    L = -K P        K: the law linearized at an operating point, (dT, dy) -> du;  P: plate and film, u -> (dT, dy)

With one command there is one loop to break, and it is broken there: S = 1 / (1 + L) says what all of them together do
to an error of the plant, Ms = max |S|, the least distance of L from -1 is 1 / Ms (Astrom and Hagglund, Advanced PID
Control, ISA 2006, ch. 4). The film's slope over the model's runs over a range, as a real film's does on minor loops:
no inverse is right about it.

A law that sends setpoints to a controller's own PID is broken at the ohmmeter instead: at the setpoint the controller's
integral is inside the plant, so that an offset would count as an error.

Limit cycles are predicted by describing functions, for a loop with one part that is not linear (Gelb and Vander Velde,
Multiple-Input Describing Functions, McGraw-Hill 1968, ch. 3; right as far as the loop is a low-pass):

    1 + N(A) L(e^(j omega h)) = 0

N: first harmonic over amplitude A of what the part makes of a sine; L: the loop without it, broken where it is.

    play        a film whose loop is wider than the model's by 2 b K:   the describing function of backlash
    steps       a thermometer that reads in steps of q:                 0 below q / 2, at most 4 / pi above it
    dead band   a driver that gives nothing below b, swinging about 0:  from 0 to 1
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq, root

from compensator.control.design import SPLINE, OwnPid
from compensator.control.law import Law
from compensator.control.linearization import LEVELS, LinearPlant, Point, Timing, operating_points
from compensator.hysteresis.functions import Array

RATIOS = (0.6, 0.8, 1.0, 1.2, 1.5, 1.8, 2.2)  # the film's slope over the model's
FAR = 1.5  # ratio beyond which a larger sensitivity is borne
ASKED_MS, ASKED_FAR_MS = 1.6, 2.0  # 2.0: the loop's gain may still be twice as large as it is
NOISES_K = (0.01, 0.001)  # of a usual thermometer and of the best: the estimator's gains follow from it


@dataclass(frozen=True)
class LoopMargins:
    """Margins at one operating point and one ratio of slopes.

    stable: of the closed loop. gain_margin, phase_margin_deg: at the crossings of phase and |L|. ms, at_thermometer,
    at_ohmmeter: largest sensitivities where the law is judged and at each reading (nan if the law sends setpoints: that
    loop is the controller's). disk_margin, disk_gain, disk_phase_deg: gain factor and phase that may change together.
    """

    stable: bool
    gain_margin: float
    phase_margin_deg: float
    ms: float
    at_thermometer: float
    at_ohmmeter: float
    disk_margin: float
    disk_gain: float
    disk_phase_deg: float
    crossover_rad_per_s: float


def frequencies(period_s: float, count: int = 1200) -> Array:
    """Return frequencies up to Nyquist's, rad/s."""
    return np.logspace(-3.0, math.log10(0.9999 * math.pi / period_s), count)


def loops(point: Point, ratio: float, omega: Array) -> tuple[Array, Array]:
    """Return the parts of L (through the thermometer, through the ohmmeter), shape (frequencies,) each."""
    z = np.exp(1j * omega * point.period_s)
    parts = -point.law.response(z) * point.plant.steeper(ratio).response(z)
    return parts[:, 0], parts[:, 1]


def judged(point: Point, ratio: float, omega: Array) -> Array:
    """Return L where the law is judged."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_output / (1.0 + by_degC) if point.setpoints else by_degC + by_output)


def open_loop(point: Point, ratio: float) -> tuple[Array, Array, Array, Array]:
    """Return L as matrices of a state space: plant, then law."""
    plant, k = point.plant.steeper(ratio), point.law
    if point.setpoints:
        degC, output = plant.c[:1], plant.c[1:]
        a = np.block([[plant.a + plant.b @ k.d[:, :1] @ degC, plant.b @ k.c], [k.b[:, :1] @ degC, k.a]])
        b = np.vstack([plant.b @ k.d[:, 1:], k.b[:, 1:]])
        return a, b, -np.hstack([output, np.zeros((1, k.a.shape[0]))]), np.zeros((1, 1))
    a = np.block([[plant.a, np.zeros((plant.a.shape[0], k.a.shape[0]))], [k.b @ plant.c, k.a]])
    b = np.vstack([plant.b, np.zeros((k.a.shape[0], 1))])
    return a, b, -np.hstack([k.d @ plant.c, k.c]), np.zeros((1, 1))


def slowest_root(point: Point, plant: LinearPlant) -> float:
    """Return the largest magnitude of the closed loop's roots: below 1 it is stable."""
    a, b, c, _ = open_loop(replace(point, plant=plant), 1.0)
    whole = a - b @ c
    return float(np.max(np.abs(np.linalg.eigvals(whole))))


def loop_margins_at(point: Point, ratio: float) -> LoopMargins:
    """Return the margins at a point, the film steeper than the model by a ratio."""
    import control

    omega = frequencies(point.period_s)
    by_degC, by_output = loops(point, ratio, omega)
    loop = judged(point, ratio, omega)
    if slowest_root(point, point.plant.steeper(ratio)) >= 1.0 - 1e-9:
        return LoopMargins(False, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0, 1.0, 0.0, math.nan)
    response = control.frd(loop[::SPLINE], omega[::SPLINE], smooth=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gain, phase, _, crossover = control.margin(response)
        disk = control.disk_margins(control.ss(*open_loop(point, ratio), point.period_s), omega[::12])
    return LoopMargins(
        True,
        float(gain),
        float(phase),
        _largest(loop),
        math.nan if point.setpoints else _largest(by_degC / (1.0 + by_output)),
        _largest(by_output / (1.0 + by_degC)),
        float(disk[0]),
        float(10.0 ** (float(disk[1]) / 20.0)),
        float(disk[2]),
        float(crossover),
    )


def least(margins: Sequence[LoopMargins]) -> LoopMargins:
    """Return the worst of each margin, with the crossover of the largest Ms."""
    worst = max(margins, key=lambda m: m.ms)
    return LoopMargins(
        all(m.stable for m in margins),
        min(m.gain_margin for m in margins),
        min(m.phase_margin_deg for m in margins),
        worst.ms,
        max(m.at_thermometer for m in margins),
        max(m.at_ohmmeter for m in margins),
        min(m.disk_margin for m in margins),
        min(m.disk_gain for m in margins),
        min(m.disk_phase_deg for m in margins),
        worst.crossover_rad_per_s,
    )


def _largest(loop: Array) -> float:
    return float(np.max(1.0 / np.abs(1.0 + loop)))


def largest_stable(holds: Callable[[float], bool], most: float) -> float:
    """Return the largest number up to `most` below which it holds, to a thousandth; inf if it holds at `most`."""
    if holds(most):
        return math.inf
    low, high = 1e-3, most
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def critical_ratio(point: Point, most: float = 100.0) -> float:
    """Return the film's slope over the model's from which the loop oscillates by itself; inf: none up to `most`."""
    return largest_stable(lambda ratio: slowest_root(point, point.plant.steeper(ratio)) < 1.0, most)


def critical_gain(point: Point, ratio: float = 1.0, most: float = 100.0) -> float:
    """Return the plate's response over the model's from which the loop oscillates by itself."""
    plant = point.plant.steeper(ratio)
    return largest_stable(lambda gain: slowest_root(point, plant.stronger(gain)) < 1.0, most)


def bearable_ms(ratio: float) -> float:
    """Return the largest Ms that is allowed at a ratio of slopes."""
    return ASKED_MS if ratio <= FAR else ASKED_FAR_MS


def worst_ms(points: Sequence[Point], ratio: float, count: int = 300) -> float:
    """Return the largest Ms of the points at a ratio; inf if one is not stable."""
    if any(slowest_root(point, point.plant.steeper(ratio)) >= 1.0 - 1e-9 for point in points):
        return math.inf
    omega = frequencies(points[0].period_s, count)
    return max(_largest(judged(point, ratio, omega)) for point in points)


def share_within(law: Law, timing: Timing, own: OwnPid | None = None) -> float:
    """Return the largest `LawSettings.most_share` for which Ms is within its bound at every ratio of slopes.

    The law is taken without its observer: effects make it later, not steeper, and its own delays are in `timing`.
    """

    def holds(share: float) -> bool:
        tried = Law(replace(law.settings, most_share=share), law.plate, law.film)
        for noise_K in NOISES_K if own is None else NOISES_K[:1]:  # a law of setpoints takes the reading as it is
            points = operating_points(tried, timing, noise_K, own, LEVELS[::2] if own is None else LEVELS)
            points = [point for point in points if point.way != "at rest"]  # the resistance is not fed back there
            if any(worst_ms(points, ratio) > bearable_ms(ratio) for ratio in (RATIOS[0], FAR, RATIOS[-1])):
                return False
        return True

    if holds(1.0):
        return 1.0
    low, high = 0.0, 1.0
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


# ---- limit cycles -----------------------------------------------------------------------------------


AMPLITUDES = 160  # in which a describing function is looked at, each 6 % more than the one before
NEAR = 0.5  # of 1 + N L on the grid, from where a zero of it is looked for

Part = Callable[[float], complex]
Broken = Callable[[Array], Array]


@dataclass(frozen=True)
class LimitCycle:
    """Predicted limit cycle.

    amplitude: at the nonlinear part's input, one way, in its unit. keeps: True if it comes back after a small push.
    """

    amplitude: float
    period_s: float
    keeps: bool


def backlash(halfwidth: float) -> Part:
    """Return N(A) of a play of this half-width, by python-control."""
    import control

    part = control.friction_backlash_nonlinearity(2.0 * halfwidth)
    return lambda amplitude: complex(control.describing_function(part, amplitude)) if amplitude > halfwidth else 0j


def steps(step: float) -> Part:
    """Return N(A) of readings rounded to equal steps: the sum of its relays with dead zones."""

    def harmonic(amplitude: float) -> complex:
        edges = step * (np.arange(math.ceil(amplitude / step)) + 0.5)
        edges = edges[edges < amplitude]
        return complex(4.0 * step / (math.pi * amplitude) * np.sum(np.sqrt(1.0 - (edges / amplitude) ** 2)))

    return harmonic


def dead_band(halfwidth: float) -> Part:
    """Return N(A) of an output that is 0 below the half-width and as commanded above it."""

    def harmonic(amplitude: float) -> complex:
        if amplitude <= halfwidth:
            return 0j
        r = halfwidth / amplitude
        return complex(1.0 - 2.0 / math.pi * (math.asin(r) - r * math.sqrt(1.0 - r * r)))

    return harmonic


def at_ohmmeter(point: Point, ratio: float, omega: Array) -> Array:
    """Return the loop broken at the film's output, with the loop through the thermometer closed."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_output / (1.0 + by_degC))


def at_thermometer(point: Point, ratio: float, omega: Array) -> Array:
    """Return the loop broken at the thermometer, with the loop through the ohmmeter closed."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_degC / (1.0 + by_output))


def at_command(point: Point, ratio: float, omega: Array) -> Array:
    """Return the loop broken at the command."""
    return np.asarray(sum(loops(point, ratio, omega)))


def limit_cycles(broken: Broken, part: Part, least: float, period_s: float) -> list[LimitCycle]:
    """Return all limit cycles that are predicted, the smallest amplitude first.

    broken: the loop's response at frequencies (rad/s). part: N(A). least: the amplitude from which N(A) is not 0.
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
    """Return (frequency, amplitude) where the loop crosses the negative real axis and N L is -1."""
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
    """Return (frequency, amplitude) where 1 + N L is 0, refined from its smallest values on the grid."""
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
    """Return True if a larger swing dies down and a smaller one grows (Loeb's criterion).

    With 1 + N(A) L(w) = 0 for A + dA at a complex frequency w + dw, j sigma: sigma dA has to be negative.
    """
    small = 1e-4
    d_loop = (broken(np.array([w * (1.0 + small)])) - broken(np.array([w * (1.0 - small)])))[0] / (2.0 * small * w)
    d_part = (part(amplitude * (1.0 + small)) - part(amplitude * (1.0 - small))) / (2.0 * small * amplitude)
    loop, harmonic = broken(np.array([w]))[0], part(amplitude)
    complex_w = -d_part * loop / (harmonic * d_loop)  # dw / dA, growth where its imaginary part is negative
    return bool(complex_w.imag > 0.0)
