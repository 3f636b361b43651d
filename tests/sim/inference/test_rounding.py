"""The last digit of a thermometer's readings, and what its rounding may do to them."""

from __future__ import annotations

import numpy as np
import pytest

from sim.inference.transition.transition import last_digit, rounding_errors


@pytest.mark.parametrize("step", [0.25, 0.1, 0.01, 0.489])
def test_the_digit_that_readings_are_rounded_to(step: float) -> None:
    random = np.random.default_rng(0)
    true = np.linspace(20.0, 100.0, 900) + 0.05 * random.standard_normal(900)
    shown = step * np.round(true / step)
    assert last_digit(shown - 273.15) == pytest.approx(step)
    shown[5] += 0.3 * step
    assert last_digit(true) < 1e-3  # of readings with all their digits


def test_constant_readings_have_none() -> None:
    assert last_digit(np.full(50, 20.0)) == 0.0
    assert last_digit(np.array([np.nan, 1.0, 2.0])) == 0.0


def test_errors_in_step_stay_and_others_average_out() -> None:
    random = np.random.default_rng(0)
    in_step = rounding_errors(20.0 + 0.25 * np.arange(200), 0.25, 0.0, random)
    assert np.std(np.mean(in_step, axis=1)) == pytest.approx(0.25 / np.sqrt(12.0), rel=0.05)
    out_of_step = rounding_errors(20.0 + 0.25 * 0.382 * np.arange(200), 0.25, 0.0, random)
    assert np.std(np.mean(out_of_step, axis=1)) < 0.01
    dithered = rounding_errors(20.0 + 0.25 * np.arange(200), 0.25, 0.4, random)
    assert np.std(np.mean(dithered, axis=1)) < 0.02
    assert np.max(np.abs(in_step)) <= 0.125 + 1e-9
