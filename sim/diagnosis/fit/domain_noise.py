"""What a film of a finite number of domains does besides: they switch one by one, where no smooth density has them.

A film whose output changes by dy owes it to dy / s domains of s decades each, and as many more or less as chance has
placed there: the variance that comes with it is s |dy|, the square of each step times their number. What so many have
gained or lost is made up for within the distance r over which a smooth film follows the measured one, so that the
deviation is forgotten as exp(-|dT| / r):

    d(k+1) = exp(-|T(k+1) - T(k)| / r) d(k) + w(k),   <w^2> = s |y(k+1) - y(k)|

A film that stands still has none of it, and there the ohmmeter's own noise is told. The three numbers are those of the
largest likelihood of what a fit leaves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.noise_model import NoiseModel, by_reading, root_mean_square
from sim.diagnosis.data.record import Mask, Rows
from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit

REACH: Final = (0.1, 3.0)  # of the least distance of the relays' centres: what is longer, relays follow themselves
STEPS: Final = (math.log(1e-7), 0.0)  # decades, in logarithms: from ten million domains to one for a decade
FIRST_STEPS: Final = (math.log(1e-4), math.log(1e-2))  # where the search begins
LOOKED_AT: Final = (3e-5, 3e-4, 3e-3, 3e-2)  # decades: at a third of the best one the likelihood gains most of it
BEGIN: Final = 0.3  # of what is left that is the ohmmeter's, to begin with
Bounds = list[tuple[float, float]]
END: Final[Any] = {"xatol": 0.01, "fatol": 0.1, "maxiter": 400}  # a hundredth of each; a tenth of log-likelihood
SOME: Final = 1e-12  # of a noise, where nothing is left at all


@dataclass(frozen=True, eq=False)
class DomainNoise:
    """step_dec, reach_K: s and r of the equations above; noise: of the ohmmeter, with what domains do besides; gain: of
    the log-likelihood over the same ohmmeter's noise alone, at its best size."""

    step_dec: float
    reach_K: float
    noise: NoiseModel
    gain: float

    def stands(self, rows: Rows, readings: Array) -> Mask:
        """Rows of the record, (rows,), in which too few domains switch to show beside the ohmmeter's noise. readings:
        of these rows."""
        assert self.noise.wandering is not None
        return self.noise.wandering.whitening(rows, self.noise.at(readings, rows)).stands

    def alike(self, other: DomainNoise, share: float) -> bool:
        """Whether another estimate says about the same."""
        pairs = ((self.step_dec, other.step_dec), (self.reach_K, other.reach_K), (self.noise.level, other.noise.level))
        return all(abs(math.log(one / two)) < share for one, two in pairs)


def domain_noise(channel: ResistanceChannel, fit: ResistanceFit, least_dec: float) -> DomainNoise:
    """As what the fit leaves shows it, beside an ohmmeter's noise that is as the channel has it at other readings, or
    the same at all: a film that jumps may have passed for noise where it does. least_dec: of the ohmmeter's noise."""
    left = _Left.of(channel, fit)
    shapes, found = [NoiseModel.white(channel.noise.level)], channel.noise
    if found.edges.size:
        shapes.append(NoiseModel(found.level, found.edges, found.deviations))
    value, log, own = max(((*left.likeliest(shape, least_dec), shape) for shape in shapes), key=lambda one: one[0])
    size, step_dec, reach_K = (float(v) for v in np.exp(log))
    wandering = left.wandering(step_dec, reach_K)
    wanders = by_reading(left.readings, wandering.deviation[left.rows])
    deviations = size * own.deviations
    noise = replace(own, deviations=deviations, level=size * own.level, wandering=wandering, wanders=wanders)
    return DomainNoise(step_dec, reach_K, noise, value - left.alone(own))


def steps_may_show(channel: ResistanceChannel, fit: ResistanceFit, worth: float) -> bool:
    """Whether steps of some size would raise the likelihood by so much, beside a white noise: a look at a few, since a
    record nearly always shows none."""
    left, white = _Left.of(channel, fit), NoiseModel.white(channel.noise.level)
    alone, reach_K = left.alone(white), math.sqrt(left.reaches_K[0] * left.reaches_K[1])
    rms = root_mean_square(left.residual) + SOME
    for step_dec in LOOKED_AT:
        wandering = left.wandering(step_dec, reach_K)
        for share in (BEGIN, 1.0):
            noise = np.full(left.rows.size, share * rms)
            if wandering.whitening(left.rows, noise).log_likelihood(left.residual) > alone + worth:
                return True
    return False


def relays_apart_K(channel: ResistanceChannel) -> float:
    """The least distance of the relays' centres."""
    return float(np.min(np.diff(np.unique(channel.basis.plane.centre_degC))))


@dataclass(frozen=True, eq=False)
class _Left:
    """moved_K, changed: of each row since the one before, the film's temperature and output, (rows of the record,);
    begins: rows before which nothing is known; rows, readings, residual: those fitted; reaches_K: least and most."""

    moved_K: Array
    changed: Array
    begins: Rows
    rows: Rows
    readings: Array
    residual: Array
    reaches_K: tuple[float, float]

    @classmethod
    def of(cls, channel: ResistanceChannel, fit: ResistanceFit) -> _Left:
        spacing_K = relays_apart_K(channel)
        return cls(
            _since_before(channel.film_degC(fit)),
            _since_before(fit.film_output),
            channel.record.first_rows,
            channel.rows,
            channel.output[channel.rows],
            (channel.output - fit.shown)[channel.rows],
            (REACH[0] * spacing_K, REACH[1] * spacing_K),
        )

    def wandering(self, step_dec: float, reach_K: float) -> Wandering:
        keep, added = np.exp(-self.moved_K / reach_K), step_dec * self.changed
        keep[self.begins], added[self.begins] = 0.0, 0.0
        return Wandering(keep, added)

    def alone(self, shape: NoiseModel) -> float:
        """Log-likelihood with an ohmmeter's noise of this shape alone, at its best size."""
        at = shape.at(self.readings)
        size = root_mean_square(self.residual / at) + SOME
        return -0.5 * self.residual.size - math.fsum(np.log(size * at))

    def likeliest(self, shape: NoiseModel, least_dec: float) -> tuple[float, Array]:
        """The largest log-likelihood with domains, and the logarithms of the noise's size, of s and of r."""
        at = shape.at(self.readings)
        smallest = least_dec / shape.level
        rms = max(root_mean_square(self.residual / at), smallest)
        least, most = (math.log(reach_K) for reach_K in self.reaches_K)
        bounds: Bounds = [(math.log(smallest), math.log(2.0 * rms)), STEPS, (least, most)]

        def minus(log: Any) -> float:
            size, step_dec, reach_K = (float(v) for v in np.exp(log))
            return -self.wandering(step_dec, reach_K).whitening(self.rows, size * at).log_likelihood(self.residual)

        size, reach = math.log(max(BEGIN * rms, smallest)), 0.5 * (least + most)
        first: list[Any] = [np.array([size, step, reach]) for step in FIRST_STEPS]
        ends = [minimize(minus, x, method="Nelder-Mead", bounds=bounds, options=END) for x in first]
        best = min(ends, key=lambda end: float(end.fun))
        return -float(best.fun), np.asarray(best.x)


def _since_before(values: Array) -> Array:
    """By how much each row's value is another than the one before, (rows,)."""
    return np.abs(np.diff(values, prepend=values[:1]))
