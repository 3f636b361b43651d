"""The horizon: a loop of a known width over a known rate."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.control.reference_shaping import LONGEST_S, POINTS, crossing_s, preview
from compensator.hysteresis.film import IDENTITY, FilmModel
from compensator.thermal.plate import PlateModel

WIDE = FilmModel(np.array([2.0]), np.array([1.0]), IDENTITY, IDENTITY)  # one play operator: a loop 4 K wide
SYMMETRIC = PlateModel(1.0 / 300.0, 0.0, 0.0, 25.0)  # no heat of its own, no loss: rates by the Seebeck term alone


@pytest.mark.parametrize("limit_A", [1.0, 4.0])
def test_it_is_the_loop_s_width_over_the_plate_s_slowest_rate(limit_A: float) -> None:
    slowest = limit_A * (20.0 + 273.15) / 300.0
    assert crossing_s(WIDE, SYMMETRIC, limit_A, 10.0, 90.0) == pytest.approx(4.0 / slowest, rel=0.03)


def test_a_film_without_a_loop_needs_none_and_a_plate_that_does_not_cool_has_an_end() -> None:
    line = FilmModel(np.array([0.0]), np.array([1.0]), IDENTITY, IDENTITY)
    assert crossing_s(line, SYMMETRIC, 4.0, 10.0, 90.0) == 0.0
    heater = PlateModel(0.0, 0.0, 1e-9, 25.0, 1.0, "heater")
    assert crossing_s(WIDE, heater, 1.0, 30.0, 90.0) == LONGEST_S


def test_targets_are_no_closer_than_a_period() -> None:
    assert preview(12.0, 0.1) == (POINTS, 1.0)
    assert preview(0.5, 0.1) == (5, 0.1)
    assert preview(0.0, 0.1) == (2, 0.1)
