"""Where much is left beside an effect, its size is looked for in envelopes that were not bent to do without it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.learned import with_film
from sim.diagnosis.search.stepwise import FAR_FROM_NOISE, _at_another_size
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from tests.diagnosis.truth.draw import draw_film

DRIFT_K_PER_H = 1.5


@pytest.mark.long
def test_from_a_size_that_no_descent_leaves() -> None:
    """A film of another kind; the fit in which the search stands still has a tenth of its drift."""
    film = draw_film(np.random.default_rng(9), "preisach", form=0)
    table = film.table.copy()
    table[2] += 60.0 - np.mean(table[2])
    rng = np.random.default_rng(5)
    turns = np.concatenate(([25.0], np.tile([85.0, 35.0], 6), rng.uniform(45.0, 75.0, 10)))
    legs = [np.linspace(a, b, max(int(abs(b - a) / 0.4), 2), endpoint=False) for a, b in pairwise(turns)]
    temperature = np.concatenate(legs)
    time = 4.0 * np.arange(temperature.size)
    log_ohm = replace(film, table=table).log_ohm(temperature + DRIFT_K_PER_H * time / 3600.0)
    log_ohm += 1e-3 * rng.standard_normal(time.size)
    columns = {"time_s": time, "temperature_degC": temperature, "resistance_ohm": 10.0**log_ohm}
    chain = with_film(Chain(read_columns(columns, held_out=True), dict(catalogue())), frozenset())
    search = chain.last(frozenset())
    drift = switched(catalogue()["film_drift"], [0.1 * DRIFT_K_PER_H])
    stuck = search.channel.descend(search.channel.extended(search.base, [drift]), 0)
    assert search.channel.mean_square(stuck) > FAR_FROM_NOISE
    found = _at_another_size(search, stuck, frozenset())
    assert float(found.effects[0].par[0]) == pytest.approx(DRIFT_K_PER_H, rel=0.02)
    assert search.channel.mean_square(found) < 1.5
