"""A Peltier plate that is only ever heated, on a sink that warms up, is no heater."""

from __future__ import annotations

import numpy as np
import pytest

from sim.diagnosis.diagnose import diagnose

CAPACITY_J_PER_K, SEEBECK_V_PER_K, CONDUCTANCE_W_PER_K, OHM, ROOM_DEGC = 250.0, 0.2, 1.5, 1.8, 24.0
SINK_RATIO, SINK_PER_S = 15.0, 0.03
ROW_S, INNER = 5.0, 50


@pytest.mark.long
def test_a_plate_that_only_heats_and_has_a_sink_is_a_peltier_plate() -> None:
    """Its own balance, by Euler steps of 0.1 s, which are 1e-3 of its shortest time: taken alone, a heater is nearer to
    the bent course than a Peltier plate."""
    chance = np.random.default_rng(18)
    current = np.interp(np.arange(1000.0), 25.0 * np.arange(41), chance.uniform(0.3, 1.5, 41))
    plate = sink = ROOM_DEGC
    temperature = np.empty(current.size)
    for k, amps in enumerate(current):
        temperature[k] = plate
        for _ in range(INNER):
            joule = 0.5 * OHM * amps * amps
            through = CONDUCTANCE_W_PER_K * (plate - sink)
            heat = SEEBECK_V_PER_K * amps * (plate + 273.15) + joule - through
            other = -SEEBECK_V_PER_K * amps * (sink + 273.15) + joule + through
            lost = SINK_PER_S * CAPACITY_J_PER_K * (sink - ROOM_DEGC)
            plate += heat / CAPACITY_J_PER_K * ROW_S / INNER
            sink += (other - lost) / (SINK_RATIO * CAPACITY_J_PER_K) * ROW_S / INNER
    columns = {
        "time_s": ROW_S * np.arange(current.size),
        "temperature_degC": temperature + chance.normal(0.0, 0.02, current.size),
        "current_A": current,
    }
    found = diagnose(columns, kinds=("peltier", "heater"))
    assert found.plate is not None
    assert found.plate.kind == "peltier"
    assert [finding.name for finding in found.findings] == ["heat_sink_warmup"]
    ratio, _ = found.findings[0].parameters["sink_capacity_ratio"]
    assert abs(ratio / SINK_RATIO - 1.0) < 0.05
