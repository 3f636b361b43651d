"""A thermometer that lags behind the simulated plate, beside the solution in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from sim.inference.record.record import read_columns
from sim.model.links import links_of
from sim.model.plate_path import plate_nodes, simulate_plate

S, R, G, AMBIENT_DEGC, START_DEGC, CURRENT_A = 0.005, 0.3, 0.07, 25.0, 25.0, 1.5


@pytest.mark.parametrize("interval_s", [0.2, 0.5, 2.0])
def test_a_lag_behind_a_plate_that_bends_between_the_rows(interval_s: float) -> None:
    """Two rates: the plate's g - s I and the thermometer's 1 / tau. Straight between rows would be 0.02 K off."""
    time, tau = np.arange(0.0, 200.0, interval_s), 3.0
    rate = G - S * CURRENT_A
    end = (S * 273.15 * CURRENT_A + 0.5 * R * CURRENT_A**2 + G * AMBIENT_DEGC) / rate
    plate = end + (START_DEGC - end) * np.exp(-rate * time)
    shown = end + (START_DEGC - end) / (1.0 - rate * tau) * (np.exp(-rate * time) - rate * tau * np.exp(-time / tau))
    record = read_columns(
        {"time_s": time, "temperature_degC": plate, "current_A": np.full(time.size, CURRENT_A)}, held_out=False
    )
    links = links_of([switched(catalogue()["sensor_lag"], [tau])])
    run = simulate_plate(
        record,
        plate_nodes(record, links),
        np.array([S, R, G, 0.0, AMBIENT_DEGC, 0.0, 0.0]),
        links,
        np.array([START_DEGC]),
        record.first_rows,
        np.empty((1, 0)),
        np.zeros((1, 1)),
    )
    np.testing.assert_allclose(run.path.at(time), plate, atol=1e-7)
    np.testing.assert_allclose(run.shown_degC, shown, atol=2e-4)
