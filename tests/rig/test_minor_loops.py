"""Where a calibration's minor loops turn, and that the sense of the film's output is seen behind a wide loop."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from rig.experiment.minor_loops import LEAST_STEP, minor_turning_points


@pytest.mark.parametrize("loops", [2, 7, 14, 200])
def test_loops_turn_inside_the_transition_and_are_none_of_them_alike(loops: int) -> None:
    low, high = 52.0, 71.0
    for seed in range(300):
        points = minor_turning_points((low, high), loops, seed)
        assert len(points) == 2 * loops
        assert low <= min(points) < max(points) <= high
        steps = np.abs(np.diff(points))
        nested = 2 * max(2, loops // 3)
        assert np.min(steps[nested:], initial=high) > 0.999 * LEAST_STEP * (high - low)
        turned = list(pairwise(points))
        assert len(set(turned)) == len(turned)
