"""A film's memory before the first row and in gaps, found by the turning points that it had."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sim.inference.film.result import memory_at_start
from sim.inference.memory import begun
from sim.model.record_own import FilmStart
from tests.sim.inference.identification_films import is_prandtl_ishlinskii, through

NOISE = 0.002


def cost_of(true: FilmStart, degC: np.ndarray) -> Callable[[FilmStart], float]:
    """Minus the log-likelihood of a memory, of readings that a film with the true one gives."""
    film, first = is_prandtl_ishlinskii(2), float(degC[0])

    def shown(start: FilmStart) -> np.ndarray:
        return np.asarray(film.simulate(degC, memory_at_start(film, start, first))[0])

    readings = shown(true) + NOISE * np.random.default_rng(4).standard_normal(degC.size)
    return lambda start: 0.5 * float(np.sum(((readings - shown(start)) / NOISE) ** 2))


@pytest.mark.parametrize(
    ("true", "inner"),
    [
        (FilmStart("heated", (66.0, 57.0)), (66.0, 57.0)),
        (FilmStart("cooled", (55.0, 63.0)), (55.0, 63.0)),
        (FilmStart("heated", (66.0,)), (66.0,)),
        (FilmStart("cooled"), ()),
    ],
)
def test_a_film_that_begins_inside_its_loop_is_recognized(true: FilmStart, inner: tuple[float, ...]) -> None:
    """Else a clean record that begins where the last run ended is reported as unexplained."""
    degC = through([60.0, 62.0, 58.0, 90.0, 30.0, 90.0], 150)
    cost = cost_of(true, degC)
    for known in (FilmStart("heated"), FilmStart("cooled")):
        found = begun(known, float(degC[0]), degC, cost, 8.0)
        assert cost(found) < cost(true) + 8.0
        assert found.turned_degC == pytest.approx(inner, abs=1.0) or cost(found) < cost(true)


def test_what_brings_too_little_is_not_taken_for_a_turning_point() -> None:
    """Else every record gets a history that nobody measured."""
    degC = through([30.0, 90.0, 30.0], 300)
    true = FilmStart("heated")
    assert begun(true, 30.0, degC, cost_of(true, degC), 8.0) == true
