"""The plate's physics: its balance of heat, with and without slopes, and a step that is exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from compensator.thermal.plate import FARTHEST_DEGC, PlateModel

C, S, R, G, AMBIENT = 20.0, 0.05, 2.0, 0.5, 25.0  # J/K, V/K, ohm, W/K, degC
PLATE = PlateModel(S / C, R / C, G / C, AMBIENT)
OF_S, OF_R = 0.002, 0.004  # 1/K: what modules of bismuth telluride have
SLOPED = replace(PLATE, seebeck_slope_per_K=OF_S, resistance_slope_per_K=OF_R)
TEMPERATURES, CURRENTS = st.floats(-20.0, 120.0), st.floats(-6.0, 6.0)
PLATES = st.sampled_from([PLATE, SLOPED])


def test_a_heater_only_heats() -> None:
    heater = PlateModel(0.0, 0.0, 0.02, 25.0, 0.8, "heater")
    assert heater.current_range_A(60.0, 1.0) == (0.0, 1.0)
    assert heater.current_for_rate_A(60.0, -5.0, 1.0) == 0.0
    assert heater.rate_K_per_s(60.0, heater.current_for_rate_A(60.0, 0.05, 1.0)) == pytest.approx(0.05)


def balance(plate: PlateModel, t: float, i: float) -> float:
    """The plate's balance of heat, K/s, written once more."""
    seebeck = S * (1.0 + plate.seebeck_slope_per_K * (t - 25.0))
    resistance = R * (1.0 + plate.resistance_slope_per_K * (t - 25.0))
    return (seebeck * i * (t + 273.15) + 0.5 * resistance * i * i - G * (t - AMBIENT)) / C


@settings(deadline=None, max_examples=60)
@given(PLATES, TEMPERATURES, CURRENTS, st.floats(1e-3, 30.0))
def test_a_step_is_exact(plate: PlateModel, t: float, i: float, dt: float) -> None:
    """Simulator and law take periods of any length in one step: an error of it would look like a lag of the plate."""
    solved = solve_ivp(lambda _, x: balance(plate, x, i), (0.0, dt), [t], method="DOP853", rtol=1e-12, atol=1e-12)
    assert plate.step(t, i, dt) == pytest.approx(solved.y[0, -1], rel=1e-10, abs=1e-10)
    half = plate.step(plate.step(t, i, 0.5 * dt), i, 0.5 * dt)
    assert half == pytest.approx(plate.step(t, i, dt), rel=1e-11, abs=1e-10)


@settings(deadline=None)
@given(PLATES, TEMPERATURES, CURRENTS, st.floats(-2.0, 2.0))
def test_rates_and_currents_are_those_of_the_balance(plate: PlateModel, t: float, i: float, wanted: float) -> None:
    """Feedforward, largest cooling, and the operating point that gains and margins are designed at."""
    assert plate.rate_K_per_s(t, i) == pytest.approx(balance(plate, t, i), abs=1e-12)
    low, high = plate.current_range_A(t, 1e6)
    assert balance(plate, t, low) <= min(balance(plate, t, 1.001 * low), balance(plate, t, 0.999 * low))
    low, high = plate.rate_range_K_per_s(t, 5.0)
    current = plate.current_for_rate_A(t, wanted, 5.0)
    assert balance(plate, t, current) == pytest.approx(min(max(wanted, low), high), abs=1e-10)
    gain, pole = plate.linearized(t, i)
    assert gain == pytest.approx((balance(plate, t, i + 1e-4) - balance(plate, t, i - 1e-4)) / 2e-4, abs=1e-8)
    assert pole == pytest.approx(-(balance(plate, t + 1e-3, i) - balance(plate, t - 1e-3, i)) / 2e-3, abs=1e-8)


@pytest.mark.parametrize("slope", [1e-7, 1e-10, 1e-14])
def test_slopes_that_are_next_to_nothing_are_nothing(slope: float) -> None:
    """A fit goes through 0: the exact solution of a plate without slopes must join the one with them."""
    tiny = replace(PLATE, seebeck_slope_per_K=slope, resistance_slope_per_K=-slope)
    for dt in (1e-6, 0.1, 30.0):
        assert tiny.step(60.0, 3.0, dt) == pytest.approx(PLATE.step(60.0, 3.0, dt), abs=1e4 * slope + 1e-12)


def test_a_plate_that_runs_away_stays_a_number() -> None:
    """S that grows with T has no bound in finite time; a fit's trial that gets there must be comparable still."""
    times = np.linspace(0.0, 4000.0, 5)
    hot = SLOPED.simulate(60.0, times, np.array([6.0, 6.0, 6.0, -1.0, 0.0]))
    assert np.all(np.isfinite(hot))
    assert hot[3] == FARTHEST_DEGC
    assert hot[4] < 100.0


def test_parameters_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="conductance"):
        PlateModel(1e-3, 0.06, -0.1, 25.0)
    with pytest.raises(ValueError, match="Seebeck"):
        PlateModel(0.0, 0.06, 0.1, 25.0)
    with pytest.raises(ValueError, match="heating rate"):
        PlateModel(0.0, 0.0, 0.1, 25.0, kind="heater")
    for slope in (0.2, float("nan")):
        with pytest.raises(ValueError, match="resistance_slope_per_K"):
            replace(PLATE, resistance_slope_per_K=slope)
    with pytest.raises(ValueError, match="heater"):
        PlateModel(0.0, 0.0, 0.1, 25.0, 0.8, "heater", seebeck_slope_per_K=0.002)


@pytest.mark.parametrize("rate", [-3e15, 0.0, 3e15])
def test_a_plate_that_a_model_puts_below_absolute_zero_asks_for_a_current_within_the_limit(rate: float) -> None:
    """A mutated model did so, and a division by zero ended the replay."""
    assert abs(PlateModel(1.5, 0.06, 0.018, 25.0).current_for_rate_A(-1.4e15, rate, 4.0)) <= 4.0
