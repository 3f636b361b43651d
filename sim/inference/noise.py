"""Noise of one channel: white noise, and a slow discrepancy between the model and the rig.

    residual(t_k) = d(t_k) + e_k,     e_k ~ N(0, white^2 v_k)
    <d(t) d(t + x)> = slow^2 (1 + x / l) exp(-x / l),     tau = 2 l, the integral of the correlation

d is a Gaussian process with a continuous rate (Matern's of order 3/2): what a model lacks is heat, and a temperature is
its integral. A rougher process would take the thermometer's noise for its own. Its size and its correlation time tau
are estimated with the white noise by maximum likelihood, and its size is 0 where it does not make the residual
significantly likelier. Evidence and intervals are thereby discounted by themselves wherever a model is wrong
(M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). A Kalman filter of two states gives the likelihood, and
whitens residuals and columns of a Jacobian alike, in a time linear in the rows and at any distances between them; its
smoother gives d itself (J. Hartikainen, S. Sarkka, IEEE MLSP (2010) 379).

v_k is 1, or larger for a reading that lies far out: the weight of P. J. Huber, Robust Statistics (Wiley 1981), ch. 7,
written as a variance.

A film has a further discrepancy, which is no process in time but comes again whenever its memory does (`Repeated`):
columns with normal coefficients of one variance, which the evidence chooses (D. MacKay, Neural Computation 4 (1992)
415).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.special import chdtri

from compensator.compiled import njit
from compensator.hysteresis.functions import Array

MAD: Final = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
FAR_OUT: Final = 4.0  # standard deviations beyond which a reading weighs less: 1 in 16,000 of normal readings
SIGNIFICANT: Final = 0.5 * float(chdtri(2, 0.01))  # log-likelihood that two parameters gain in 1 of 100 by chance
RATIOS: Final = (0.05, 0.5, 5.0, 50.0)  # slow^2 / white^2 from which the likelihood is climbed
TIMES: Final = (3.0, 30.0, 300.0, 3000.0)  # tau over the median step, likewise
LASTING: Final = 3.0  # times how long what columns leave out hangs together: what goes on in time lasts longer
NEGLIGIBLE: Final = 1e-3  # of the white variance: less of what comes again is not seen
FARTHEST: Final = 10  # strides: where the likelihood still rises, nothing comes again
FLAT: Final = 1e-6  # of a log-likelihood: rounding
STRIDE: Final = 1.0  # of ln(step / white^2) between trials: a parabola through three of them is within 0.1
NOT_ALLOWED: Final = 1e300  # cost of a point outside a bound
LOG_RATIO: Final = (-12.0, 20.0)  # bounds of ln(slow^2 / white^2): a thousandth, and ten thousand times, of the noise


@njit(inline="always")
def _predicted(length: float, dt: float, ratio: float, p: Array, step: Array) -> None:
    """Step of the process by dt: its transition into step (2, 2), its covariance p (3,), of d, d and rate, rate, on."""
    x = dt / length
    fade = math.exp(-x)
    step[0, 0], step[0, 1] = fade * (1.0 + x), fade * dt
    step[1, 0], step[1, 1] = -fade * x / length, fade * (1.0 - x)
    rate = ratio / (length * length)
    a, b, c = p[0] - ratio, p[1], p[2] - rate  # from what it is without any reading
    p[0] = ratio + step[0, 0] ** 2 * a + 2.0 * step[0, 0] * step[0, 1] * b + step[0, 1] ** 2 * c
    p[1] = (
        step[0, 0] * step[1, 0] * a
        + (step[0, 0] * step[1, 1] + step[0, 1] * step[1, 0]) * b
        + step[0, 1] * step[1, 1] * c
    )
    p[2] = rate + step[1, 0] ** 2 * a + 2.0 * step[1, 0] * step[1, 1] * b + step[1, 1] ** 2 * c


@njit
def _profile(residual: Array, steps: Array, variance: Array, ratio: float, length: float) -> tuple[float, float]:
    """(-2 log-likelihood with the white variance at its best, without constants; that variance).

    steps: s since the row before, nan where a record begins; variance: v_k; ratio: slow^2 / white^2; length: l, s.
    """
    p, f = np.zeros(3), np.zeros((2, 2))
    d, rate, logs, square = 0.0, 0.0, 0.0, 0.0
    for k in range(residual.size):
        if math.isnan(steps[k]):
            d = rate = 0.0
            p[0], p[1], p[2] = ratio, 0.0, ratio / (length * length)
        else:
            _predicted(length, steps[k], ratio, p, f)
            d, rate = f[0, 0] * d + f[0, 1] * rate, f[1, 0] * d + f[1, 1] * rate
        total = p[0] + variance[k]
        innovation = residual[k] - d
        logs += math.log(total)
        square += innovation * innovation / total
        gain, gain_rate = p[0] / total, p[1] / total
        d += gain * innovation
        rate += gain_rate * innovation
        p[2] -= gain_rate * p[1]
        p[1] *= 1.0 - gain
        p[0] *= 1.0 - gain
    white = max(square / residual.size, 1e-300)
    return residual.size * math.log(white) + logs, white


@njit
def _gains(steps: Array, variance: Array, ratio: float, length: float, out: Array) -> None:
    """Filter of each row, into out (rows, 7): transition (4), gains of d and of its rate, 1 / standard deviation of the
    innovation (white = 1)."""
    p, f = np.zeros(3), np.zeros((2, 2))
    for k in range(steps.size):
        if math.isnan(steps[k]):
            f[:] = 0.0
            p[0], p[1], p[2] = ratio, 0.0, ratio / (length * length)
        else:
            _predicted(length, steps[k], ratio, p, f)
        total = p[0] + variance[k]
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = f[0, 0], f[0, 1], f[1, 0], f[1, 1]
        out[k, 4], out[k, 5], out[k, 6] = p[0] / total, p[1] / total, 1.0 / math.sqrt(total)
        p[2] -= out[k, 5] * p[1]
        p[1] *= 1.0 - out[k, 4]
        p[0] *= 1.0 - out[k, 4]


@njit
def _whiten(columns: Array, gains: Array, out: Array) -> None:
    """Each column's innovations over their standard deviation, into out (rows, columns)."""
    count = columns.shape[1]
    d, rate = np.zeros(count), np.zeros(count)
    for k in range(columns.shape[0]):
        a, b, c, e, gain, gain_rate, scale = gains[k]
        for j in range(count):
            ahead, ahead_rate = a * d[j] + b * rate[j], c * d[j] + e * rate[j]
            innovation = columns[k, j] - ahead
            d[j] = ahead + gain * innovation
            rate[j] = ahead_rate + gain_rate * innovation
            out[k, j] = innovation * scale


@njit
def _smooth(residual: Array, steps: Array, variance: Array, ratio: float, length: float, out: Array) -> None:
    """Mean and variance (white = 1) of d in each row given all rows, into out (rows, 2): Rauch, Tung and Striebel."""
    n = residual.size
    mean, cov = np.zeros((n, 2)), np.zeros((n, 3))
    ahead_cov, move = np.zeros((n, 3)), np.zeros((n, 2, 2))
    p, f = np.zeros(3), np.zeros((2, 2))
    d, rate = 0.0, 0.0
    for k in range(n):
        if math.isnan(steps[k]):
            d = rate = 0.0
            f[:] = 0.0
            p[0], p[1], p[2] = ratio, 0.0, ratio / (length * length)
        else:
            _predicted(length, steps[k], ratio, p, f)
            d, rate = f[0, 0] * d + f[0, 1] * rate, f[1, 0] * d + f[1, 1] * rate
        ahead_cov[k], move[k] = p, f
        total = p[0] + variance[k]
        innovation, gain, gain_rate = residual[k] - d, p[0] / total, p[1] / total
        d += gain * innovation
        rate += gain_rate * innovation
        p[2] -= gain_rate * p[1]
        p[1] *= 1.0 - gain
        p[0] *= 1.0 - gain
        mean[k, 0], mean[k, 1], cov[k] = d, rate, p
    for k in range(n - 2, -1, -1):
        f, q = move[k + 1], ahead_cov[k + 1]
        det = q[0] * q[2] - q[1] * q[1]
        if det <= 0.0:
            continue
        c = cov[k]
        c00, c01 = c[0] * f[0, 0] + c[1] * f[0, 1], c[0] * f[1, 0] + c[1] * f[1, 1]
        c10, c11 = c[1] * f[0, 0] + c[2] * f[0, 1], c[1] * f[1, 0] + c[2] * f[1, 1]
        g00, g01 = (c00 * q[2] - c01 * q[1]) / det, (c01 * q[0] - c00 * q[1]) / det
        g10, g11 = (c10 * q[2] - c11 * q[1]) / det, (c11 * q[0] - c10 * q[1]) / det
        x = mean[k + 1, 0] - f[0, 0] * mean[k, 0] - f[0, 1] * mean[k, 1]
        y = mean[k + 1, 1] - f[1, 0] * mean[k, 0] - f[1, 1] * mean[k, 1]
        u, v, w = cov[k + 1, 0] - q[0], cov[k + 1, 1] - q[1], cov[k + 1, 2] - q[2]
        mean[k, 0] += g00 * x + g01 * y
        mean[k, 1] += g10 * x + g11 * y
        cov[k, 0] += g00 * g00 * u + 2.0 * g00 * g01 * v + g01 * g01 * w
        cov[k, 1] += g00 * g10 * u + (g00 * g11 + g01 * g10) * v + g01 * g11 * w
        cov[k, 2] += g10 * g10 * u + 2.0 * g10 * g11 * v + g11 * g11 * w
    out[:, 0], out[:, 1] = mean[:, 0], cov[:, 0]


@dataclass(frozen=True)
class Noise:
    """Parameters of the noise of one channel: white, slow in the channel's unit; tau_s, the correlation time of d;
    step: variance of the coefficients of what comes again (`Repeated`), in the channel's unit."""

    white: float
    slow: float = 0.0
    tau_s: float = 1.0
    step: float = 0.0

    @property
    def ratio(self) -> float:
        """slow^2 / white^2."""
        return (self.slow / self.white) ** 2

    @property
    def of_a_model(self) -> tuple[float, float]:
        """Size and correlation time (s) of what a model is off by, both 0 where it is off by nothing."""
        return (self.slow, self.tau_s) if self.slow > 0.0 else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Readings:
    """When the readings of a channel were taken: time_s, rising within each record, (readings,); begins: True at the
    first reading of each record, (readings,); variance: v_k, (readings,)."""

    time_s: Array
    begins: NDArray[np.bool_]
    variance: Array

    @classmethod
    def at(cls, time_s: Array, begins: NDArray[np.bool_] | None = None) -> Readings:
        """Readings that all count fully; begins: default, the first one alone."""
        if begins is None:
            begins = np.arange(time_s.size) == 0
        return cls(time_s, begins, np.ones(time_s.size))

    @cached_property
    def steps_s(self) -> Array:
        """Time since the reading before; nan where a record begins, (readings,)."""
        return np.where(self.begins, np.nan, np.diff(self.time_s, prepend=self.time_s[:1]))

    def step_s(self) -> float:
        """The median distance of two readings of one record."""
        steps = np.diff(self.time_s)[~self.begins[1:]]
        return float(np.median(steps)) if steps.size else 1.0


@dataclass(frozen=True, eq=False)
class Repeated:
    """A discrepancy that comes again: columns with normal coefficients of one variance, `Noise.step`. columns:
    (readings, columns); rest: variance of each reading that they leave out, per step, (readings,); lasts_s: how long
    what they leave out hangs together."""

    columns: Array
    rest: Array
    lasts_s: float


class Whitening:
    """The linear map that makes a channel's noise white with variance 1: that of what goes on in time, and then, of A,
    the columns of what comes again after that map, (1 + step A A')^(-1/2)."""

    def __init__(self, noise: Noise, readings: Readings, repeated: Repeated | None = None) -> None:
        self.noise = noise
        self._gains, self._columns = _in_time(noise, readings, repeated)
        self.log_scale = float(np.sum(np.log(self._gains[:, 6])))
        if self._columns is not None:
            sizes, ways = np.linalg.eigh(self._columns.T @ self._columns)
            more = 1.0 + noise.step * np.maximum(sizes, 0.0)
            self.log_scale -= 0.5 * float(np.sum(np.log(more)))
            seen = more > 1.0 + NEGLIGIBLE  # the others are as good as white
            less = (1.0 - more[seen] ** -0.5) / sizes[seen]
            self._columns = self._columns @ (ways[:, seen] * np.sqrt(less))

    def of(self, columns: Array) -> Array:
        """The columns, (readings, columns) or (readings,), in units of the noise."""
        out = _whitened(columns, self._gains)
        if self._columns is not None:
            out = out - self._columns @ (self._columns.T @ out)
        return out

    def log_likelihood(self, residual: Array) -> float:
        """Of a residual, without the constant of 2 pi."""
        white = self.of(residual)
        return self.log_scale - 0.5 * float(white @ white)


def _in_time(noise: Noise, readings: Readings, repeated: Repeated | None) -> tuple[Array, Array | None]:
    """Filter that whitens what goes on in time, as in `_gains`, and the columns of what comes again after it."""
    variance = readings.variance
    if repeated is not None:
        variance = variance + noise.step / noise.white**2 * repeated.rest
    gains = np.empty((readings.time_s.size, 7))
    _gains(readings.steps_s, variance, noise.ratio, 0.5 * noise.tau_s, gains)
    gains[:, 6] /= noise.white
    return gains, _whitened(repeated.columns, gains) if repeated is not None else None


def _whitened(columns: Array, gains: Array) -> Array:
    values = np.ascontiguousarray(columns.reshape(columns.shape[0], -1))
    out = np.empty_like(values)
    _whiten(values, gains, out)
    return out.reshape(columns.shape)


def estimate(
    residual: Array,
    readings: Readings,
    least_white: float = 0.0,
    most_slow: float = math.inf,
    least_tau_s: float = 0.0,
    near: Noise | None = None,
) -> Noise:
    """Return the noise of the highest likelihood for a residual, (readings,).

    least_white: the white noise is not smaller: an instrument's last digit. most_slow: the discrepancy is not larger:
    without a bound it stands in for a model that is all wrong. It is 0 where it gains less than `SIGNIFICANT`.
    least_tau_s: its correlation time is no shorter than that and than the distance of readings. near: a noise with a
    discrepancy to begin with; else the likelihood is climbed from the best of many.
    """
    step, span = readings.step_s(), float(np.ptp(readings.time_s)) + readings.step_s()

    def cost(place: Array) -> float:
        ratio, tau = math.exp(np.clip(place[0], *LOG_RATIO)), math.exp(np.clip(place[1], *log_tau))
        value, white = _profile(residual, readings.steps_s, readings.variance, ratio, 0.5 * tau)
        return value if ratio * white <= most_slow**2 else NOT_ALLOWED

    log_tau = math.log(max(least_tau_s, step)), math.log(10.0 * span)
    alone, white = _profile(residual, readings.steps_s, readings.variance, 0.0, step)
    times = [step * time for time in TIMES if time * step < 3.0 * span]
    starts = [(math.log(ratio), math.log(time)) for ratio in RATIOS for time in times]
    if near is not None and near.slow > 0.0:
        starts = [(math.log(near.ratio), math.log(near.tau_s))]
    best = min((np.array(start) for start in starts), key=cost, default=None)
    if best is not None:
        found = minimize(cost, best, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "maxiter": 200})
        if 0.5 * (alone - found.fun) > SIGNIFICANT:
            ratio, tau = math.exp(np.clip(found.x[0], *LOG_RATIO)), math.exp(np.clip(found.x[1], *log_tau))
            white = _profile(residual, readings.steps_s, readings.variance, ratio, 0.5 * tau)[1]
            return Noise(max(math.sqrt(white), least_white), math.sqrt(ratio * white), tau)
    return Noise(max(math.sqrt(white), least_white))


def estimate_repeated(
    residual: Array, readings: Readings, repeated: Repeated, before: Noise, least_white: float, most_slow: float
) -> tuple[Noise, Array]:
    """Return (a likelier noise with a discrepancy that comes again; the mean of that discrepancy in each reading).

    before: a noise to begin with. First the size of what comes again is found, over the white noise, with what goes on
    in time held, then the other way round.
    """

    def at(ratio: float) -> tuple[float, float, Array]:
        """(-2 log-likelihood with the white variance at its best; that variance; mean) for a ratio step / white^2."""
        gains, columns = _in_time(Noise(1.0, math.sqrt(before.ratio), before.tau_s, ratio), readings, repeated)
        assert columns is not None
        white = _whitened(residual, gains)
        inner = columns.T @ white
        factor = cho_factor(np.eye(inner.size) + ratio * (columns.T @ columns))
        coefficients = ratio * cho_solve(factor, inner)
        variance = max(float(white @ white - inner @ coefficients) / white.size, 1e-300)
        logs = np.sum(np.log(np.diag(factor[0]))) - np.sum(np.log(gains[:, 6]))
        return float(2.0 * logs) + white.size * math.log(variance), variance, repeated.columns @ coefficients

    known = before.step > 0.0
    first = (
        math.log(before.step / before.white**2)
        if known
        else -math.log(float(np.mean(repeated.columns.var(0))) + 1e-300)
    )
    found = {0: at(math.exp(first))}
    place, stride = 0, STRIDE if known else 2.0 * STRIDE
    while abs(place) < FARTHEST and (place - 1 not in found or place + 1 not in found):
        side = 1 if place + 1 not in found else -1
        found[place + side] = at(math.exp(first + stride * (place + side)))
        if found[place + side][0] < found[place][0]:
            place += side
    low, middle, high = (found[place + side][0] if place + side in found else math.inf for side in (-1, 0, 1))
    bend = low - 2.0 * middle + high
    vertex = 0.5 * (low - high) / bend if FLAT < bend < math.inf else 0.0
    ratio = math.exp(first + stride * (place + vertex))
    _, variance, mean = at(ratio)
    white = max(math.sqrt(variance), least_white)
    readings = replace(readings, variance=readings.variance + ratio * repeated.rest)
    left = estimate(residual - mean, readings, least_white, most_slow, LASTING * repeated.lasts_s, before)
    return Noise(white, math.sqrt(left.ratio) * white, left.tau_s, ratio * variance), mean


def rough_noise(readings: Array) -> float:
    """Return the standard deviation of what changes from reading to reading, from second differences; 0 of too few."""
    bend = np.diff(readings, 2)
    return MAD * float(np.median(np.abs(bend))) / math.sqrt(6.0) if bend.size else 0.0


def discrepancy(residual: Array, noise: Noise, readings: Readings) -> tuple[Array, Array]:
    """Mean and standard deviation of d in each reading, given all of them, in the channel's unit, (readings,)."""
    found = np.empty((residual.size, 2))
    _smooth(residual, readings.steps_s, readings.variance, noise.ratio, 0.5 * noise.tau_s, found)
    return found[:, 0], noise.white * np.sqrt(np.maximum(found[:, 1], 0.0))


def variances(residual: Array, noise: Noise, readings: Readings) -> Array:
    """v_k of each reading: 1, and more beyond `FAR_OUT` standard deviations of what all others let expect of it."""
    mean, deviation = discrepancy(residual, noise, readings)
    known = 1.0 - (deviation / noise.white) ** 2 / readings.variance  # share of a reading that is its own noise
    alone = np.abs(residual - mean) / (noise.white * np.sqrt(readings.variance * np.maximum(known, 1e-3)))
    size = alone * np.sqrt(readings.variance)  # in white noises, whatever it weighed before
    return np.maximum(1.0, size / FAR_OUT)
