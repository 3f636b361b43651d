"""The plate's numbers in a diagnosis: the true ones inside their intervals, impossible ones told."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.diagnosis.diagnose import diagnose

Columns = dict[str, NDArray[np.float64]]
SEEBECK, JOULE, LOSS = 2e-3, 0.07, 0.02
STEPS = 200  # of the balance in a row


def record(room_degC: float, levels: NDArray[np.float64], seed: int, noise_K: float = 0.01) -> Columns:
    """A plate driven by currents that are held for 20 s each; one row a second."""
    rng = np.random.default_rng(seed)
    current = np.repeat(levels, 20)
    degC, plate = np.empty(current.size), 25.0
    for k, amperes in enumerate(current):
        degC[k] = plate
        for _ in range(STEPS):
            heat = SEEBECK * amperes * (plate + 273.15) + 0.5 * JOULE * amperes**2 - LOSS * (plate - room_degC)
            plate += heat / STEPS
    time = np.arange(float(current.size))
    return {"time_s": time, "temperature_degC": degC + noise_K * rng.standard_normal(degC.size), "current_A": current}


@pytest.mark.parametrize("seed", [1, 2])
def test_the_true_numbers_are_inside(seed: int) -> None:
    levels = np.random.default_rng(seed).uniform(-1.0, 1.5, 40) * (np.arange(40) % 4 > 0)
    plate = diagnose(record(24.0, levels, seed)).plate
    assert plate is not None
    assert plate.kind == "peltier"
    assert plate.doubts == []
    true = {
        "seebeck_over_capacity_per_A_s": SEEBECK,
        "resistance_over_capacity_K_per_A2_s": JOULE,
        "conductance_over_capacity_per_s": LOSS,
        "ambient_degC": 24.0,
    }
    assert set(plate.parameters) == set(true)
    for name, (value, ci) in plate.parameters.items():
        assert ci is not None
        low, high = ci
        assert low < value < high
        assert abs(value - true[name]) < high - low, name  # four standard deviations
        assert high - low < 0.1 * value  # and no interval that holds anything


def test_a_room_that_is_none_is_told() -> None:
    levels = np.random.default_rng(3).uniform(-1.0, 1.5, 40) * (np.arange(40) % 4 > 0)
    document = diagnose(record(-12.0, levels, 3)).document()
    assert any("a room at -12 degC is none" in doubt for doubt in document["plate"]["doubts"])


def test_what_the_record_does_not_fix_is_told() -> None:
    """Small currents, and a noisy thermometer: heat that goes with the square of the current is not seen."""
    levels = 0.1 * np.random.default_rng(4).uniform(-1.0, 1.0, 30)
    document = diagnose(record(24.0, levels, 4, noise_K=0.05)).document()
    doubts = [doubt for doubt in document["plate"]["doubts"] if doubt.startswith("resistance_over_capacity")]
    assert len(doubts) == 1
    assert "large currents in both directions fix it" in doubts[0]


def test_no_current_no_plate() -> None:
    time = np.arange(400.0)
    degC = 60.0 + 20.0 * np.sin(time / 60.0)
    ohm = 10.0 ** (4.0 - 1.5 / (1.0 + np.exp(-(degC - 60.0) / 2.0)))
    assert diagnose({"time_s": time, "temperature_degC": degC, "resistance_ohm": ohm}).document()["plate"] is None
