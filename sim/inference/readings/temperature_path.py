"""A noise-free way into the film's memory: the temperature path behind noisy readings.

Play operators remember extremes, so that noise on a measured temperature ratchets them and looks like creep. The path
is found in two steps, both without phase:

1. A smoother for a temperature whose rate walks at random,
       T' = rate,  rate' = white noise of density q,  reading = T + noise of standard deviation sigma,
   with q and sigma by maximum likelihood from the readings themselves; where the rate breaks (a corner of a profile)
   q is raised, so that corners stay sharp: by how much, and for how long (a plate of some mass rounds them), says the
   likelihood, too. Forward Kalman filter, backward Rauch-Tung-Striebel pass.
2. Reversals smaller than `REVERSAL` sigma are no reversals: between the turning points that are left the path is the
   monotone (isotonic) least-squares fit of the smoothed readings.

Readings without noise (sigma below `NEGLIGIBLE` of their span) are returned unchanged, to the bit; so are those
sampled so coarsely that reversals look like noise.

Sources: H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445; R. E. Barlow et al., Statistical Inference
under Order Restrictions (Wiley 1972), ch. 1 (pool adjacent violators).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.inference.kalman import filter_gains, smoothed, whitened
from sim.inference.readings.checked_columns import check_noise
from sim.inference.readings.odd_readings import lone_outliers

WIDE_K: Final = 5.0  # above this span ...
COARSE: Final = 0.05  # ... `noise` of such a share is no noise, but reversals between the rows
REVERSAL: Final = 3.0  # in sigma: smaller reversals are taken for noise
NEGLIGIBLE: Final = 1e-5  # noise over span: below it readings are taken as they are
BREAK: Final = 6.0  # in usual changes of the rate per step: a corner of the profile
GATE: Final = 6.0  # in predicted standard deviations: readings further off are outliers
STRAY: Final = 1.5  # in sigma: the smoothed path may not be further off the readings than this, in the mean square
CORNER: Final = 3.0  # in ranges of the rate: how much it may change in a step where breaks are looked for
CHANGES: Final = (2.0, 1.0, 0.5, 0.25, 0.12, 0.06, 0.03)  # the same over a whole corner, once all are found
ROUNDED: Final = (10.0, 20.0, 40.0, 80.0, 160.0)  # in usual steps: how long a corner may last
UNKNOWN: Final = 1e6  # variance of the first temperature, in that of a reading: only the reading tells it
COARSELY: Final = (np.arange(-22.0, 9.0, 2.0),)  # of ln q, about one change of the rate by sigma / step in a step
CLOSELY: Final = (*COARSELY, np.array([-1.0, 0.0, 1.0]), np.array([-0.5, 0.0, 0.5]))


@dataclass(frozen=True, eq=False)
class TemperaturePath:
    """`temperature_degC`: shape (samples,); `turning`: indices of the turning points, first and last row included;
    `noise_K`: standard deviation of the readings' noise, 0 where it is negligible; `outliers`: indices left out."""

    temperature_degC: Array
    turning: NDArray[np.int64]
    noise_K: float
    outliers: NDArray[np.int64]


class _Walk:
    """Readings of a temperature whose rate walks at random, in units of their noise, over uneven steps, s.

    readings: (n,), those that count for nothing straight between the others; used: which count.
    """

    def __init__(self, steps: Array, readings: Array, used: NDArray[np.bool_]) -> None:
        self.steps, self.first = steps, float(readings[0])
        self.readings, self.variance = readings - self.first, np.where(used, 1.0, np.inf)
        self.moves = np.zeros((readings.size, 7))
        self.moves[0, [4, 6]] = UNKNOWN, 4.0 / max(float(steps[0]), 1e-9) ** 2
        self.moves[1:, [0, 3]], self.moves[1:, 1] = 1.0, steps
        self.of_density = steps[:, None] ** [3, 2, 1] / [3.0, 2.0, 1.0]

    def gains(self, density: Array) -> Array:
        """Return the filter's gains. density: q / sigma^2 in each step, 1/s^3."""
        self.moves[1:, 4:] = density[:, None] * self.of_density
        return filter_gains(self.moves, self.variance)

    def innovations(self, density: Array) -> tuple[float, Array]:
        """Return the sum of the log variances of the innovations, and these over their deviations, 0 where no reading
        counts, (n,)."""
        gains = self.gains(density)
        scales = gains[3:, 2]
        logs = -2.0 * float(np.sum(np.log(scales[scales > 0.0])))
        return logs, whitened(self.moves, gains, self.readings[:, None])[:, 0]

    def smooth(self, density: Array) -> tuple[Array, Array]:
        """Return temperature and rate given all readings, (n,) each."""
        found = smoothed(self.moves, self.gains(density), self.readings)
        return found[:, 0] + self.first, found[:, 1]


@njit
def turning_points(values: Array, threshold: float) -> NDArray[np.int64]:
    """Return indices of the turning points whose reversals exceed the threshold, first and last row included."""
    found = np.empty(values.size + 1, dtype=np.int64)
    found[0] = 0
    count, sense = 1, 0
    low = high = 0
    for k in range(1, values.size):
        if values[k] > values[high]:
            high = k
        if values[k] < values[low]:
            low = k
        if sense <= 0 and values[k] - values[low] > threshold:  # a rise: the low before it was a turning point
            if sense < 0 or low > 0:
                found[count] = low
                count += 1
            sense, high = 1, k
            low = k
        elif sense >= 0 and values[high] - values[k] > threshold:
            if sense > 0 or high > 0:
                found[count] = high
                count += 1
            sense, low = -1, k
            high = k
    if values.size > 1 and found[count - 1] != values.size - 1:
        found[count] = values.size - 1
        count += 1
    return found[:count]


def _variance(innovations: Array) -> float:
    """Of those that are normal, whatever a few large ones are."""
    return float(1.4826 * np.median(np.abs(innovations))) ** 2


def _cost(logs: float, innovations: Array) -> float:
    """Return -2 log L up to constants, of innovations that follow Student's t with four degrees of freedom: a few large
    ones, at the corners of a profile, must not pass for noise or for a restless rate."""
    square = _variance(innovations) + 1e-300
    return logs + innovations.size * math.log(square) + 5.0 * float(np.sum(np.log1p(innovations**2 / (4.0 * square))))


def _cost_of_corners(logs: float, innovations: Array) -> float:
    """Return the same of normal innovations: once the corners are found, a large one says that the rate changes by
    more."""
    square = _variance(innovations) + 1e-300
    return logs + innovations.size * math.log(square) + float(np.sum(innovations**2)) / square


def _density(walk: _Walk, used: NDArray[np.bool_], extra: Array, grids: Sequence[Array] = CLOSELY) -> float:
    """Return q / sigma^2 (1/s^3) of the highest likelihood beside what is added at corners, by grids in its logarithm,
    each about the best of the one before."""
    best = -3.0 * math.log(float(np.median(walk.steps)))
    for offsets in grids:
        tried = best + offsets
        found = [walk.innovations(extra + math.exp(x)) for x in tried]
        best = float(tried[int(np.argmin([_cost(logs, left[used]) for logs, left in found]))])
    return math.exp(best)


def _corners(walk: _Walk, used: NDArray[np.bool_], breaks: NDArray[np.bool_], change: float) -> Array:
    """Return the density to add at the corners, of the highest likelihood; 0 elsewhere. change: of the rate, over the
    noise's standard deviation, 1/s: a range of it."""
    spread = [_spread(walk.steps, breaks, width * float(np.median(walk.steps))) for width in (0.0, *ROUNDED)]

    def cost(which: tuple[int, int]) -> float:
        width, size = which
        extra = (CHANGES[size] * change) ** 2 * spread[width]
        logs, left = walk.innovations(_density(walk, used, extra, COARSELY) + extra)
        return _cost_of_corners(logs, left[used])

    known = {(0, size): cost((0, size)) for size in range(len(CHANGES))}
    best = min(known, key=known.__getitem__)
    for width in range(1, len(spread)):
        for size in range(max(best[1] - 1, 0), min(best[1] + 2, len(CHANGES))):
            known[width, size] = cost((width, size))
        best = min(known, key=known.__getitem__)
    return np.asarray((CHANGES[best[1]] * change) ** 2 * spread[best[0]], dtype=np.float64)


def _spread(steps: Array, breaks: NDArray[np.bool_], lasts_s: float) -> Array:
    """Return in which steps the rate changes at corners that last at least so long, about the middle of the breaks that
    make them: the density of a change whose mean square over a corner is 1, (steps,), 1/s."""
    edges = np.concatenate((np.zeros(1), np.cumsum(steps)))
    first = np.flatnonzero(breaks & ~np.append(False, breaks[:-1]))
    last = np.flatnonzero(breaks & ~np.append(breaks[1:], False))
    out, rounding = np.zeros(steps.size), 1e-9 * edges[-1]
    for a, b in zip(edges[first], edges[last + 1], strict=True):
        middle, half = 0.5 * (a + b), 0.5 * max(lasts_s, b - a) + rounding
        begin = int(np.searchsorted(edges, middle - half))
        end = max(int(np.searchsorted(edges, middle + half)) - 1, begin + 1)  # the last edge inside
        out[begin:end] = np.maximum(out[begin:end], 1.0 / (edges[end] - edges[begin]))
    return out


def temperature_path(
    time_s: ArrayLike, temperature_degC: ArrayLike, *, noise_K: float | None = None
) -> TemperaturePath:
    """Return the path behind noisy readings; nan readings are bridged. Arrays of shape (samples,), time increasing.

    `noise_K` sets the standard deviation of the noise instead of estimating it; 0 returns the readings as they are.
    Raises ValueError for one that is negative or no number.
    """
    check_noise(noise_K)
    time = np.ascontiguousarray(time_s, dtype=np.float64)
    readings = np.array(temperature_degC, dtype=np.float64)
    finite = np.isfinite(readings)
    lone = lone_outliers(readings, finite)
    used = finite.copy()
    used[lone] = False
    known = np.flatnonzero(used)
    first, end = (int(known[0]), int(known[-1]) + 1) if known.size else (0, time.size)
    if end - first < time.size:  # before the first reading and after the last one it stands: nothing says where it goes
        within = slice(first, end)
        return _padded(temperature_path(time[within], readings[within], noise_K=noise_K), first, time.size - end, lone)
    if not np.all(used):
        readings = np.interp(time, time[used], readings[used])
    span = float(np.ptp(readings)) if readings.size else 0.0
    if readings.size < 8 or span == 0.0 or noise_K == 0.0:
        return TemperaturePath(readings, turning_points(readings, 0.0), 0.0, lone)
    trusted = used.copy()
    steps = np.diff(time)
    extra = np.zeros(steps.size)  # density at the corners
    density, variance = 1.0, 0.0
    for _ in range(4):
        walk = _Walk(steps, readings, used)
        density = _density(walk, used, extra)
        left = walk.innovations(density + extra)[1]
        variance = _variance(left[used])
        if math.sqrt(variance) < NEGLIGIBLE * span:
            break
        used = trusted & _trusted(left / math.sqrt(variance))
        walk = _Walk(steps, readings, used)
        rate = walk.smooth(density + extra)[1]
        breaks = _breaks(rate, extra > 0.0)
        if np.array_equal(breaks, extra > 0.0):
            break
        extra = np.where(breaks, (CORNER * np.ptp(rate)) ** 2 / (variance * steps), 0.0)
    if np.any(extra) and math.sqrt(variance) >= NEGLIGIBLE * span:
        extra = _corners(walk, used, extra > 0.0, float(np.ptp(rate)) / math.sqrt(variance))
        density = _density(walk, used, extra)
        variance = _variance(walk.innovations(density + extra)[1][used])
    sigma = math.sqrt(variance) if noise_K is None else noise_K
    outliers = np.flatnonzero(finite & ~used)
    coarse = noise_K is None and span > WIDE_K and sigma > COARSE * span
    if sigma < NEGLIGIBLE * span or coarse:
        return TemperaturePath(readings, turning_points(readings, 0.0), 0.0, lone)
    for _ in range(12):
        smooth = walk.smooth(density + extra)[0]
        if float(np.mean((readings[used] - smooth[used]) ** 2)) < (STRAY * sigma) ** 2:
            break
        density *= 10.0
    turning = turning_points(smooth, REVERSAL * sigma)
    return TemperaturePath(_monotone(smooth, turning), turning, sigma, outliers)


def _padded(path: TemperaturePath, before: int, after: int, lone: NDArray[np.int64]) -> TemperaturePath:
    """Return the path with so many more rows at its ends, in which the temperature stands."""
    count = before + path.temperature_degC.size + after
    turning = np.unique(np.concatenate(([0], path.turning[1:-1] + before, [count - 1])))
    degC = np.pad(path.temperature_degC, (before, after), mode="edge")
    return TemperaturePath(degC, turning, path.noise_K, np.union1d(path.outliers + before, lone))


def _monotone(smooth: Array, turning: NDArray[np.int64]) -> Array:
    """Return the path between its turning points: the monotone least-squares fit."""
    path = np.empty_like(smooth)
    for first, last in pairwise(turning):
        rises = bool(smooth[last] >= smooth[first])
        start = first if first == 0 else first + 1
        run = isotonic_regression(smooth[start : last + 1], increasing=rises).x
        if first > 0:
            run = np.maximum(run, path[first]) if rises else np.minimum(run, path[first])
        path[start : last + 1] = run
    return path


def _trusted(innovations: Array) -> NDArray[np.bool_]:
    """Return False for lone outliers: an innovation beyond the gate whose successor turns back as sharply."""
    far = np.abs(innovations) > GATE
    back = np.zeros(innovations.size, dtype=np.bool_)
    back[:-1] = (innovations[1:] * innovations[:-1] < 0.0) & (np.abs(innovations[1:]) > 0.4 * np.abs(innovations[:-1]))
    back[1:] &= ~(far[:-1] & back[:-1])
    return np.asarray(~(far & back), dtype=np.bool_)


def _breaks(rates: Array, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the steps in which the smoothed rate changes by far more than usual, those known and their neighbours."""
    change = np.abs(np.diff(rates))
    usual = 1.4826 * float(np.median(change)) + 1e-300
    sharp = change > BREAK * usual
    for k in (-1, 1):  # only the sharpest of a run: a corner is one step
        sharp &= change >= np.roll(change, k)
    wide = sharp.copy()
    wide[1:] |= sharp[:-1]
    wide[:-1] |= sharp[1:]
    return np.asarray(wide | known, dtype=np.bool_)
