"""The ohmmeter heats the film between rows too: a row's test current is on since the row before."""

from __future__ import annotations

import numpy as np

from sim.diagnosis.data.record import read_columns
from sim.diagnosis.fit.path_estimate import measured_path
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from sim.model.film_nodes import film_nodes
from sim.model.links import links_of
from sim.model.meter_power import MeterPower
from sim.model.record_own import FilmStart

TIME = np.arange(200) * 0.5
CHANGE = 80  # the last row with the first current
CURRENT = np.where(np.arange(TIME.size) > CHANGE, 1e-5, 3e-5)
OUTPUT = -5.0 + 0.01 * TIME
POWER = MeterPower(TIME, CURRENT, OUTPUT)


def test_at_the_rows_it_is_the_current_squared_times_the_resistance() -> None:
    np.testing.assert_allclose(POWER.at(TIME), CURRENT**2 * 10.0**-OUTPUT, rtol=1e-12)


def test_the_next_rows_current_is_on_right_after_a_row() -> None:
    (jump,) = POWER.jumps_s()
    assert TIME[CHANGE] < jump < TIME[CHANGE] + 1e-4
    between = np.array([jump, TIME[CHANGE] + 0.3])
    np.testing.assert_allclose(POWER.at(between), 1e-10 * 10.0 ** (5.0 - 0.01 * between), rtol=1e-9)


def test_a_film_that_is_heated_less_turns_where_the_current_falls() -> None:
    """While the plate warms by 0.05 K a row: down by most of the self-heating, and up again by the next row."""
    plate = 40.0 + 0.1 * TIME
    record = read_columns(
        {"time_s": TIME, "temperature_degC": plate, "resistance_ohm": 10.0**-OUTPUT, "meter_current_A": CURRENT}
    )
    theta = 3e4
    links = links_of([switched(catalogue()["self_heating"], [theta])])
    nodes = film_nodes(record, measured_path(record), links, [], POWER, FilmStart())
    at_rows = np.searchsorted(nodes.time_s, TIME)
    np.testing.assert_allclose(nodes.film_degC[at_rows], plate + theta * POWER.at(TIME), atol=1e-9)
    after = nodes.film_degC[at_rows[CHANGE] + 1]
    assert nodes.time_s[at_rows[CHANGE] + 1] < TIME[CHANGE + 1]
    np.testing.assert_allclose(after, plate[CHANGE] + theta * 1e-10 * 10.0 ** -OUTPUT[CHANGE], atol=1e-3)
    assert nodes.film_degC[at_rows[CHANGE]] > nodes.film_degC[at_rows[CHANGE + 1]] > after
