"""The plate with a heat sink of its own, against an independent integrator; a measured sink that saturates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from compensator.thermal.plate import PlateModel
from rig.records.record_file import ColumnMapping, read_record
from sim.diagnosis.row_warnings import row_warnings
from sim.effects.effect import switched
from sim.effects.heat_sink_warmup import EFFECT
from sim.inference.record.record import read_columns
from sim.inference.record.stretches import first_rows, gaps
from sim.model.plate_balance import heat_flows, run
from sim.world.films import PreisachFilm
from sim.world.plant import SimulatedPlant, World

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)


def step(par: np.ndarray, ratio: float, loss: float, plate: float, sink: float, current: float, dt: float):
    heat, own = heat_flows([switched(EFFECT, [ratio, loss])]), np.array([sink])
    out, slopes = np.empty(2), np.empty((2, 2))
    reset = np.array([plate, np.nan])
    run(par, heat.terms, heat.values, np.array([0.0, dt]), np.full(2, current), np.zeros(2), reset, own, out, slopes)
    return out[1], own[0]


def rates(_: float, x: np.ndarray, current: float, ratio: float, loss: float, slopes: float) -> list[float]:
    """S and R_e at both faces are those at the plate's temperature."""
    plate, sink = x
    joule, through = 0.03 * (1.0 + slopes * 0.004 * (plate - 25.0)) * current**2, 0.018 * (plate - sink)
    seebeck = 1.6e-3 * (1.0 + slopes * 0.002 * (plate - 25.0))
    pumped = [seebeck * current * (t + 273.15) for t in (plate, sink)]
    return [pumped[0] + joule - through, (-pumped[1] + joule + through - loss * (sink - 25.0)) / ratio]


@pytest.mark.parametrize("current", [-3.0, 0.0, 2.5])
@pytest.mark.parametrize("dt", [0.01, 0.1, 3.0, 30.0])
@pytest.mark.parametrize("slopes", [0.0, 1.0])
def test_against_a_library_integrator(current: float, dt: float, slopes: float) -> None:
    """A module that changes with temperature, behind a sink that warms up: what a rig without water cooling is."""
    plate = replace(PLATE, seebeck_slope_per_K=slopes * 0.002, resistance_slope_per_K=slopes * 0.004)
    args = current, 10.0, 0.4, slopes
    expected = solve_ivp(rates, (0.0, dt), [60.0, 31.0], args=args, rtol=1e-12, atol=1e-12).y[:, -1]
    found = step(plate.numbers, 10.0, 0.4, 60.0, 31.0, current, dt)
    np.testing.assert_allclose(found, expected, atol=1e-7 if slopes else 1e-8)


def test_a_huge_sink_is_the_base_model() -> None:
    film = PreisachFilm.bell_shaped(0, relays=10)
    worlds = [World(PLATE, film), World(PLATE, film, effects=(switched(EFFECT, [1e9, 0.5]),))]
    plants = [SimulatedPlant(world) for world in worlds]
    for plant in plants:
        for k in range(50):
            plant.set_current_A(3.0 if k % 2 else -1.0)
            plant.advance_to(0.5 * (k + 1))
    assert plants[0].temperature_degC == pytest.approx(plants[1].temperature_degC, abs=1e-5)


COLUMNS = ("time_s=t_s|time@s", "temperature_degC=T_C|temp@degC", "current_A=duty|output@duty")


@pytest.mark.parametrize(("after_A", "begins"), [(1.0, [0]), (0.4, [0, 1])])
def test_a_held_command_goes_on_through_a_gap(after_A: float, begins: list[int]) -> None:
    """A first step of eight others, as of a log that starts while a controller has begun to heat."""
    time = np.concatenate(([0.0], 5.0 + 0.62 * np.arange(200.0)))
    current = np.where(time < 1.0, 1.0, after_A)
    told = np.ones(time.size, dtype=np.bool_)
    degC = 30.0 + 0.1 * time + 0.05 * np.random.default_rng(3).standard_normal(time.size)
    assert first_rows(time, degC, current, told, gaps(time, told)).tolist() == begins


def test_a_measured_sink_saturates(measured: Path) -> None:
    mapping = [ColumnMapping.parse(text) for text in COLUMNS]
    record = read_columns(read_record(measured / "peltier_runaway.csv", mapping).columns)
    (warning,) = (found for found in row_warnings(record) if found.code == "heat_sink_saturated")
    assert warning.from_s is not None
    assert warning.to_s is not None
    assert 340.0 < warning.from_s < warning.to_s < 520.0
