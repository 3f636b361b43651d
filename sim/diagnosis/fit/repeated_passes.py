"""Whether what a fit leaves of a film comes again each time that the film goes through the same temperatures.

Domains that switch one by one switch at the same temperature each time, and what a smooth density lacks there comes
again in each pass of the same direction. What happens to the film at some time, or to its meter, does not. Between
pairs of passes the steps that the residual makes from one place to the next are multiplied: by chance the products add
up to nothing, with a variance that is the sum of their squares. Each step counts over the deviation that domains are
expected to bring there, or one jump of a decade would outvote all others.

A jump is only known to be between two rows, and rows of two passes are at other temperatures: places are no closer than
the rows are, and a place where no row was fitted says nothing.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.identification.temperature_smoother import turning_points
from sim.diagnosis.data.record import Mask
from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.domain_noise import DomainNoise, relays_apart_K
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit

TURN_K: Final = 0.5  # back, from which a film has turned round: more than a thermometer's noise, less than a loop
PLACE: Final = 0.5  # how far places are apart: of the distance over which a deviation is forgotten, or of the relays'
FEWEST_ROWS: Final = 5  # of a pass
SOME: Final = 1e-12  # K, of a film that never moved


@dataclass(frozen=True)
class Repeated:
    """deviations: by how many standard deviations of chance the passes agree; share: their mean correlation; 0 where no
    two passes go the same way through the same temperatures."""

    deviations: float
    share: float


def repeated(channel: ResistanceChannel, fit: ResistanceFit, domains: DomainNoise) -> Repeated:
    """What the fit leaves, less the ohmmeter's noise."""
    rows, noise = channel.rows, domains.noise
    walk = noise.wandering
    assert walk is not None
    d = walk.smoothed((channel.output - fit.shown)[rows], rows, noise.at(channel.output[rows]))
    apart_K = PLACE * min(domains.reach_K, relays_apart_K(channel))
    return agreement(channel.film_degC(fit), d, walk, channel.fitted, apart_K)


def agreement(film_degC: Array, left: Array, walk: Wandering, told: Mask, apart_K: float) -> Repeated:
    """Of what came from row to row, which is what is left less what is left of the row before, at places so far apart,
    or as far as rows are. film_degC, left: (rows,); told: rows that were read and fitted, (rows,)."""
    came = np.cumsum(left - walk.keep * np.concatenate(([0.0], left[:-1])))
    variance = np.cumsum(walk.added)
    apart_K = max(apart_K, _rows_apart_K(film_degC))
    places = np.arange(float(np.min(film_degC)), float(np.max(film_degC)), apart_K)
    products = total = squares = 0.0
    for rising in (True, False):
        each = passes(film_degC, rising)
        steps = [_steps(film_degC[p], came[p], variance[p], told[p], places) for p in each]
        for one, two in itertools.combinations(steps, 2):
            both = np.isfinite(one) & np.isfinite(two)
            product = one[both] * two[both]
            products += float(np.sum(product))
            squares += float(product @ product)
            total += math.sqrt(float(np.sum(one[both] ** 2)) * float(np.sum(two[both] ** 2)))
    if squares == 0.0 or total == 0.0:
        return Repeated(0.0, 0.0)
    return Repeated(products / math.sqrt(squares), products / total)


def _rows_apart_K(film_degC: Array) -> float:
    """By how much the film's temperature changes from row to row about a temperature that it goes through: the mean
    over temperatures, not over rows, most of which may be of a film that stands."""
    moved = np.abs(np.diff(film_degC))
    return float(moved @ moved) / max(float(np.sum(moved)), SOME)


def _steps(film_degC: Array, came: Array, variance: Array, told: Mask, places_degC: Array) -> Array:
    """From place to place over their deviation; nan beyond the pass, where not both rows about a place are told, and
    where nothing is expected. film_degC, came, variance (both until each row), told: of one pass, (rows,)."""
    if film_degC[-1] < film_degC[0]:
        film_degC, came, variance, told = film_degC[::-1], came[::-1], variance[::-1], told[::-1]
    along = np.maximum.accumulate(film_degC)
    here, until = (np.interp(places_degC, along, v, left=np.nan, right=np.nan) for v in (came, variance))
    both = np.interp(places_degC, along, told.astype(np.float64), left=0.0, right=0.0) == 1.0
    expected = np.abs(np.diff(until))
    steps = np.diff(np.where(both, here, np.nan))
    return np.asarray(steps / np.sqrt(np.where(expected > 0.0, expected, np.nan)), dtype=np.float64)


def passes(film_degC: Array, rising: bool) -> list[slice]:
    """The rows of each way from one turn to the next in one direction."""
    ends = itertools.pairwise(turning_points(film_degC, TURN_K).tolist())
    return [slice(a, b + 1) for a, b in ends if (film_degC[b] > film_degC[a]) == rising and b - a >= FEWEST_ROWS]
