"""The simulated world: events in order, exactness whatever the steps, noise by seed."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.thermal.plate import PlateModel
from sim.world.films import PreisachFilm
from sim.world.plant import SimulatedPlant, World

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
FILM = PreisachFilm.bell_shaped(3, relays=500)


def test_small_steps_change_nothing() -> None:
    coarse, fine = (SimulatedPlant(World(PLATE, FILM, ohmmeter_noise_dec=0.0)) for _ in range(2))
    for k, current in enumerate((4.0, -2.0, 3.0, 0.0, 4.0)):
        for plant, parts in ((coarse, 1), (fine, 37)):
            plant.set_current_A(current)
            for part in range(1, parts + 1):
                plant.advance_to(20.0 * k + 20.0 * part / parts)
    assert coarse.temperature_degC == pytest.approx(fine.temperature_degC, abs=1e-9)
    assert coarse.read_resistance_ohm(1e-4) == fine.read_resistance_ohm(1e-4)


def test_what_is_scheduled_runs_in_order_at_its_time() -> None:
    plant = SimulatedPlant(World(PLATE, FILM))
    seen: list[tuple[str, float, float]] = []
    for name, due in (("late", 2.0), ("early", 1.0), ("past", -1.0)):
        plant.schedule(due, lambda t, name=name: seen.append((name, t, plant.time_s)))
    plant.advance_to(1.5)
    assert seen == [("past", 0.0, 0.0), ("early", 1.0, 1.0)]
    plant.advance_to(0.5)
    assert plant.time_s == 1.5
    plant.advance_to(3.0)
    assert seen[-1] == ("late", 2.0, 2.0)


def test_the_driver_limits_the_current() -> None:
    plant = SimulatedPlant(World(PLATE, FILM, current_limit_A=2.0))
    plant.set_current_A(99.0)
    assert plant.current_A == 2.0


def test_noise_has_its_size_and_its_seed() -> None:
    worlds = [World(PLATE, FILM, thermometer_noise_K=0.02, ohmmeter_noise_dec=0.003, seed=s) for s in (1, 1, 2)]
    plants = [SimulatedPlant(world) for world in worlds]
    temperature = np.array([[plant.read_temperature_degC() for _ in range(5000)] for plant in plants])
    resistance = np.log10([[plant.read_resistance_ohm(1e-4) for _ in range(5000)] for plant in plants])
    np.testing.assert_array_equal(temperature[0], temperature[1])
    assert np.any(temperature[0] != temperature[2])
    assert temperature[0].std() == pytest.approx(0.02, rel=0.05)
    assert resistance[0].std() == pytest.approx(0.003, rel=0.05)
    assert abs(np.corrcoef(temperature[0], resistance[0])[0, 1]) < 0.05


def test_relays_switch_as_each_would_alone() -> None:
    film, inputs = PreisachFilm.bell_shaped(2, relays=200), np.random.default_rng(1).uniform(50.0, 72.0, 300)
    for initial, begin in (("cooled", 90.0), ("heated", 30.0), ("cooled", 61.0), ("heated", 61.0)):
        memory = film.initial_memory(begin, initial)
        states = begin > film.down_degC if initial == "cooled" else begin >= film.up_degC
        outputs, _ = film.simulate(inputs[:150], memory)
        again, after = film.simulate(inputs[150:], film.simulate(inputs[:150], memory)[1])
        for v, output in zip(inputs, [*outputs, *again], strict=True):
            states = (states | (v >= film.up_degC)) & (v > film.down_degC)
            assert output == pytest.approx(film.decades * np.mean(states) - 5.0, abs=1e-12)
        np.testing.assert_array_equal(after.metallic, states)


def test_a_film_of_relays_is_smooth() -> None:
    """It is 4e-4 decades off one of a million relays; with places drawn at random it would be 2e-3 off."""
    course = np.concatenate((np.arange(45.0, 62.0, 0.05), np.arange(62.0, 50.0, -0.05), np.arange(50.0, 80.0, 0.05)))
    few, many = (PreisachFilm.bell_shaped(s, relays=n, decades=2.0) for s, n in ((3, 16_000), (4, 1_000_000)))
    shown = [film.simulate(course, film.initial_memory(40.0, "heated"))[0] for film in (few, many)]
    assert np.std(shown[0] - shown[1]) < 6e-4
