"""A dead band: its cost has a valley between any two currents of the record, and one alone leaves nothing."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.chain import temperature_search
from sim.diagnosis.record import read_columns
from sim.effects.catalogue import catalogue
from tests.diagnosis.cases import case

COLUMNS = ("time_s", "temperature_degC", "current_A")


@pytest.mark.parametrize(
    ("manner", "seed"),
    [
        ("waves", 2),  # far from the start, where the Joule heat had gone to nothing
        ("little_noise", 4),  # one row more or less is 140,000 of log-likelihood
        ("rows_of_0.2_s", 6),  # currents nearer to each other than a thousandth
    ],
)
def test_the_search_ends_in_the_valley_that_leaves_nothing(manner: str, seed: int) -> None:
    made = case("unlike", seed, manner=manner, effect="actuator_deadband")
    record = read_columns({name: made.columns[name] for name in COLUMNS}, held_out=False)
    every = np.ones(record.rows, dtype=np.bool_)
    fit = temperature_search(record, every, catalogue()).fit(frozenset({"actuator_deadband"}))
    noise = 2.0 * fit.minus_log / record.rows * fit.sigma_K**2 / made.noise["temperature_K"] ** 2
    assert noise < 1.1
