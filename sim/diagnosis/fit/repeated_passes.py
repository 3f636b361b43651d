"""Whether what a fit leaves of a film comes again each time that the film goes through the same temperatures.

Domains that switch one by one switch at the same temperature each time, and what a smooth density lacks there comes
again in each pass of the same direction. What happens to the film at some time, or to its meter, does not. Between
pairs of passes the steps that the residual makes from one place to the next are multiplied: by chance the products add
up to nothing, with a variance that is the sum of their squares.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.identification.temperature_smoother import turning_points
from sim.diagnosis.fit.domain_noise import DomainNoise, relays_apart_K
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit

TURN_K: Final = 0.5  # back, from which a film has turned round: more than a thermometer's noise, less than a loop
PLACE: Final = 0.5  # how far places are apart: of the distance over which a deviation is forgotten, or of the relays'
FEWEST_ROWS: Final = 5  # of a pass


@dataclass(frozen=True)
class Repeated:
    """deviations: by how many standard deviations of chance the passes agree; share: their mean correlation; 0 where no
    two passes go the same way through the same temperatures."""

    deviations: float
    share: float


def repeated(channel: ResistanceChannel, fit: ResistanceFit, domains: DomainNoise) -> Repeated:
    """What the fit leaves, less the ohmmeter's noise."""
    rows, noise = channel.rows, domains.noise
    assert noise.wandering is not None
    residual = (channel.output - fit.shown)[rows]
    d = noise.wandering.smoothed(residual, rows, noise.at(channel.output[rows]))
    film_degC = channel.film_degC(fit)
    return agreement(film_degC, d, PLACE * min(domains.reach_K, relays_apart_K(channel)))


def agreement(film_degC: Array, left: Array, apart_K: float) -> Repeated:
    """Of what is left, at places so far apart. film_degC, left: (rows,)."""
    places = np.arange(float(np.min(film_degC)), float(np.max(film_degC)), apart_K)
    products = total = squares = 0.0
    for rising in (True, False):
        steps = [_steps(film_degC[part], left[part], places) for part in passes(film_degC, rising)]
        for one, two in itertools.combinations(steps, 2):
            both = np.isfinite(one) & np.isfinite(two)
            product = one[both] * two[both]
            products += float(np.sum(product))
            squares += float(product @ product)
            total += math.sqrt(float(np.sum(one[both] ** 2)) * float(np.sum(two[both] ** 2)))
    if squares == 0.0 or total == 0.0:
        return Repeated(0.0, 0.0)
    return Repeated(products / math.sqrt(squares), products / total)


def _steps(film_degC: Array, left: Array, places_degC: Array) -> Array:
    """From place to place, nan beyond the pass. film_degC, left: of one pass, (rows,)."""
    if film_degC[-1] < film_degC[0]:
        film_degC, left = film_degC[::-1], left[::-1]
    along = np.maximum.accumulate(film_degC)
    return np.diff(np.interp(places_degC, along, left, left=np.nan, right=np.nan))


def passes(film_degC: Array, rising: bool) -> list[slice]:
    """The rows of each way from one turn to the next in one direction."""
    ends = itertools.pairwise(turning_points(film_degC, TURN_K).tolist())
    return [slice(a, b + 1) for a, b in ends if (film_degC[b] > film_degC[a]) == rising and b - a >= FEWEST_ROWS]
