"""A law that knows its chain's effects, on a plant that was written apart from `sim`: as good as without them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import design_temperature
from compensator.control.reference_shaping import preview
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from rig.control.law_units import chain_observer
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from tests.compensator.film_models import TEN_OPERATORS as FILM
from tests.truth import NOISE_DEC, Effects, Plant, Plate, film_of_the_class

PLATE = PlateModel(0.05 / 30.0, 2.0 / 30.0, 0.5 / 30.0, 25.0)
SLOPED = replace(PLATE, seebeck_slope_per_K=0.002, resistance_slope_per_K=0.004)
TRULY = {PLATE: Plate(), SLOPED: Plate(seebeck_slope=0.002, resistance_slope=0.004)}
PERIOD_S, OHMMETER_S, THERMOMETER_S, COMMAND_S = 0.1, 0.027, 0.063, 0.080
TEST_A = 1e-4
TIMES, WANTED = [0.0, 20.0, 60.0, 75.0, 110.0, 120.0], [-4.2, -4.2, -3.8, -3.8, -4.1, -4.1]
SECONDS, SETTLED_S, HORIZON_S = 115, 15.0, 2.4
EFFECTS: Effects = {
    "film_lag": {"tau_s": 2.0},
    "sensor_lag": {"tau_s": 2.0},
    "self_heating": {"theta_K_per_W": 3000.0},
    "actuator_delay": {"delay_s": 1.0},
    "film_drift": {"drift_K_per_h": 20.0},
    "heat_sink_warmup": {"sink_capacity_ratio": 10.0, "sink_conductance_ratio_per_s": 0.167},
}


class TrueFilm:
    """The model's film as the plant asks for one."""

    def __init__(self) -> None:
        self._memory = FILM.initial_memory(85.0, "heated")

    def log_ohm(self, degC: float) -> float:
        output, self._memory = FILM.step(degC, self._memory)
        return -output


def law_for(name: str, known: bool, plate: PlateModel = PLATE) -> Law:
    effects = [switched(catalogue()[name], EFFECTS[name])] if known and name in EFFECTS else []
    observer = chain_observer(effects, plate, FILM, PERIOD_S)
    gains = design_temperature(PERIOD_S, PERIOD_S + (observer.delay_s if observer else 0.0), 1.4).gains
    coming = preview(HORIZON_S, PERIOD_S, observer.film_lag_s if observer else 0.0)
    return Law(LawSettings("full", PERIOD_S, 4.0, 10.0, 95.0, gains, *coming), plate, FILM, observer)


def error_dec(name: str, known: bool, true: PlateModel = PLATE) -> float:
    """RMS of the film's own error over the course, after it has settled, by a law that knows the plate."""
    law, hot = law_for(name, known, true), FILM.initial_memory(85.0, "heated")
    first = Inverse(FILM, 10.0, 95.0).solve(WANTED[0], hot)
    hidden = {name: EFFECTS[name]} if name in EFFECTS else {}
    plant = Plant(TRULY[true], film_of_the_class(1), 1, 0.0, hidden)
    plant.film = TrueFilm()  # type: ignore[assignment]
    plant.test_current_A, plant.log_ohm = TEST_A, plant.film.log_ohm(first.temperature_degC)
    plate_degC = first.temperature_degC - plant.theta_K_per_W * TEST_A**2 * 10.0**plant.log_ohm
    plant.degC = plant.shown_degC = plant.lagged_degC = plate_degC
    memory = FILM.step(first.temperature_degC, hot)[1]
    state, ahead = law.start(plate_degC, memory, test_current_A=TEST_A), law.preview_times_s()
    for k in range(round(SECONDS / PERIOD_S)):
        tick_s = k * PERIOD_S
        plant.advance_to(tick_s + OHMMETER_S)
        output = -math.log10(plant.read_resistance_ohm(TEST_A))
        plant.advance_to(tick_s + THERMOMETER_S)
        reading = plant.read_temperature_degC()
        now, coming = (np.interp(tick_s + t, TIMES, WANTED) for t in (THERMOMETER_S, COMMAND_S + ahead))
        ages = THERMOMETER_S - OHMMETER_S, COMMAND_S - THERMOMETER_S
        command, state = law.step(state, Inputs(reading, output, float(now), coming, *ages, TEST_A))
        plant.advance_to(tick_s + COMMAND_S)
        plant.set_current_A(command.current_A)
    time, _, log_ohm = np.array(plant.course).T
    settled = time > SETTLED_S
    return float(np.sqrt(np.mean((log_ohm + np.interp(time, TIMES, WANTED))[settled] ** 2)))


@pytest.fixture(scope="module")
def without() -> float:
    return error_dec("none", known=True)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_known_effect_costs_next_to_nothing(name: str, without: float) -> None:
    """Behind a delay, what the plate is off its reference is mended slowly: that costs a third of the ohmmeter's noise,
    three quarters of it without any noise as well."""
    late = 0.38 * NOISE_DEC if name == "actuator_delay" else 0.0
    assert error_dec(name, known=True) < max(1.3 * without, late)


@pytest.mark.parametrize("name", ["none", "film_lag", "heat_sink_warmup"])
def test_a_plate_whose_module_changes_with_temperature_costs_nothing(name: str, without: float) -> None:
    """A rig's module gains 7 % of S and 14 % of R_e by the film's transition: who tracks on it with the slopes in the
    model file gets what a plate without slopes gives, behind a heat sink too, whose face has an S of its own. A law
    that does not know them is off by 1.2 to 1.5 times as much."""
    assert error_dec(name, known=True, true=SLOPED) < 1.1 * without


def test_a_lag_of_the_thermometer_that_nobody_knows_is_found_on_the_way(without: float) -> None:
    assert error_dec("sensor_lag", known=False) < 1.3 * without


@pytest.mark.parametrize("name", ["film_lag", "actuator_delay"])
def test_an_unknown_one_costs_much(name: str, without: float) -> None:
    """Or the test above would say nothing."""
    assert error_dec(name, known=False) > 1.5 * without
