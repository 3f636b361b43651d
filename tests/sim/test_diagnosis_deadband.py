"""A dead band: its cost has a valley between any two currents of the record, and one alone leaves nothing."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.search.chain import temperature_search
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import case

OFF = 8  # currents of the record that a dead band found without other effects may be off
COLUMNS = ("time_s", "temperature_degC", "current_A")


@pytest.mark.parametrize(
    ("manner", "seed"),
    [
        # far from the start, where the Joule heat had gone to nothing
        pytest.param("waves", 2, marks=pytest.mark.long),
        ("little_noise", 4),  # one row more or less is 140,000 of log-likelihood
        pytest.param("rows_of_0.2_s", 6, marks=pytest.mark.long),  # currents nearer to each other than a thousandth
    ],
)
def test_the_search_ends_in_the_valley_that_leaves_nothing(manner: str, seed: int) -> None:
    made = case("unlike", seed, manner=manner, effect="actuator_deadband")
    record = read_columns({name: made.columns[name] for name in COLUMNS}, held_out=False)
    name, effects = "actuator_deadband", catalogue()
    search = temperature_search(record, effects)
    fit = search.fit(frozenset({name}))
    noise = 2.0 * fit.minus_log / record.rows * search.channel.sigma_K**2 / made.noise["temperature_K"] ** 2
    assert noise < 1.1
    cells = np.sort(np.abs(made.columns["current_A"]))
    beside = float(cells[np.searchsorted(cells, fit.effects[0].par[0]) + OFF])
    search.fits[frozenset({name})] = off = search.held(fit, effects[name], beside, 10)
    assert 2.0 * off.minus_log > 1.1 * record.rows
    search.walked(frozenset({name}))
    assert search.fit(frozenset({name})).minus_log < fit.minus_log + 1.0
