"""Whether what a fit leaves of a film comes again each time that the film goes through the same temperatures.

Domains that switch one by one switch at the same temperature each time, and what a smooth density lacks there comes
again in each pass of the same direction. What happens to the film at some time, or to its meter, does not. Between
pairs of passes the steps that the residual makes from one place to the next are multiplied: by chance the products add
up to nothing, with a variance that is the sum of their squares. Steps are asked twice: as they are, and over the
deviation that domains are expected to bring there. As they are, one jump of a decade that few passes have a row in
outvotes all others of a film of few domains; over what is expected, places where a fit expects nothing do, of a film
that it does not quite describe.

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
from sim.diagnosis.data.record import Mask
from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.domain_noise import DomainNoise, relays_apart_K
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.inference.readings.temperature_path import turning_points

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


def repeated(channel: ResistanceChannel, fit: ResistanceFit, domains: DomainNoise) -> tuple[Repeated, Repeated]:
    """What the fit leaves, less the ohmmeter's noise; as it is, and over what is expected."""
    rows, noise = channel.rows, domains.noise
    walk = noise.wandering
    assert walk is not None
    d = walk.smoothed((channel.output - fit.shown)[rows], rows, noise.at(channel.output[rows]))
    apart_K = PLACE * min(domains.reach_K, relays_apart_K(channel))
    return agreement(channel.film_degC(fit), d, walk, channel.fitted, apart_K)


def agreement(film_degC: Array, left: Array, walk: Wandering, told: Mask, apart_K: float) -> tuple[Repeated, Repeated]:
    """Of what came from row to row, which is what is left less what is left of the row before, at places so far apart,
    or as far as rows are; as it is, and over what is expected. film_degC, left: (rows,); told: rows that were read and
    fitted, (rows,)."""
    came = np.cumsum(left - walk.keep * np.concatenate(([0.0], left[:-1])))
    variance = np.cumsum(walk.added)
    apart_K = max(apart_K, _rows_apart_K(film_degC))
    places = np.arange(float(np.min(film_degC)), float(np.max(film_degC)), apart_K)
    each = [passes(film_degC, rising) for rising in (True, False)]
    steps = [[_steps(film_degC[p], came[p], told[p], places) for p in ways] for ways in each]
    expected = [[_steps(film_degC[p], variance[p], told[p], places) for p in ways] for ways in each]
    over = [[_over(*both) for both in zip(*ways, strict=True)] for ways in zip(steps, expected, strict=True)]
    return _alike(steps), _alike(over)


def _alike(directions: list[list[Array]]) -> Repeated:
    """directions: of each, the steps from place to place of each pass, (places - 1,), nan where nothing is known."""
    products = total = squares = 0.0
    for one, two in itertools.chain.from_iterable(itertools.combinations(steps, 2) for steps in directions):
        both = np.isfinite(one) & np.isfinite(two)
        product = one[both] * two[both]
        products += float(np.sum(product))
        squares += float(product @ product)
        total += math.sqrt(float(np.sum(one[both] ** 2)) * float(np.sum(two[both] ** 2)))
    if squares == 0.0 or total == 0.0:
        return Repeated(0.0, 0.0)
    return Repeated(products / math.sqrt(squares), products / total)


def _over(steps: Array, variance: Array) -> Array:
    """Steps over their deviation, nan where none is expected."""
    variance = np.abs(variance)
    return np.asarray(steps / np.sqrt(np.where(variance > 0.0, variance, np.nan)), dtype=np.float64)


def _rows_apart_K(film_degC: Array) -> float:
    """By how much the film's temperature changes from row to row about a temperature that it goes through: the mean
    over temperatures, not over rows, most of which may be of a film that stands."""
    moved = np.abs(np.diff(film_degC))
    return float(moved @ moved) / max(float(np.sum(moved)), SOME)


def _steps(film_degC: Array, until: Array, told: Mask, places_degC: Array) -> Array:
    """From place to place; nan beyond the pass, and where not both rows about a place are told. film_degC, until (what
    came until each row), told: of one pass, (rows,)."""
    if film_degC[-1] < film_degC[0]:
        film_degC, until, told = film_degC[::-1], until[::-1], told[::-1]
    along = np.maximum.accumulate(film_degC)
    here = np.interp(places_degC, along, until, left=np.nan, right=np.nan)
    both = np.interp(places_degC, along, told.astype(np.float64), left=0.0, right=0.0) == 1.0
    return np.diff(np.where(both, here, np.nan))


def passes(film_degC: Array, rising: bool) -> list[slice]:
    """The rows of each way from one turn to the next in one direction."""
    ends = itertools.pairwise(turning_points(film_degC, TURN_K).tolist())
    return [slice(a, b + 1) for a, b in ends if (film_degC[b] > film_degC[a]) == rising and b - a >= FEWEST_ROWS]
