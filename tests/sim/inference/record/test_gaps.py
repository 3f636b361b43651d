"""What the diagnosis makes of missing rows: nothing is made up of what happened there."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.functions import Array
from sim.diagnosis.row_warnings import row_warnings
from sim.effects.catalogue import catalogue
from sim.effects.effect import Switched
from sim.inference.record.lattice import lattice_step, step_error
from sim.inference.record.record import Record, read_columns
from sim.model.film_nodes import film_nodes
from sim.model.gaps import gap_threshold
from sim.model.links import links_of
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart

EFFECTS = catalogue()


def a_record(time: Array, current: Array | None = None) -> Record:
    current = np.sin(time / 40.0) if current is None else current
    return read_columns(
        {
            "time_s": time,
            "temperature_degC": 40.0 + 10.0 * np.sin(time / 30.0),
            "current_A": current,
            "resistance_ohm": np.full(time.size, 100.0),
        }
    )


def with_a_gap(rows: int) -> Record:
    """2000 rows of 0.5 s, less so many from row 800 on."""
    return a_record(np.delete(0.5 * np.arange(2000), slice(800, 800 + rows)))


def test_uneven_rows_are_no_gaps() -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.25, 0.75, 3000))
    assert a_record(time).after_gaps.tolist() == []
    assert a_record(np.delete(time, slice(800, 802))).after_gaps.tolist() == [800]
    steps = np.full(1000, 0.5)
    steps[::12] = 1.0
    assert np.sum(steps > gap_threshold(steps)) == 84


def test_a_missing_row_begins_a_stretch_only_where_its_command_is_not_known() -> None:
    rng = np.random.default_rng(4)
    time = 0.5 * np.arange(2000)
    current = np.where(time < 400.0, 0.5, 0.8) + 5e-4 * rng.standard_normal(2000)
    temperature = np.empty(2000)
    temperature[0] = 30.0
    for k in range(1, 2000):
        temperature[k] = temperature[k - 1] + 0.5 * (1.5 * current[k - 1] - 0.05 * (temperature[k - 1] - 20.0))
    temperature += 0.01 * rng.standard_normal(2000)
    columns = {"time_s": time, "temperature_degC": temperature, "current_A": current}

    def begins(*missing: int | range) -> list[int]:
        rows = np.concatenate([np.atleast_1d(m) for m in missing])
        record = read_columns({name: np.delete(values, rows) for name, values in columns.items()})
        assert record.after_gaps.size == len(missing)
        return record.first_rows.tolist()

    assert begins(200, 600, 1200) == [0]
    assert begins(200, 800, 1200) == [0, 799]  # the step is in it
    assert begins(200, range(1200, 1210)) == [0, 1199]  # anything may have happened
    told = current.copy()
    told[[300, 800]] = np.nan
    assert read_columns({**columns, "current_A": told}).first_rows.tolist() == [0, 801]
    told[1200:1220] = np.nan  # no command is known for 10 s
    assert read_columns({**columns, "current_A": told}).first_rows.tolist() == [0, 801, *range(1201, 1221)]
    told[1990:] = np.nan
    assert read_columns({**columns, "current_A": told}).first_rows.size == 2 + 20 + 9


def test_a_late_tick_whose_command_is_told_is_no_gap() -> None:
    """The first command of a run may take a period: it acts late, and the next one follows it at the usual pace."""
    time = np.concatenate(([0.0, 0.07], 0.265 + 0.1 * np.arange(500)))
    temperature = 40.0 + 0.01 * np.random.default_rng(5).standard_normal(time.size)
    columns = {"time_s": time, "temperature_degC": temperature, "current_A": np.sin(time)}
    assert read_columns(columns).after_gaps.tolist() == [2]
    acts = time + 0.01
    acts[:2] = np.nan, 0.2
    assert read_columns({**columns, "current_time_s": acts}).after_gaps.tolist() == []
    fewer = {name: np.delete(values, 200) for name, values in {**columns, "current_time_s": acts}.items()}
    assert read_columns(fewer).after_gaps.tolist() == [200]  # here a command is missing


def test_commands_in_a_gap_are_on_a_straight_line() -> None:
    record = with_a_gap(1)
    time, current = record.commands
    assert time.size == 2000
    np.testing.assert_allclose(time, 0.5 * np.arange(2000), atol=1e-9)
    assert record.current_A is not None
    assert current[800] == pytest.approx(0.5 * (record.current_A[799] + record.current_A[800]))


def test_a_night_between_two_rows_is_no_million_commands() -> None:
    time = 0.5 * np.arange(2000)
    time[1000:] += 40_000.0
    assert a_record(time).commands[0].size < 4000


def test_what_a_command_in_a_gap_may_still_change_is_not_fitted() -> None:
    record = with_a_gap(30)
    fitted = record.commanded_in_sight([EFFECTS["actuator_delay"]])
    latest = EFFECTS["actuator_delay"].parameters[0].largest
    for used in (fitted.temperature_used, fitted.output_used):
        assert np.flatnonzero(~used).tolist() == list(range(800, 800 + round(latest / 0.5)))
    assert np.all(record.commanded_in_sight([EFFECTS["creep"], EFFECTS["actuator_deadband"]]).temperature_used)


def test_many_gaps_leave_most_of_a_record() -> None:
    time = np.delete(0.5 * np.arange(2000), slice(100, 1900, 30))
    record = a_record(time, np.random.default_rng(3).uniform(-1.0, 1.0, time.size))
    assert record.first_rows.size == 61
    fitted = record.commanded_in_sight(EFFECTS.values())
    assert 0.05 < np.mean(~fitted.temperature_used) <= 0.2


def test_a_stretch_without_a_reading_is_none() -> None:
    time = np.delete(0.5 * np.arange(2000), [*range(800, 830), *range(834, 864)])
    record = a_record(time)
    assert record.first_rows.tolist() == [0, 800, 804]
    assert record.commanded_in_sight(EFFECTS.values()).first_rows.tolist() == [0, 804]


def test_a_long_gap_stays_one_where_another_row_is_missing_soon_after() -> None:
    """Nothing counts between the two: begun anew at the second, the film would have gone through the first as a made-up
    plate did, and nobody would look for where it went."""
    time = np.delete(0.5 * np.arange(2000), [*range(800, 830), 834])
    record = a_record(time, np.random.default_rng(3).uniform(-1.0, 1.0, time.size))
    assert record.first_rows.tolist() == [0, 800, 804]
    assert record.commanded_in_sight(EFFECTS.values()).first_rows.tolist() == [0, 800]


def test_what_may_have_been_read_in_a_long_gap_is_not_fitted() -> None:
    record = with_a_gap(60)
    used = record.read_while_it_ran([EFFECTS["timestamp_skew"]]).output_used
    assert not np.any(used[792:808])
    assert np.all(used[20:780])
    assert np.all(used[820:1900])
    assert np.all(with_a_gap(2).read_while_it_ran([EFFECTS["timestamp_skew"]]).output_used[20:1900])


def test_the_film_does_not_follow_what_was_made_up_in_a_gap() -> None:
    record = with_a_gap(40)
    time = 0.5 * np.arange(2000)
    plate = 40.0 + 5.0 * (np.abs(time - 410.0) < 9.0)  # a simulation left to itself in the gap
    path = PlatePath(time, plate, np.zeros((time.size, 2)))
    skew = Switched(EFFECTS["timestamp_skew"], np.array([1.3]))
    nodes = film_nodes(record, path, links_of([skew]), [], None, FilmStart())
    assert np.any((nodes.time_s > record.time_s[799]) & (nodes.time_s < record.time_s[800]))
    np.testing.assert_allclose(nodes.film_degC, 40.0, atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_a_lattice_is_told_beneath_outliers(share: float) -> None:
    rng = np.random.default_rng(2)
    values = 45.0 + 20.0 * np.sin(np.arange(6000) / 300.0) + 0.01 * rng.standard_normal(6000)
    values = 0.0625 * np.round(values / 0.0625)
    bad = rng.choice(6000, int(share * 6000), replace=False)
    values[bad] += rng.uniform(-10.0, 10.0, bad.size)
    assert lattice_step(values) == pytest.approx(0.0625, rel=1e-6)
    moved = values * (1.0 + 1e-12 * rng.standard_normal(6000))  # as a conversion leaves them
    assert lattice_step(moved) == pytest.approx(0.0625, rel=1e-6)
    assert lattice_step(values + 0.01 * rng.standard_normal(6000)) == 0.0
    assert lattice_step(np.round(values + 0.01 * rng.standard_normal(6000), 3)) == 0.0


def test_a_step_is_found_through_the_last_digit_of_a_file() -> None:
    """An instrument's step is no multiple of what a file writes: 40 K of readings at 0.0867 K, in 0.001 K."""
    true = 0.08668181821973647
    readings = np.round(true * np.round(np.random.default_rng(3).uniform(22.0, 63.0, 6000) / true), 3)
    step = lattice_step(readings)
    assert abs(step - true) < 3.0 * step_error(readings, step) < 1e-5


@pytest.mark.parametrize(
    ("untold", "lacking", "said"),
    [
        ([], [], None),
        ([], [100, 101], "1 gap in the rows, of 3 s"),
        ([30, 60], [], "2 gaps in the rows' currents, the longest of 1 s"),
        ([30, 60], [100, 101], "3 gaps in the rows or in their currents, the longest of 3 s"),
    ],
)
def test_a_gap_is_said_to_be_where_it_is(untold: list[int], lacking: list[int], said: str | None) -> None:
    """A row that does not tell its current is no missing row."""
    time = np.arange(200.0)
    current = np.where(np.isin(time, untold), np.nan, np.sin(time / 9.0))
    columns = {"time_s": time, "temperature_degC": 25.0 + np.sin(time / 20.0), "current_A": current}
    there = ~np.isin(time, lacking)
    warnings = row_warnings(read_columns({name: values[there] for name, values in columns.items()}))
    found = [caution for caution in warnings if caution.code == "gaps"]
    assert [caution.text.startswith(said) for caution in found] == [True] if said else not found
