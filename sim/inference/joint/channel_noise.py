"""The noise of one channel, and of both: white noise, a discrepancy, an instrument's colour, rounding.

A slow part that is there at rest as in motion is the colour of the instrument's noise, as a filter or 1/f noise makes
it; a discrepancy of the model goes with what the rig does. A reading that was rounded says only that the value before
lay within half a step; its likelihood is that of the interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr

from compensator.hysteresis.functions import Array
from sim.inference.evidence import price
from sim.inference.joint.domains import Domains
from sim.inference.noise import MAD, Noise, Readings, Whitening, discrepancy, estimate, estimate_repeated, variances

BRIEF: Final = 5.0  # steps: colour that a filter makes lasts no longer
FLICKER: Final = 3.0  # white noises: 1/f noise over an hour's record is no larger
LONG_REST: Final = 5.0  # correlation times within which nothing moves at rest, and a mean is taken off
ENOUGH_REST: Final = 10.0  # the same in all: a variance is then known to a half
ALIKE: Final = 0.5  # of the mean square in motion: at rest it is as large, but for chance
LEVELS: Final = 8  # of what is shown, between which the size of the white noise may change
A_LEVEL: Final = 100  # readings: a variance is then known to a fifth
MEDIANS: Final = 0.19  # of the information on a variance: a median has 0.37 (Huber, ch. 5), neighbours' bends half
LOG_SHARE: Final = (-4.0, 1.0)  # bounds of ln(noise / step): below a fiftieth of a step no noise is seen
LEAST_KNOWN: Final = 1e-6  # of a reading's information: it is divided by


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
