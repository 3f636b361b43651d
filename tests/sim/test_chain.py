"""Every effect in open loop and event by event: both agree, and each does what its equation says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from compensator.hysteresis.film import Memory
from sim.effects.catalogue import catalogue
from sim.effects.effect import Filter, Switched, switched
from sim.inference.record.record import read_columns
from sim.model.film_nodes import FilmNodes
from sim.model.inputs import logged_inputs
from sim.model.links import columns_followed, links_of
from sim.model.ohmmeter import shown_in_rows
from sim.model.plate_path import plate_nodes, simulate_plate
from sim.model.record_run import RecordRun, straight_path
from sim.world.films import PreisachFilm
from sim.world.plant import Readings, SimulatedPlant, World, at_rest, commanded, simulate_record, stamp_s
from tests.sim.small_chain import CURRENT, FILM, PLATE, TEST_CURRENT_A, TIME, on, world


def event_by_event(rig: World, test_current: float = TEST_CURRENT_A) -> tuple[np.ndarray, np.ndarray]:
    """Temperature and log10 R at the rows, with other events at odd times in between."""
    plant, readings = SimulatedPlant(rig), []
    plant.set_test_current_A(test_current)
    for t, current in zip(TIME, CURRENT, strict=True):
        plant.advance_to(t)
        readings.append((plant.read_temperature_degC(), np.log10(plant.read_resistance_ohm(test_current))))
        plant.set_current_A(current)
        for later in (0.013, 0.1, 0.137, 0.411):
            plant.advance_to(t + later)
            assert plant.temperature_degC < 200.0
    temperature, log_R = np.array(readings).T
    return temperature, log_R


def open_loop(rig: World, **more: object) -> Readings:
    return simulate_record(rig, TIME, CURRENT, **{"meter_current_A": TEST_CURRENT_A, **more})  # type: ignore[arg-type]


def film_outputs(
    rig: World, time_s: np.ndarray, degC: np.ndarray, test_A: float | np.ndarray = 0.0, memory: Memory | None = None
) -> np.ndarray:
    """-log10 R of a film whose plate has these temperatures, straight between the rows."""
    chain, record = RecordRun(rig.model), commanded(time_s, np.zeros(time_s.size), test_A)
    path = straight_path(record.time_s, degC, chain.spacing.longest_s)
    return chain.film(record, path, at_rest(rig, float(degC[0])), memory).output


@pytest.mark.parametrize("name", [*catalogue(), "all"])
def test_events_and_open_loop_agree(name: str) -> None:
    sizes = {"actuator_deadband": {"deadband_A": 0.3}}
    rig = world(*(on(e, **sizes.get(e, {})) for e in ([name] if name != "all" else catalogue())))
    temperature, log_R = event_by_event(rig)
    expected, plain = open_loop(rig), open_loop(world())
    np.testing.assert_allclose(temperature, expected.temperature_degC, atol=1e-6, rtol=0.0)
    np.testing.assert_allclose(log_R, np.log10(expected.resistance_ohm), atol=1e-5, rtol=0.0)
    changed_K = np.max(np.abs(expected.temperature_degC - plain.temperature_degC))
    changed_dec = np.max(np.abs(np.log10(expected.resistance_ohm / plain.resistance_ohm)))
    assert changed_K > 0.01 or changed_dec > 1e-3  # it does something


def test_lags_against_a_library_integrator() -> None:
    """Plate, thermometer and film as one system of equations."""
    run = open_loop(world(on("sensor_lag", tau_s=3.0), on("film_lag", tau_s=2.0)))

    def rates(_: float, x: np.ndarray, current: float) -> list[float]:
        plate, shown, film = x
        return [PLATE.rate_K_per_s(plate, current), (plate - shown) / 3.0, (plate - film) / 2.0]

    state, film, shown = np.full(3, 50.0), [50.0], [50.0]
    for current in CURRENT[:-1]:
        course = solve_ivp(rates, (0.0, 0.5), state, args=(current,), rtol=1e-10, atol=1e-10, max_step=0.02)
        film.extend(course.y[2, 1:])
        state = course.y[:, -1]
        shown.append(state[1])
    np.testing.assert_allclose(run.temperature_degC, shown, atol=2e-6)
    outputs, _ = FILM.simulate(film, FILM.initial_memory(50.0, "cooled"))
    assert -np.log10(run.resistance_ohm[-1]) == pytest.approx(outputs[-1], abs=1e-6)


def test_a_heated_film_has_the_temperature_of_its_own_resistance() -> None:
    """Where the film cannot remember anything, the fixed point is a root of one equation."""
    theta, test_current = 3000.0, 1e-3
    rig = world(on("self_heating", theta_K_per_W=theta))
    output = film_outputs(rig, np.array([0.0, 1.0]), np.array([45.0, 45.0]), test_current)
    memory = FILM.initial_memory(45.0, "cooled")

    def excess(film_degC: float) -> float:
        return film_degC - 45.0 - theta * test_current**2 * 10.0 ** -FILM.step(film_degC, memory)[0]

    film_degC = brentq(excess, 45.0, 300.0, xtol=1e-12)
    assert film_degC > 50.0
    assert output[0] == pytest.approx(FILM.step(film_degC, memory)[0], abs=1e-8)


def test_heating_comes_and_goes_with_the_test_current() -> None:
    rig = world(on("self_heating", theta_K_per_W=3000.0))
    rows, test = np.arange(40.0), np.where(np.arange(40) // 10 % 2, 1e-3, 1e-5)
    memory = FILM.initial_memory(45.0, "heated")
    output = film_outputs(rig, rows, np.full(40, 45.0), test, memory)
    assert output[15] > output[5] + 0.05  # warm: less resistance
    assert output[35] == pytest.approx(output[15], abs=1e-9)  # a minor loop closes
    assert output[25] > output[5] + 1e-3  # hysteresis: not where it was


@pytest.mark.long
def test_relays_that_are_heated_settle() -> None:
    """A film that jumps has no fixed point everywhere: the search ends, and finds the jump."""
    rig = World(PLATE, PreisachFilm.bell_shaped(1, relays=300), first_degC=50.0, effects=(on("self_heating"),))
    run = open_loop(rig, meter_current_A=1e-3)
    assert np.all(np.isfinite(run.resistance_ohm))


def test_order_at_the_ohmmeter() -> None:
    """Series, shunt, then the range's error; quantization after the noise."""
    effects = on("parallel_leakage", leakage_ohm=1e5), on("series_resistance", series_ohm=500.0)
    plain = open_loop(world()).resistance_ohm
    run = open_loop(world(on("meter_range_error", threshold_ohm=1e4, error=0.05), *effects)).resistance_ohm
    both = 1.0 / (1.0 / (plain + 500.0) + 1e-5)
    np.testing.assert_allclose(run, np.where(both > 1e4, 1.05 * both, both), rtol=1e-12)
    lagging = open_loop(world(on("meter_lag", tau_s=1e-9), *effects)).resistance_ohm
    np.testing.assert_allclose(lagging, both, rtol=1e-6)


def test_quantization_comes_after_the_noise() -> None:
    rig = World(PLATE, FILM, first_degC=50.0, thermometer_noise_K=0.1, effects=(on("thermometer_quantization"),))
    shown = open_loop(rig).temperature_degC
    step = on("thermometer_quantization").par[0]
    np.testing.assert_allclose(shown / step, np.round(shown / step), atol=1e-9)


@pytest.mark.parametrize("skew", [1.3, -1.3])
def test_a_skewed_record_is_a_shifted_one(skew: float) -> None:
    skewed = open_loop(world(on("timestamp_skew", skew_s=skew)))
    fresh = open_loop(world(), resistance_time_s=TIME - skew)
    inside = (TIME > 2.0) & (TIME < 297.0)
    np.testing.assert_allclose(skewed.resistance_ohm[inside], fresh.resistance_ohm[inside], rtol=1e-4)


def test_a_negative_skew_is_stamped_when_the_record_is_written() -> None:
    early, late = world(on("timestamp_skew", skew_s=-1.5)), world(on("timestamp_skew", skew_s=1.5))
    np.testing.assert_array_equal(stamp_s(early, TIME), TIME - 1.5)
    np.testing.assert_array_equal(stamp_s(late, TIME), TIME)
    _, live = event_by_event(early)
    np.testing.assert_allclose(live, -open_loop(world()).output, atol=1e-9)


def test_creep_is_a_share_of_the_hysteretic_part() -> None:
    """After a step and a long wait the film is where it would have been without."""
    rows = np.arange(0.0, 1000.0)
    step = np.where(rows < 10.0, 50.0, 64.0)
    share, tau = 0.2, 60.0
    creeping = film_outputs(world(on("creep", share=share, tau_s=tau)), rows, step)
    plain = film_outputs(world(), rows, step)
    late = creeping[12] - plain[12]
    assert late < -0.01
    assert creeping[12 + 60] - plain[12 + 60] == pytest.approx(late / np.e, rel=1e-3)
    assert creeping[-1] == pytest.approx(plain[-1], abs=1e-6)


def test_the_sink_shown_is_that_of_the_heat_sink() -> None:
    plant = SimulatedPlant(world(on("ambient_drift"), on("heat_sink_warmup"), on("radiative_loss")))
    plant.set_current_A(-2.0)
    plant.advance_to(60.0)
    assert plant.sink_temperature_degC() > 26.0
    assert SimulatedPlant(world(on("radiative_loss"))).sink_temperature_degC() == 25.0


def test_an_effect_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="film_lag: switched on twice"):
        links_of([on("film_lag"), on("film_lag", tau_s=5.0)])


def test_a_trial_that_has_no_resistance_warns_of_nothing() -> None:
    """A search may try outputs of hundreds of decades; pytest makes an error of a warning."""
    every = np.arange(3)
    nodes = FilmNodes(every.astype(float), np.zeros(3), np.zeros(3, np.int8), every, None, every, every)
    links = links_of([on("meter_range_error", threshold_ohm=1e4, error=0.01)])
    signal = np.array([-400.0, -5.0, 400.0])
    shown = shown_in_rows(links, nodes, signal, signal)
    np.testing.assert_allclose(shown, signal - np.log10([1.01, 1.01, 1.0]), rtol=0.0, atol=1e-12)


WITH_COLUMNS = [e for e in catalogue().values() if isinstance(e.form, Filter) and e.form.columns is not None]


@pytest.mark.parametrize("effect", WITH_COLUMNS, ids=lambda e: e.name)
@pytest.mark.parametrize("tau_s", [0.0, 0.2, 300.0])
def test_to_the_bit(effect: object, tau_s: float) -> None:
    """Uneven times, two nodes at one of them, and a filter that is none."""
    assert isinstance(effect, type(WITH_COLUMNS[0]))
    assert isinstance(effect.form, Filter)
    rng = np.random.default_rng(1)
    time_s = np.cumsum(rng.choice([0.0, 0.1, 0.1, 0.3], 500))
    columns = np.cumsum(rng.standard_normal((500, 7)), axis=0)
    par = np.array([tau_s if p.name == "tau_s" else 0.1 for p in effect.parameters])
    one_by_one = replace(effect, form=replace(effect.form, columns=None))
    together = columns_followed(Switched(effect, par), time_s, columns)
    np.testing.assert_array_equal(together, columns_followed(Switched(one_by_one, par), time_s, columns))


def test_the_film_and_the_ohmmeter_have_some() -> None:
    assert {e.name for e in WITH_COLUMNS} == {"creep", "meter_lag"}


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


NAN = np.nan


def test_a_drive_is_held_and_a_temperature_is_above_its_first_reading() -> None:
    columns = {"input_2": np.array([NAN, 0.5, NAN, 1.0]), "sink_degC": np.array([NAN, 20.0, NAN, 24.0])}
    found = logged_inputs(columns, [0])
    assert found.names == ("input_2", "sink_degC")
    np.testing.assert_allclose(found.values, [[0.0, 0.0], [0.5, 0.0], [0.5, 2.0], [1.0, 4.0]])


def test_what_does_not_change_is_no_input() -> None:
    assert logged_inputs({"ambient_degC": np.full(4, 21.0), "input_2": np.full(4, NAN)}, [0]).names == ()


def test_each_record_has_a_first_reading_of_its_own() -> None:
    found = logged_inputs({"ambient_degC": np.array([20.0, 21.0, 30.0, 32.0, NAN, NAN])}, [0, 2, 4])
    np.testing.assert_allclose(found.values[:, 0], [0.0, 1.0, 0.0, 2.0, 0.0, 0.0])


def test_the_mean_between_two_nodes() -> None:
    """Of a drive what is held, of a temperature what lies on a straight line; after the last node what is there."""
    found = logged_inputs({"input_2": np.array([1.0, 3.0]), "ambient_degC": np.array([20.0, 24.0])}, [0])
    means = found.between(np.array([0.0, 2.0]), np.array([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(means, [[1.0, 1.0], [1.0, 3.0], [3.0, 4.0]])
