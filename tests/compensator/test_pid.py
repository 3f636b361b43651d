"""PID: python-control's response without saturation, gains without a bump, and no wind-up."""

from __future__ import annotations

import control
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from compensator.control.pid import PidGains, PidState, pid_integrate, pid_output

H = 0.1
GAINS = st.builds(
    PidGains,
    kp=st.floats(0.1, 5.0),
    ki=st.floats(0.0, 3.0),
    kd=st.floats(0.0, 1.0),
    filter_time_s=st.floats(0.01, 1.0),
    b=st.just(1.0),
    c=st.just(1.0),
    tracking_time_s=st.just(np.inf),
)


def response(gains: PidGains, errors: np.ndarray) -> np.ndarray:
    """Output for a sequence of errors (setpoint, with the process variable at 0); nothing saturates."""
    state, outputs = PidState(weighted_error=0.0), []
    for error in errors:
        u, state = pid_output(gains, state, float(error), 0.0, H)
        state = pid_integrate(gains, state, float(error), 0.0, 0.0, H)
        outputs.append(u)
    return np.array(outputs)


@settings(deadline=None, max_examples=40)
@given(GAINS, st.integers(0, 2**32 - 1))
def test_it_is_the_same_discrete_transfer_function(gains: PidGains, seed: int) -> None:
    errors = np.random.default_rng(seed).normal(size=60)
    z = control.tf([1.0, 0.0], [1.0], H)
    tf = gains.filter_time_s
    c = gains.kp + gains.ki * H / (z - 1.0) + gains.kd * (z - 1.0) / ((tf + H) * z - tf)
    num, den = np.atleast_1d(c.num[0][0]), np.atleast_1d(c.den[0][0])
    expected = control.forced_response(control.tf(num, den, H), np.arange(errors.size) * H, errors).outputs
    mine = response(gains, errors)
    assert np.abs(mine - expected).max() <= 1e-9 * (1.0 + np.abs(mine).max())


def test_the_integrator_leaves_saturation_at_once() -> None:
    gains, limit, state, y = PidGains(2.0, 1.0, tracking_time_s=0.1), 1.0, PidState(), 0.0
    for _ in range(500):  # far below the setpoint: saturated
        v, state = pid_output(gains, state, 10.0, y, H)
        u = min(max(v, -limit), limit)
        state = pid_integrate(gains, state, 10.0, y, u - v, H)
    v, _ = pid_output(gains, state, -0.5, 0.0, H)
    assert v < limit  # the error changes its sign, and so does the direction, in the same sample
    assert abs(state.integral) < 25.0


def test_the_first_sample_makes_no_derivative_kick() -> None:
    u, _ = pid_output(PidGains(0.0, 0.0, 1.0, 0.1, c=1.0), PidState(), 5.0, 0.0, H)
    assert u == 0.0
