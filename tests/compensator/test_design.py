"""The designed loops keep their Ms, and python-control's own closed loop agrees with the discrete PID."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.control.pid import (
    PidGains,
    design_pi,
    loop_margins,
    maximum_sensitivity,
    pi_integrated,
    pi_output,
    sampled_loop,
)


@pytest.mark.parametrize("ms", [1.2, 1.4, 2.0])
@pytest.mark.parametrize(("pole", "dead"), [(0.0, 0.1), (0.02, 0.5), (0.3, 0.0)])
def test_the_fastest_loop_within_ms(ms: float, pole: float, dead: float) -> None:
    design = design_pi(0.5, pole, dead, 0.1, ms)
    assert design.margins.ms <= ms + 1e-9
    faster = PidGains(design.gains.kp * 1.1, design.gains.ki * 1.2)
    if pole < 0.1:  # where the dead time, not the search's end, is what limits
        assert maximum_sensitivity(sampled_loop(faster, 0.5, pole, dead, 0.1), 0.1) > ms
    assert design.margins.phase_margin_deg > 2 * np.degrees(np.arcsin(0.5 / ms)) - 1e-6  # what Ms guarantees
    assert design.margins.gain_margin > ms / (ms - 1.0) - 1e-6


def test_margins_of_a_loop_known_by_hand() -> None:
    """L = k h / (z (z - 1)), theta = omega h: phase -90 - 3/2 theta degrees, |L| = k h / (2 sin(theta / 2))."""
    margins = loop_margins(sampled_loop(PidGains(0.5, 0.0), 1.0, 0.0, 0.1, 0.1), 0.1)
    theta = 2.0 * np.arcsin(0.5 * 0.5 * 0.1)
    assert margins.crossover_rad_per_s == pytest.approx(theta / 0.1, rel=1e-3)
    assert margins.phase_margin_deg == pytest.approx(90.0 - 1.5 * np.degrees(theta), abs=0.05)
    assert margins.gain_margin == pytest.approx(1.0 / (0.5 * 0.1), rel=1e-3)  # at theta = 60 degrees


def test_an_unstable_loop_has_no_margin() -> None:
    assert maximum_sensitivity(sampled_loop(PidGains(50.0, 0.0), 1.0, 0.0, 0.3, 0.1), 0.1) == np.inf


def test_the_closed_loop_is_the_one_that_was_designed() -> None:
    """The discrete PID on the sampled integrator, step by step, against python-control's closed loop."""
    import control

    design = design_pi(1.0, 0.0, 0.1, 0.1, 1.4)
    loop = sampled_loop(design.gains, 1.0, 0.0, 0.1, 0.1)
    times = np.arange(80) * 0.1
    _, expected = control.step_response(control.feedback(loop, 1), times)
    integral, y, delayed, outputs = 0.0, 0.0, 0.0, []
    for _ in times:
        outputs.append(y)
        u = pi_output(design.gains, integral, 1.0, y)
        integral = pi_integrated(design.gains, integral, 1.0, y, 0.0, 0.1)
        y, delayed = y + 0.1 * delayed, u
    np.testing.assert_allclose(outputs, np.ravel(expected)[:80], atol=1e-10)


def test_the_integrator_leaves_saturation_at_once() -> None:
    gains, limit, integral, y = PidGains(2.0, 1.0, tracking_time_s=0.1), 1.0, 0.0, 0.0
    for _ in range(500):  # far below the setpoint: saturated
        v = pi_output(gains, integral, 10.0, y)
        integral = pi_integrated(gains, integral, 10.0, y, min(max(v, -limit), limit) - v, 0.1)
    assert pi_output(gains, integral, -0.5, 0.0) < limit  # the error changes its sign, and so does the direction
    assert abs(integral) < 25.0
