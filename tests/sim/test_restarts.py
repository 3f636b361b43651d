"""A fit with relays is begun again near its own envelopes, once for each set of effects, and only where that tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE
from sim.diagnosis.fit.film_prior import PriorWidths
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.search.budget import Budget
from sim.diagnosis.search.resistance_search import ResistanceSearch
from sim.diagnosis.search.restarts import GAINS, restarted
from sim.model.record_own import FilmStart

FILM = np.array([math.log(0.25), 68.0, math.log(0.25), 62.0, 0.0, 0.0, 0.0])
BEST_DEGC, EVERY_K, DEEP = 67.4, 0.2, 40.0  # the best centre on heating, how far minima are apart, how deep each is


@dataclass
class Bumpy:
    """A channel whose log-likelihood falls off from the best centre, in steps that no descent gets over."""

    square: float = 1.0
    points: list[float] = field(default_factory=list)

    def bounds(self, p: FilmParameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        far = np.full(SHAPE, 100.0)
        return -far, far, 1e-3 * far

    def mean_square(self, fit: ResistanceFit) -> float:
        return self.square

    def point(self, p: FilmParameters, x: np.ndarray, guess: np.ndarray) -> Any:
        assert p.x is x
        self.points.append(float(x[1]))
        return cast(Any, _Point(self._of(float(x[1]))))

    def following(self, fit: ResistanceFit) -> Any:
        return lambda move: fit.coefficients

    def descend(self, p: FilmParameters, steps: int) -> ResistanceFit:
        return fit_of(p, self._of(float(p.x[1])))

    def _of(self, centre_degC: float) -> float:
        return -DEEP * round(abs(centre_degC - BEST_DEGC) / EVERY_K)


@dataclass
class _Point:
    evidence: float


def fit_of(p: FilmParameters, score: float) -> ResistanceFit:
    none = np.empty(0)
    return ResistanceFit(p, none, none, score, none, np.empty((0, 0)), 0.0, 0.0)


def begun(channel: Bumpy, relay_dec: float = 0.1, most_dec: float = 3.0) -> tuple[ResistanceSearch, ResistanceFit]:
    p = FilmParameters((), FILM.copy(), FilmStart("heated"), PriorWidths(relay_dec=relay_dec, most_weight_dec=most_dec))
    search = ResistanceSearch(cast(Any, channel), {}, p, budget=Budget())
    return search, search.keep(channel.descend(p, 0))


def test_the_best_minimum_nearby_is_found_and_kept() -> None:
    channel = Bumpy()
    search, fit = begun(channel)
    found = restarted(search, fit)
    assert found.score > fit.score + 2.0 * DEEP
    assert abs(float(found.parameters.x[1]) - BEST_DEGC) < EVERY_K
    assert np.array_equal(found.parameters.x[ENVELOPES:], FILM[ENVELOPES:])
    assert search.fits[frozenset()] is found


def test_each_set_of_effects_is_begun_again_once() -> None:
    channel = Bumpy()
    search, fit = begun(channel)
    found, looked_at = restarted(search, fit), len(channel.points)
    assert restarted(search, found) is found
    assert len(channel.points) == looked_at


def test_nothing_that_is_worse_is_taken() -> None:
    channel = Bumpy()
    search, _ = begun(channel)
    p = replace(search.base, x=np.concatenate((FILM[:1], [BEST_DEGC], FILM[2:])))
    best = search.keep(channel.descend(p, 0))
    assert restarted(search, best) is best
    assert GAINS < DEEP


@pytest.mark.parametrize(("square", "relay_dec", "most_dec"), [(1.0, 0.0, 3.0), (9.0, 0.1, 3.0), (1.0, 0.1, 0.01)])
def test_a_film_of_the_class_one_of_relays_alone_and_what_is_not_understood_stay(
    square: float, relay_dec: float, most_dec: float
) -> None:
    """Nothing of another film, much left, no envelopes to speak of."""
    channel = Bumpy(square)
    search, fit = begun(channel, relay_dec, most_dec)
    assert restarted(search, fit) is fit
    assert not channel.points
