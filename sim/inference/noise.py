"""Noise of one channel: white noise, a slow discrepancy between model and rig, an instrument's colour, rounding.

    residual(t_k) = d(t_k) + e_k,     e_k ~ N(0, white^2 v_k)
    <d(t) d(t + x)> = slow^2 (1 + x / l) exp(-x / l),     tau = 2 l, the integral of the correlation

d is a Gaussian process with a continuous rate (Matern's of order 3/2): what a model lacks is heat, and a temperature is
its integral. A rougher process would take the thermometer's noise for its own. Its size and its correlation time tau
are estimated with the white noise by maximum likelihood, and its size is 0 where it does not make the residual
significantly likelier. Evidence and intervals are thereby discounted by themselves wherever a model is wrong
(M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). A Kalman filter of two states whitens residuals and
columns of a Jacobian alike, in a time linear in the rows and at any distances between them; its smoother gives d itself
(J. Hartikainen, S. Sarkka, IEEE MLSP (2010) 379).

v_k is 1, or larger for a reading that lies far out: the weight of P. J. Huber, Robust Statistics (Wiley 1981), ch. 7,
written as a variance. A slow part that is there at rest as in motion is no discrepancy but the colour of the
instrument's noise, as a filter or 1/f noise makes it. A reading that was rounded says only that the value before lay
within half a step; its likelihood is that of the interval.

A film has a further discrepancy, which is no process in time but comes again whenever its memory does (`Repeated`):
columns with normal coefficients of one variance, which the evidence chooses (D. MacKay, Neural Computation 4 (1992)
415).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.optimize import minimize, minimize_scalar
from scipy.special import chdtri, log_ndtr

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from sim.inference.evidence import price
from sim.inference.kalman import filter_gains, smoothed, whitened

if TYPE_CHECKING:
    from sim.inference.joint.domains import Domains

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
BRIEF: Final = 5.0  # steps: colour that a filter makes lasts no longer
FLICKER: Final = 3.0  # white noises: 1/f noise over an hour's record is no larger
LONG_REST: Final = 5.0  # correlation times within which nothing moves at rest, and a mean is taken off
ENOUGH_REST: Final = 10.0  # the same in all: a variance is then known to a half
ALIKE: Final = 0.5  # of the mean square in motion: at rest it is as large, but for chance
LEVELS: Final = 8  # of what is shown, between which the size of the white noise may change
A_LEVEL: Final = 100  # readings: a variance is then known to a fifth
MEDIANS: Final = 0.19  # of the information on a variance: a median has 0.37 (Huber, ch. 5), neighbours' bends half
FARTHER: Final = math.log(30.0)  # of size and time of a discrepancy, by factors: what a fit of a few numbers hides
UNDETERMINED: Final = 1e-9  # of a parameter's information: above rounding where two of them do the same
LOG_SHARE: Final = (-4.0, 1.0)  # bounds of ln(noise / step): below a fiftieth of a step no noise is seen
LEAST_KNOWN: Final = 1e-6  # of a reading's information: it is divided by


@njit
def _matern(steps: Array, length: float, ratio: float) -> Array:
    """Return the moves (`kalman`) of d and its rate over steps (s, nan where a record begins) for white = 1.

    length: l, s; ratio: slow^2 / white^2.
    """
    out = np.zeros((steps.size, 7))
    rate = 1.0 / (length * length)
    for k in range(steps.size):
        if k > 0 and steps[k] == steps[k - 1]:
            out[k] = out[k - 1]
        elif math.isnan(steps[k]):
            out[k, 4], out[k, 6] = ratio, ratio * rate
        else:
            x = steps[k] / length
            fade = math.exp(-x)
            a, b, c, e = fade * (1.0 + x), fade * steps[k], -fade * x / length, fade * (1.0 - x)
            out[k, 0], out[k, 1], out[k, 2], out[k, 3] = a, b, c, e
            out[k, 4], out[k, 5] = ratio * (1.0 - a * a - b * b * rate), -ratio * (a * c + b * e * rate)
            out[k, 6] = ratio * (rate - c * c - e * e * rate)
    return out


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
        self.noise, self._columns = noise, None
        variance = readings.variance
        if repeated is not None:
            variance = variance + noise.step / noise.white**2 * repeated.rest
        self._moves = _matern(readings.steps_s, 0.5 * noise.tau_s, noise.ratio)
        self._gains = filter_gains(self._moves, variance)
        self._gains[:, 2] /= noise.white
        self.log_scale = float(np.sum(np.log(self._gains[:, 2])))
        if repeated is not None:
            columns = self.in_time(repeated.columns)
            sizes, ways = np.linalg.eigh(columns.T @ columns)
            more = 1.0 + noise.step * np.maximum(sizes, 0.0)
            self.log_scale -= 0.5 * float(np.sum(np.log(more)))
            seen = more > 1.0 + NEGLIGIBLE  # the others are as good as white
            less = (1.0 - more[seen] ** -0.5) / sizes[seen]
            self._columns = columns @ (ways[:, seen] * np.sqrt(less))

    def in_time(self, columns: Array) -> Array:
        """The columns over what goes on in time alone."""
        values = np.ascontiguousarray(columns.reshape(columns.shape[0], -1))
        return whitened(self._moves, self._gains, values).reshape(columns.shape)

    def of(self, columns: Array) -> Array:
        """The columns, (readings, columns) or (readings,), in units of the noise."""
        out = self.in_time(columns)
        if self._columns is not None:
            out = out - self._columns @ (self._columns.T @ out)
        return out

    def log_likelihood(self, residual: Array) -> float:
        """Of a residual, without the constant of 2 pi."""
        white = self.of(residual)
        return self.log_scale - 0.5 * float(white @ white)


def _profile(residual: Array, readings: Readings, ratio: float, tau_s: float) -> tuple[float, float]:
    """(-2 log-likelihood with the white variance at its best, without constants; that variance)."""
    whitening = Whitening(Noise(1.0, math.sqrt(ratio), tau_s), readings)
    square = whitening.in_time(residual)
    white = max(float(square @ square) / residual.size, 1e-300)
    return residual.size * math.log(white) - 2.0 * whitening.log_scale, white


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
        value, white = _profile(residual, readings, ratio, tau)
        return value if ratio * white <= most_slow**2 else NOT_ALLOWED

    log_tau = math.log(max(least_tau_s, step)), math.log(10.0 * span)
    alone, white = _profile(residual, readings, 0.0, step)
    times = [step * time for time in TIMES if time * step < 3.0 * span]
    starts = [(math.log(ratio), math.log(time)) for ratio in RATIOS for time in times]
    if near is not None and near.slow > 0.0:
        starts = [(math.log(near.ratio), math.log(near.tau_s))]
    best = min((np.array(start) for start in starts), key=cost, default=None)
    if best is not None:
        found = minimize(cost, best, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02, "maxiter": 200})
        if 0.5 * (alone - found.fun) > SIGNIFICANT:
            ratio, tau = math.exp(np.clip(found.x[0], *LOG_RATIO)), math.exp(np.clip(found.x[1], *log_tau))
            white = _profile(residual, readings, ratio, tau)[1]
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
        noise = Noise(1.0, math.sqrt(before.ratio), before.tau_s)
        rest = replace(readings, variance=readings.variance + ratio * repeated.rest)
        whitening = Whitening(noise, rest)
        columns, white = whitening.in_time(repeated.columns), whitening.in_time(residual)
        inner = columns.T @ white
        factor = cho_factor(np.eye(inner.size) + ratio * (columns.T @ columns))
        coefficients = ratio * cho_solve(factor, inner)
        variance = max(float(white @ white - inner @ coefficients) / white.size, 1e-300)
        logs = np.sum(np.log(np.diag(factor[0]))) - whitening.log_scale
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
    moves = _matern(readings.steps_s, 0.5 * noise.tau_s, noise.ratio)
    found = smoothed(moves, filter_gains(moves, readings.variance), residual)
    return found[:, 0], noise.white * np.sqrt(np.maximum(found[:, 2], 0.0))


def variances(residual: Array, noise: Noise, readings: Readings) -> Array:
    """v_k of each reading: 1, and more beyond `FAR_OUT` standard deviations of what all others let expect of it."""
    mean, deviation = discrepancy(residual, noise, readings)
    known = 1.0 - (deviation / noise.white) ** 2 / readings.variance  # share of a reading that is its own noise
    alone = np.abs(residual - mean) / (noise.white * np.sqrt(readings.variance * np.maximum(known, 1e-3)))
    size = alone * np.sqrt(readings.variance)  # in white noises, whatever it weighed before
    return np.maximum(1.0, size / FAR_OUT)


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """The noise of one channel's used readings, and the map that makes it white. of_instrument: its slow part is the
    colour of the instrument's noise, and no discrepancy of the model; domains: the discrepancy over a film's memory,
    where the film is one of domains; step: to which readings are rounded whose likelihood is that of their intervals,
    all noise white; 0: they count as they are."""

    noise: Noise
    readings: Readings
    of_instrument: bool = False
    domains: Domains | None = None
    step: float = 0.0

    @cached_property
    def whitening(self) -> Whitening:
        return Whitening(self.noise, self.readings, self.domains)

    @property
    def log_scale(self) -> float:
        """The part of the log-likelihood that does not depend on the residual."""
        return self.whitening.log_scale

    def white(self, size: float) -> ChannelNoise:
        """The same readings with noise of which nothing goes on in time."""
        return replace(self, noise=Noise(size, step=self.noise.step), of_instrument=False)

    def restricted(self, residual: Array, columns: Array, precision: Array) -> ChannelNoise:
        """The same with the discrepancy of the highest likelihood once the parameters are integrated out: a fit takes
        part of a slow discrepancy for its own, and what it leaves seems smaller and shorter than it is
        (H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545).

        columns: changes of the readings by the parameters, (readings, parameters); precision: what else is known of
        these, (parameters, parameters)."""
        if self.noise.slow == 0.0 or self.of_instrument:
            return self
        size = np.sqrt(np.sum(self.whitening.of(columns) ** 2, axis=0) + np.diag(precision))
        size = np.where(size > 0.0, size, 1.0)
        every, known = np.column_stack((columns / size, residual)), precision / np.outer(size, size)
        known[np.diag_indices_from(known)] += UNDETERMINED
        start = np.log([self.noise.slow, self.noise.tau_s])

        def trial(place: Array) -> ChannelNoise:
            slow, tau_s = np.exp(np.clip(place, start - FARTHER, start + FARTHER)).tolist()
            return replace(self, noise=replace(self.noise, slow=slow, tau_s=tau_s))

        def cost(place: Array) -> float:
            whitening = trial(place).whitening
            white = whitening.of(every)
            inner = white.T @ white
            factor = cho_factor(inner[:-1, :-1] + known)
            explained = inner[:-1, -1] @ cho_solve(factor, inner[:-1, -1])
            determinant = float(np.sum(np.log(np.diag(factor[0]))))
            return float(inner[-1, -1] - explained) + 2.0 * (determinant - whitening.log_scale)

        return trial(minimize(cost, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.02}).x)

    def without_slow(self) -> ChannelNoise:
        """The same size of noise, all of it white but for the instrument's colour."""
        return self if self.of_instrument else self.white(math.hypot(self.noise.white, self.noise.slow))


@dataclass(frozen=True, eq=False)
class Metric:
    """The noise of both channels; output: None without a film. simulated: whether a current drives the plate; if not,
    the thermometer's discrepancy is all of the path and says how well that is known: it stays as it is."""

    temperature: ChannelNoise
    output: ChannelNoise | None
    simulated: bool = True

    @property
    def channels(self) -> list[ChannelNoise]:
        return [channel for channel in (self.temperature, self.output) if channel is not None]

    def tight(self) -> Metric:
        """The metric of the white noise alone, where the discrepancy is larger: the least error of the simulation."""
        channels = [
            channel
            if channel is None or channel.of_instrument or channel.noise.slow <= channel.noise.white
            else channel.white(channel.noise.white)
            for channel in (self.temperature, self.output)
        ]
        return self.of(channels[0] or self.temperature, channels[1])

    def without_slow(self) -> Metric:
        """The metric of a model that explains everything: no discrepancy, noise of the same size."""
        return self.of(self.temperature.without_slow(), self.output.without_slow() if self.output else None)

    def of(self, temperature: ChannelNoise, output: ChannelNoise | None) -> Metric:
        """Other noise, but for the thermometer's where that is the path."""
        return Metric(temperature if self.simulated else self.temperature, output, self.simulated)


def of_rounded(residual: Array, step: float, white: float) -> tuple[Array, Array, Array]:
    """(log-likelihood of each rounded reading, comparable to that of one that is not; the mean of its noise given the
    interval that it was rounded from, over the noise; the share of its information that it kept), each (readings,).
    residual: reading less what is shown."""
    sign = np.where(residual < 0.0, -1.0, 1.0)
    low, high = (np.abs(residual) - 0.5 * step) / white, (np.abs(residual) + 0.5 * step) / white
    most, least = log_ndtr(-low), log_ndtr(-high)
    logs = most + np.log1p(-np.exp(np.minimum(least - most, -1e-300)))
    density = math.log(step) - 0.5 * math.log(2.0 * math.pi)  # as of readings that are not rounded
    at_low, at_high = (np.exp(-0.5 * end**2 - 0.5 * math.log(2.0 * math.pi) - logs) for end in (low, high))
    mean = at_low - at_high
    known = np.clip(mean**2 - (low * at_low - high * at_high), LEAST_KNOWN, 1.0)
    return logs - density, sign * mean, known


def likelier_of_rounded(residual: Array, step: float, channel: ChannelNoise) -> ChannelNoise:
    """The noise before readings were rounded, or another that takes rounding for noise of its own: what a model is off
    by, no likelihood of intervals has, and it exceeds a step soon."""
    white = noise_before_rounding(residual, step)
    of_intervals = float(np.sum(of_rounded(residual, step, white)[0]))
    if of_intervals < channel.whitening.log_likelihood(residual):
        return channel
    return ChannelNoise(Noise(white), replace(channel.readings, variance=np.ones(residual.size)), step=step)


def noise_before_rounding(residual: Array, step: float) -> float:
    """Return the likeliest white noise of readings before they were rounded."""

    def cost(log_share: float) -> float:
        return -float(np.sum(of_rounded(residual, step, math.exp(log_share) * step)[0]))

    return step * math.exp(minimize_scalar(cost, bounds=LOG_SHARE, method="bounded", options={"xatol": 0.01}).x)


def estimated_noise(
    residual: Array,
    readings: Readings,
    error: Array,
    least: float,
    most: float,
    start: ChannelNoise | None = None,
    shown: Array | None = None,
) -> ChannelNoise:
    """Noise of a residual with readings far out weighing less. error: what each reading is off by besides; start: a
    noise to begin with, and the discrepancy that comes again; shown: by what the white noise's size may differ."""
    far, level, domains = np.ones(residual.size), np.ones(residual.size), start.domains if start else None
    noise = Noise(max(float(np.sqrt(np.mean(residual**2))), least))
    if start is not None and (domains is not None or start.noise.slow > 0.0):
        noise = start.noise
    for _ in range(3):
        more, before = (error / noise.white) ** 2, noise
        readings, left = replace(readings, variance=level * far + more), residual
        if domains is None:
            noise, known = estimate(residual, readings, least, most, near=noise), readings
        else:
            noise, mean = estimate_repeated(residual, readings, domains, noise, least, most)
            left = residual - mean
            more = more + noise.step / noise.white**2 * domains.rest
            known = replace(readings, variance=level * far + more)
        if shown is not None:
            level = relative_variance(left, shown)
        again = np.maximum(variances(left, noise, known) / (np.sqrt(level) + more), 1.0)
        settled, far = np.allclose(again, far, rtol=0.1), again
        if settled and shown is None and not np.any(error) and math.isclose(noise.step, before.step, rel_tol=0.1):
            break
    return ChannelNoise(noise, readings, domains=domains)


def relative_variance(residual: Array, shown: Array) -> Array:
    """Variance of each reading's white noise over the mean one, by what is shown: an ohmmeter's noise goes with range
    and resistance. From what changes from reading to reading, since a film's misfit goes with what is shown, too; 1
    where readings of all sizes are equally noisy, (readings,)."""
    groups = np.array_split(np.argsort(shown[1:-1], kind="stable"), min(LEVELS, residual.size // A_LEVEL))
    if len(groups) < 2:
        return np.ones(residual.size)
    bends = np.abs(np.diff(residual, 2)) * MAD / math.sqrt(6.0)
    own = np.array([max(float(np.median(bends[g])), 1e-300) ** 2 for g in groups])
    mean = float(np.exp(np.mean(np.log(own))))
    gain = 0.5 * float(sum(g.size * (v / mean - 1.0 - math.log(v / mean)) for g, v in zip(groups, own, strict=True)))
    if gain * MEDIANS <= price(len(groups), residual.size):
        return np.ones(residual.size)
    middles = np.array([float(np.median(shown[1:-1][g])) for g in groups])
    found = np.exp(np.interp(shown, middles, np.log(own)))
    return np.asarray(found / np.mean(found))


def noise_of_instrument(residual: Array, channel: ChannelNoise, shown: Array) -> ChannelNoise:
    """The noise, its slow part taken for the instrument's where it is there at rest as in motion: what a model lacks
    goes with what the rig does. It lasts a few readings, as a filter makes it, or is about as large as the white noise,
    as flicker is. shown: of the used readings, without noise."""
    noise = channel.noise
    brief = noise.tau_s < BRIEF * channel.readings.step_s()
    if noise.slow == 0.0 or not (brief or noise.slow < FLICKER * noise.white):
        return channel
    mean, _ = discrepancy(residual, noise, channel.readings)
    width = max(round(LONG_REST * noise.tau_s / channel.readings.step_s()), 2)
    moved = maximum_filter1d(shown, width) - minimum_filter1d(shown, width)
    rests = moved < math.hypot(noise.white, noise.slow)
    if np.sum(rests) * channel.readings.step_s() < ENOUGH_REST * noise.tau_s:
        return channel
    quick = mean - uniform_filter1d(mean, width)  # at rest a film or plate that is off stands still
    in_motion = quick[~rests] if not np.all(rests) else quick
    return replace(channel, of_instrument=bool(np.mean(quick[rests] ** 2) > ALIKE * np.mean(in_motion**2)))
