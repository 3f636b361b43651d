"""What a record logs of a second drive and of the plate's surroundings, as the plate's balance takes it."""

from __future__ import annotations

import numpy as np

from sim.model.inputs import logged_inputs

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
