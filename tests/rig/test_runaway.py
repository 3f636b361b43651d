"""Runaway in both directions: it trips on what a plate with this model cannot do, never on what real plates did."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from compensator.identify_plate import identify_plate
from compensator.plate import PlateModel
from rig.outcome import Tripped
from rig.safety.runaway import RunawayWatch

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
CLEAN = ("peltier_8010.csv", "peltier_8020.csv", "peltier_8055.csv", "peltier_500.csv")


def replayed(path: Path, plate: PlateModel | None) -> Tripped | None:
    """What a measured record (time, temperature, duty) trips on."""
    watch, sent = RunawayWatch(1.0, 20.0, plate), 0.0
    for time_s, temperature_degC, duty in np.genfromtxt(path, delimiter=",", skip_header=1):
        try:
            watch.look(time_s, temperature_degC, sent, math.nan)
        except Tripped as trip:
            return trip
        sent = duty
    return None


def plate_of(path: Path) -> PlateModel:
    return identify_plate(*np.genfromtxt(path, delimiter=",", skip_header=1).T).model


@pytest.mark.parametrize("model", ["peltier_8010.csv", "peltier_8020.csv", None])
def test_measured_records(measured: Path, model: str | None) -> None:
    """Clean runs pass; a saturated heat sink is seen, with another run's model and without any."""
    plate = plate_of(measured / model) if model is not None else None
    for name in CLEAN:
        assert replayed(measured / name, plate) is None, name
    trip = replayed(measured / "peltier_runaway.csv", plate)
    assert trip is not None
    assert trip.time_s < 400.0
    assert trip.cause in ("runaway", "no_response")
    assert "saturated heat sink" in str(trip)


def simulated(
    current_A: Callable[[float], float],
    true: Callable[[float], PlateModel] | None,
    plate: PlateModel | None = PLATE,
    first_degC: float = 40.0,
    length_s: float = 120.0,
    step_K: float = 0.0,
    read: Callable[[float, float], float] = lambda time_s, degC: degC,
    wired: float = 1.0,
) -> Tripped | None:
    """What a run trips on: its current, and the plate as it truly is (None: heated or cooled by nothing)."""
    watch, chance = RunawayWatch(4.0, 20.0, plate), np.random.default_rng(1)
    temperature, sent = first_degC, 0.0
    dead = PlateModel(1e-9, 0.0, 0.018, 25.0)
    for k in range(int(length_s * 5)):
        time_s = 0.2 * k
        reading = read(time_s, temperature) + 0.005 * float(chance.standard_normal())
        reading = round(reading / step_K) * step_K if step_K else reading
        try:
            watch.look(time_s, reading, sent, math.nan)
        except Tripped as trip:
            return trip
        sent = current_A(time_s)
        temperature = (true(time_s) if true is not None else dead).step(temperature, wired * sent, 0.2)
    return None


WAVE = {"heats": lambda t: 2.0, "cools": lambda t: -2.0, "both": lambda t: 3.0 * math.sin(t / 8.0)}


@pytest.mark.parametrize("step_K", [0.0, 0.25])
@pytest.mark.parametrize("wave", sorted(WAVE))
def test_a_plate_that_its_model_is_wrong_about_passes(wave: str, step_K: float) -> None:
    """30 % off in every parameter, and an ambient 15 K off."""
    true = PlateModel(1.1e-3, 0.08, 0.013, 10.0)
    assert simulated(WAVE[wave], lambda t: true, step_K=step_K) is None
    assert simulated(WAVE[wave], lambda t: true, plate=None, step_K=step_K) is None


@pytest.mark.parametrize("current_A", [3.0, -3.0])
def test_swapped_polarity(current_A: float) -> None:
    trip = simulated(lambda t: current_A, lambda t: PLATE, wired=-1.0)
    assert trip is not None
    assert trip.cause == "runaway"
    assert "plate model gives" in str(trip)
    assert trip.time_s < 12.0


@pytest.mark.parametrize(("plate", "latest_s"), [(PLATE, 25.0), (None, 30.0)])
def test_a_heater_that_is_open(plate: PlateModel | None, latest_s: float) -> None:
    trip = simulated(lambda t: 3.0, None, plate, first_degC=25.0)
    assert trip is not None
    assert trip.time_s < latest_s


def test_a_thermometer_that_falls_off_in_mid_run() -> None:
    trip = simulated(
        lambda t: 0.9 if t < 60.0 else 4.0,
        lambda t: PLATE,
        read=lambda t, degC: degC if t < 60.0 else 25.0,
    )
    assert trip is not None
    assert 60.0 <= trip.time_s < 85.0


def test_a_heat_sink_that_saturates() -> None:
    """Cooling at full current, and it gets warmer: the sink warms up without end."""
    warm = [PlateModel(1.6e-3, 0.06, 0.1, 25.0 + 1.5 * k) for k in range(200)]
    trip = simulated(lambda t: -4.0, lambda t: warm[int(t)], first_degC=20.0, length_s=190.0)
    assert trip is not None


def test_an_instruments_own_regulation_that_runs_the_wrong_way() -> None:
    watch = RunawayWatch(4.0, 20.0, None)
    for k in range(100):
        watch.look(0.2 * k, 40.0 - 0.01 * k, math.nan, 60.0)
    with pytest.raises(Tripped, match=r"no nearer to the setpoint of 60\.00 degC"):
        watch.look(20.5, 39.0, math.nan, 60.0)
    watch = RunawayWatch(4.0, 20.0, None)
    for k in range(500):  # a slow one, and one that has arrived
        watch.look(0.2 * k, min(40.0 + 0.02 * k, 59.9), math.nan, 60.0)


def test_more_cooling_current_than_cools() -> None:
    watch = RunawayWatch(16.0, 20.0, PLATE)
    watch.check_cooling(0.0, 20.0, -7.5)
    with pytest.raises(Tripped, match="more current cools less") as trip:
        watch.check_cooling(0.0, 20.0, -9.0)
    assert trip.value.cause == "cooling_limit"
