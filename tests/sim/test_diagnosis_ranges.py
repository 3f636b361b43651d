"""An ohmmeter's ranges: readings at a threshold, which noise carries over it and back, are no error of a range."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.search.learned import with_film
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from tests.diagnosis.cases import case

THRESHOLD_OHM = 1e5


@pytest.mark.parametrize(
    ("seed", "share_below"),
    [(1, 0.99), pytest.param(5, 0.99, marks=pytest.mark.long), pytest.param(7, 0.97, marks=pytest.mark.long)],
)
def test_the_noise_at_a_threshold_is_no_error_of_a_range(seed: int, share_below: float) -> None:
    """Ranges told by the readings call what noise lifts over the threshold an error of the size of the noise: 10 to 20
    of log-likelihood from nothing."""
    columns = dict(case("clean", seed).columns)
    ohm = columns["resistance_ohm"]
    columns["resistance_ohm"] = ohm * (THRESHOLD_OHM / np.quantile(ohm, share_below))
    del columns["current_A"]
    record = read_columns(columns, held_out=False)
    search = with_film(Chain(record, catalogue()), frozenset()).last(frozenset())
    channel, clean = search.channel, search.ended(search.fit(frozenset()))
    for size in (-1.0, 2.0):  # times the noise
        error = 10.0 ** (size * channel.noise.level) - 1.0
        begin = channel.extended(clean.parameters, [switched(catalogue()["meter_range_error"], [THRESHOLD_OHM, error])])
        found = channel.descend(begin, 15)
        assert found.score - clean.score < 5.0
