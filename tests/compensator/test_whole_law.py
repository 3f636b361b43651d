"""The margins of the designed loops and of the law that runs: against the law run step by step, and by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from compensator.control.estimator import UNSTEADY_K_PER_S2, VARIANCE, constant_error
from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs, LawState
from compensator.control.margins import (
    NOISES_K,
    RATIOS,
    Point,
    Timing,
    bearable_ms,
    believed,
    critical_gain,
    critical_ratio,
    loop_margins_at,
    operating_points,
    plate_plant,
    regulated_plant,
    share_within,
    worst_ms,
)
from compensator.control.pid import (
    OwnPid,
    PidGains,
    design_own_pid,
    design_pi,
    design_temperature,
    loop_margins,
    maximum_sensitivity,
    pi_integrated,
    pi_output,
    sampled_loop,
)
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PLATE = PlateModel(1.7e-3, 0.067, 0.017, 25.0)
TIMING = Timing(0.1, 0.036, 0.017)
NOISE_K, FIRST_DEGC, DEC_PER_S = 0.01, 58.0, 0.01
GENTLY = 100


def law_of(most_share: float = 0.5, timing: Timing = TIMING, name: str = "full") -> Law:
    h = timing.period_s
    gains = design_temperature(h, h, 1.4).gains
    settings = LawSettings(name, h, 4.0, 10.0, 95.0, gains, 8, 0.5, most_share=most_share)  # type: ignore[arg-type]
    return Law(settings, PLATE, FILM)


def heating(law: Law, timing: Timing = TIMING, level: float = 0.45) -> Point:
    return operating_points(law, timing, NOISE_K, levels=(level,))[0]


def course(law: Law, ratio: float, gain: float, ticks: int, push_K: float) -> Array:
    """The law on the nonlinear plate and film, on a ramp: its temperature at each reading. The estimator's gains are
    held, as in the linear loop; over the first GENTLY ticks, so that the film never turns, the film becomes steeper by
    a ratio, and the plate answers a change of the current by a gain."""
    memory = FILM.step(FIRST_DEGC, FILM.initial_memory(10.0, "heated"))[1]
    first, memory = FILM.step(FIRST_DEGC, memory)
    state: LawState = law.start(FIRST_DEGC, memory, PLATE.current_for_rate_A(FIRST_DEGC, 0.0, 4.0))
    known = believed(law, NOISE_K, state)
    t, h = TIMING, TIMING.period_s
    degC, current, film, ahead = FIRST_DEGC, state.current_A, memory, law.preview_times_s()
    hold, output, found, before = state.current_A, first, np.empty(ticks), first
    for k in range(ticks):
        degC += push_K if k == GENTLY else 0.0
        so_far = min(k / GENTLY, 1.0)
        wanted = first + DEC_PER_S * (k * h + t.acts_after_s + ahead)
        inputs = Inputs(degC, output, first + DEC_PER_S * k * h, wanted, t.output_age_s, t.acts_after_s)
        held = state.estimate.drift_K_per_s
        errors = constant_error(state.disturbance, float(known.errors[0, VARIANCE]))
        estimate = known.estimate._replace(drift_K_per_s=held)
        state = state._replace(estimate=estimate, errors=errors, heats=known.heats)
        command, state = law.step(state, inputs)
        found[k] = degC
        sent = hold + (1.0 + so_far * (gain - 1.0)) * (command.current_A - hold)
        degC = PLATE.step(degC, current, t.acts_after_s)
        aged = PLATE.step(degC, sent, h - t.acts_after_s - t.output_age_s)
        degC, current = PLATE.step(aged, sent, t.output_age_s), sent
        shown, film = FILM.step(aged, film)
        output += (1.0 + so_far * (ratio - 1.0)) * (shown - before)
        before = shown
        film = FILM.step(degC, film)[1]
    return found


def grows(law: Law, ratio: float, gain: float) -> bool:
    """Whether what a tiny push makes is larger after 8 s than after 4 s, when the slow modes have died down."""
    off = np.abs(course(law, ratio, gain, GENTLY + 80, 1e-7) - course(law, ratio, gain, GENTLY + 80, 0.0))
    return bool(np.max(off[-20:]) > np.max(off[-60:-40]))


def edge(rings: Callable[[float], bool], low: float, high: float) -> float:
    """Where it begins to ring on, to 1 %."""
    assert not rings(low)
    assert rings(high)
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if rings(middle) else (middle, high)
    return math.sqrt(low * high)


@pytest.mark.parametrize("share", [0.5, 0.8])
def test_the_running_law_rings_on_at_the_computed_slope_ratio(share: float) -> None:
    law = law_of(share)
    computed = critical_ratio(heating(law))
    assert edge(lambda ratio: grows(law, ratio, 1.0), 0.85 * computed, 1.12 * computed) == pytest.approx(
        computed, rel=0.05
    )


def test_the_running_law_rings_on_at_the_computed_gain_of_the_plate() -> None:
    law = law_of(0.5)
    computed = critical_gain(heating(law), 1.5)
    assert loop_margins_at(heating(law), 1.5).gain_margin == pytest.approx(computed, rel=0.01)
    assert edge(lambda gain: grows(law, 1.5, gain), 0.85 * computed, 1.12 * computed) == pytest.approx(
        computed, rel=0.05
    )


def test_the_share_of_a_reading_is_the_largest_within_the_margins() -> None:
    law = law_of(1.0)
    share = share_within(law, TIMING)
    assert 0.2 < share < 0.6

    def holds(share: float) -> bool:
        tried = Law(replace(law.settings, most_share=share), PLATE, FILM)
        points = [p for noise in NOISES_K for p in operating_points(tried, TIMING, noise, levels=(0.5,))[:2]]
        return all(worst_ms(points, ratio) <= bearable_ms(ratio) + 0.005 for ratio in RATIOS)

    assert holds(share)
    assert not holds(share + 0.05)
    assert not holds(1.0)


def test_a_film_at_rest_is_held_by_the_temperature_alone() -> None:
    """The resistance is not fed back while the film stands: its slope changes nothing."""
    for noise in NOISES_K:
        point = operating_points(law_of(0.4), TIMING, noise)[-1]
        assert point.way == "at rest"
        assert worst_ms([point], 2.2) == pytest.approx(worst_ms([point], 0.6), rel=1e-6)
        assert critical_gain(point) > 1.1


def test_a_steadier_plate_takes_nothing_from_the_margins() -> None:
    """Margins are those of the largest size of unknown heat; the smallest has the gains of a noisier thermometer."""
    steadier = NOISE_K * UNSTEADY_K_PER_S2[-1] / UNSTEADY_K_PER_S2[0]
    law = law_of(0.3)
    for noise in (NOISE_K, steadier):
        points = operating_points(law, TIMING, noise, levels=(0.5,))[:2]
        assert all(worst_ms(points, ratio) <= bearable_ms(ratio) for ratio in RATIOS)


def test_delay_that_nobody_tells_costs_margin() -> None:
    told, late = TIMING, replace(TIMING, late_s=0.1)
    assert worst_ms([heating(law_of(), late)], 1.0) > 1.3 * worst_ms([heating(law_of(), told)], 1.0)


def test_the_plate_is_its_own_exact_step() -> None:
    plant = plate_plant(PLATE, 60.0, 0.7, 0.1, TIMING)
    small, x = 1e-5, np.zeros((3, 1))
    degC = [60.0, 60.0]
    for current in (0.7, 0.7 + small, 0.7 + small, 0.7 - small):
        x = plant.a @ x + plant.b * (current - 0.7)
        degC = [PLATE.step(value, amount, 0.1) for value, amount in zip(degC, (0.7, current), strict=True)]
    at_once = plate_plant(PLATE, 60.0, 0.7, 0.1, Timing(0.1))
    y = np.zeros((3, 1))
    for current in (0.7, 0.7 + small, 0.7 + small, 0.7 - small):
        y = at_once.a @ y + at_once.b * (current - 0.7)
    rest = PLATE.rate_K_per_s(60.0, 0.7)  # no operating point of rest: the gain changes on the way
    assert (at_once.c @ y)[0, 0] == pytest.approx(degC[1] - degC[0], rel=0.01 + abs(rest) * 0.01)
    assert (plant.c @ x)[0, 0] != pytest.approx((at_once.c @ y)[0, 0], rel=1e-3)
    later = plate_plant(PLATE, 60.0, 0.7, 0.1, replace(TIMING, late_s=0.2))
    z = np.exp(1j * np.array([0.3, 3.0]) * 0.1)
    np.testing.assert_allclose(later.response(z), plant.response(z) * (z**-2)[:, None], rtol=1e-9)


def test_the_controllers_own_pid_follows_its_setpoint_and_keeps_ms() -> None:
    pid, design = design_own_pid(0.66, 0.015, 0.1, 0.1, 1.4, 0.01, 4.0)
    assert design.margins.ms <= 1.4 + 1e-9
    plant = regulated_plant(PLATE, 60.0, 0.7, 0.1, pid, TIMING)
    whole = plant.response(np.array([1.0 + 1e-9]))
    np.testing.assert_allclose(np.real(whole), [[1.0, 0.1]], rtol=1e-3)
    noisy, _ = design_own_pid(0.66, 0.015, 0.1, 0.1, 1.4, 1.0, 4.0)
    assert noisy.kp_A_per_K <= 0.05 * 4.0 / 1.0 * 1.02
    slow = regulated_plant(PLATE, 60.0, 0.7, 0.1, OwnPid(0.4, 30.0), TIMING)
    z = np.exp(1j * np.array([1.0]) * 0.1)
    assert abs(slow.response(z)[0, 0]) < 0.5 < abs(plant.response(z)[0, 0])


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
