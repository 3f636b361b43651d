"""The ohmmeter heats the film between rows too: a row's test current is on since the row before, or as told."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from sim.inference.record.record import Record, read_columns
from sim.model.film_nodes import film_nodes
from sim.model.links import links_of
from sim.model.meter_power import MeterCurrent, MeterPower, since_the_row_before
from sim.model.record_own import FilmStart
from sim.model.record_run import straight_path

TIME = np.arange(200) * 0.5
CHANGE = 80  # the last row with the first current
CURRENT = np.where(np.arange(TIME.size) > CHANGE, 1e-5, 3e-5)
OUTPUT = -5.0 + 0.01 * TIME
POWER = MeterPower(MeterCurrent(TIME, CURRENT, since_the_row_before(TIME)), OUTPUT)
LATER_S = 0.3  # after the row before
THETA = 3e4


def readings(plate: Array, **more: Array) -> Record:
    ohm = 10.0**-OUTPUT
    columns = {"time_s": TIME, "temperature_degC": plate, "resistance_ohm": ohm, "meter_current_A": CURRENT}
    return read_columns({**columns, **more})


def told(on_s: float) -> Array:
    return np.where(np.arange(TIME.size) > CHANGE, on_s, np.nan)


def test_at_the_rows_it_is_the_current_squared_times_the_resistance() -> None:
    np.testing.assert_allclose(POWER.at(TIME), CURRENT**2 * 10.0**-OUTPUT, rtol=1e-12)


def test_the_next_rows_current_is_on_right_after_a_row() -> None:
    (jump,) = POWER.meter.jumps_s()
    assert TIME[CHANGE] < jump < TIME[CHANGE] + 1e-4
    between = np.array([jump, TIME[CHANGE] + 0.3])
    np.testing.assert_allclose(POWER.at(between), 1e-10 * 10.0 ** (5.0 - 0.01 * between), rtol=1e-9)


def test_a_film_that_is_heated_less_turns_where_the_current_falls() -> None:
    """While the plate warms by 0.05 K a row: down by most of the self-heating, and up again by the next row."""
    plate = 40.0 + 0.1 * TIME
    record, theta = readings(plate), THETA
    links = links_of([switched(catalogue()["self_heating"], [theta])])
    nodes = film_nodes(record, straight_path(record.time_s, record.temperature_degC), links, [], POWER, FilmStart())
    at_rows = np.searchsorted(nodes.time_s, TIME)
    np.testing.assert_allclose(nodes.film_degC[at_rows], plate + theta * POWER.at(TIME), atol=1e-9)
    after = nodes.film_degC[at_rows[CHANGE] + 1]
    assert nodes.time_s[at_rows[CHANGE] + 1] < TIME[CHANGE + 1]
    np.testing.assert_allclose(after, plate[CHANGE] + theta * 1e-10 * 10.0 ** -OUTPUT[CHANGE], atol=1e-3)
    assert nodes.film_degC[at_rows[CHANGE]] > nodes.film_degC[at_rows[CHANGE + 1]] > after


def test_a_current_that_came_on_later_is_on_from_then() -> None:
    record = readings(40.0 + 0.0 * TIME, meter_current_time_s=told(TIME[CHANGE] + LATER_S))
    meter = MeterCurrent(record.time_s, CURRENT, record.test_on_s)
    at, after = meter.jumps_s()
    assert at == TIME[CHANGE] + LATER_S < after < at + 1e-4
    power = MeterPower(meter, OUTPUT)
    for moments, current in ((np.array([TIME[CHANGE] + 0.1, at]), 3e-5), (np.array([after, TIME[CHANGE + 1]]), 1e-5)):
        np.testing.assert_allclose(power.at(moments), current**2 * 10.0 ** (5.0 - 0.01 * moments), rtol=1e-9)


def test_a_film_goes_on_with_the_plate_until_the_current_changes() -> None:
    """The plate turns between the row and the change: what the film gets to is the change's temperature, not the
    row's."""
    plate = 40.0 + 0.1 * TIME
    record = readings(plate, meter_current_time_s=told(TIME[CHANGE] + LATER_S))
    meter = MeterCurrent(record.time_s, CURRENT, record.test_on_s)
    power = MeterPower(meter, OUTPUT)
    links = links_of([switched(catalogue()["self_heating"], [THETA])])
    nodes = film_nodes(record, straight_path(record.time_s, record.temperature_degC), links, [], power, FilmStart())
    place = np.searchsorted(nodes.time_s, meter.jumps_s())
    heated = THETA * 10.0 ** -(OUTPUT[CHANGE] + 0.01 * LATER_S) * CURRENT[[CHANGE, CHANGE + 1]] ** 2
    np.testing.assert_allclose(nodes.film_degC[place], plate[CHANGE] + 0.1 * LATER_S + heated, atol=1e-3)


@pytest.mark.parametrize(("on_s", "expected_s"), [(-5.0, TIME[CHANGE]), (TIME[CHANGE] + 9.0, TIME[CHANGE + 1])])
def test_a_current_comes_on_between_the_row_before_and_its_own(on_s: float, expected_s: float) -> None:
    assert readings(40.0 + 0.0 * TIME, meter_current_time_s=told(on_s)).test_on_s[CHANGE + 1] == expected_s


def test_a_current_is_on_when_the_resistance_is_read_with_it() -> None:
    early = TIME - 0.1
    record = readings(40.0 + 0.0 * TIME, meter_current_time_s=told(TIME[CHANGE + 1]), resistance_time_s=early)
    assert record.test_on_s[CHANGE + 1] == pytest.approx(early[CHANGE + 1], abs=1e-12)
