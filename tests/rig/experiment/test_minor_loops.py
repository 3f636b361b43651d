"""Where a calibration's minor loops turn, and that the sense of the film's output is seen behind a wide loop."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rig.experiment.calibration import ASIDE, LEAST_STEP, minor_turning_points, transition_range


@pytest.mark.parametrize("loops", [2, 7, 14, 200])
def test_loops_turn_about_the_transition_and_are_none_of_them_alike(loops: int) -> None:
    """The widest may go beyond an end of it, as far as the calibration's range lets them."""
    low, high = 52.0, 71.0
    within, beyond = (51.0, 73.0), ASIDE * (high - low)
    for seed in range(300):
        points = minor_turning_points((low, high), within, loops, seed)
        assert len(points) == 2 * loops
        assert max(within[0], low - beyond) <= min(points) < max(points) <= min(within[1], high + beyond)
        steps = np.abs(np.diff(points))
        nested = 2 * max(2, loops // 3)
        assert low <= min(points[nested:], default=low) <= max(points[nested:], default=high) <= high
        assert np.min(steps[nested:], initial=high) > 0.999 * LEAST_STEP * (high - low)
        turned = [pair for pair in pairwise(points) if set(pair) != set(within)]
        assert len(set(turned)) == len(turned)


def major_loop(sign: float) -> tuple[Any, np.ndarray, np.ndarray]:
    """A film that switches at 70 degC and back at 55, on a plate that is slowest just before either; sign: of log10 R
    with the temperature."""
    shares, at = (0.0, 0.1, 0.9, 1.0), np.linspace(0.0, 1.0, 800)
    down, up = np.interp(at, shares, (72.0, 58.0, 56.0, 52.0)), np.interp(at, shares, (52.0, 67.0, 69.0, 72.0))
    v = np.concatenate([down, up])
    switched = 1.0 / (1.0 + np.exp(-(v - np.where(np.arange(v.size) < down.size, 55.0, 70.0)) / 0.3))
    log = 3.0 + sign * switched
    columns = {"phase": np.full(v.size, "major"), "temperature_degC": v, "resistance_ohm": 10.0**log}
    return SimpleNamespace(column=columns.__getitem__), v, log


@pytest.mark.parametrize("sign", [-1.0, 1.0], ids=["falls", "rises"])
def test_the_transition_is_found_where_the_correlation_has_the_other_sign(sign: float) -> None:
    folder, v, log = major_loop(sign)
    assert sign * np.corrcoef(v, log)[0, 1] < -0.5
    assert transition_range(folder) == pytest.approx((54.0, 71.0), abs=0.5)
