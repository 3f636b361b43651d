"""Margins of the whole law: estimator, resistance feedback through the inverse, temperature PID, delays, plate, film.

    L = -K P        K: the law linearized at an operating point, (dT, dy) -> du;  P: plate and film, u -> (dT, dy)

With one command there is one loop to break, and it is broken there: S = 1 / (1 + L) says what all of them together do
to an error of the plant, Ms = max |S|, the least distance of L from -1 is 1 / Ms (Astrom and Hagglund, Advanced PID
Control, ISA 2006, ch. 4). The film's slope over the model's runs over a range, as a real film's does on minor loops:
no inverse is right about it.

A law that sends setpoints to a controller's own PID is broken at the ohmmeter instead: at the setpoint the controller's
integral is inside the plant, so that an offset would count as an error.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

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
