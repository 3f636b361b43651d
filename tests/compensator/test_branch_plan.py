"""Of several temperatures the one that keeps the rest of a course within reach, on a film whose D falls in places."""

from __future__ import annotations

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memoryless
from compensator.inverse.inverse import Inverse, branch_plan

RADII = np.arange(3, 15) / 15.0
FILM = FilmModel(  # the paper's table 1, with weights of our own: D falls from 46 to 65 degC
    RADII,
    400.0 * np.exp(-RADII / 0.4),
    Envelope("tanh", 0.14, -7.19),
    Envelope("tanh", 0.18, -9.61),
    Memoryless("sin", 40.1, 0.17, 0.0, 923.91),
    output="curvature_per_m",
)
MONOTONE = FilmModel(RADII, np.full(12, 0.1), Envelope("tanh", 0.14, -7.19), Envelope("tanh", 0.18, -9.61))
RATE_K_PER_S = 0.8


def test_the_nearest_leads_nowhere_and_the_plan_does_not() -> None:
    """Cooled to 55 degC within 58: a little less output is had a little lower, on the branch, or a K higher, where no
    operator moves and D falls. Only from the second does more output lie within reach again."""
    inverse, memory = Inverse(FILM, 20.0, 58.0), FILM.initial_memory(85.0, "cooled")
    memory = FILM.step(55.0, memory)[1]
    here = FILM.output_at(memory)
    times, targets = np.array([0.0, 5.0, 10.0]), np.array([here, here - 5.0, here - 0.5])
    nearest, _ = inverse.trajectory(targets, memory)
    assert nearest[1] == pytest.approx(55.0, abs=0.2)
    assert np.isnan(nearest[2])
    plan = branch_plan(inverse, times, targets, memory, RATE_K_PER_S, RATE_K_PER_S)
    assert plan.temperatures_degC.size == 3
    assert 55.5 < plan.temperatures_degC[1] < 56.5
    outputs, after = FILM.simulate(plan.temperatures_degC, memory)
    np.testing.assert_allclose(outputs, targets, atol=1e-6)
    np.testing.assert_array_equal(after.plays, plan.memory.plays)


def random_course(seed: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    levels = np.random.default_rng(seed).uniform(low, high, 5)
    corners = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(levels)) / (0.01 * (high - low)) + 5.0)))
    times = np.linspace(0.0, corners[-1], 200)
    return times, np.interp(times, corners, levels)


@pytest.mark.parametrize("seed", range(4))
def test_the_plate_is_no_later_on_the_plan_than_on_the_nearest(seed: int) -> None:
    inverse, memory = Inverse(FILM, 10.0, 95.0), FILM.initial_memory(85.0, "cooled")
    times, targets = random_course(seed, 250.0, 1450.0)
    plan = branch_plan(inverse, times, targets, memory, RATE_K_PER_S, RATE_K_PER_S)
    np.testing.assert_allclose(FILM.simulate(plan.temperatures_degC, memory)[0], targets, atol=1e-6)

    def late(degC: np.ndarray) -> float:
        return float(np.sum(np.maximum(np.abs(np.diff(degC)) / RATE_K_PER_S - np.diff(times), 0.0)))

    nearest, _ = inverse.trajectory(targets, memory)
    assert plan.late_s == pytest.approx(late(plan.temperatures_degC), abs=1e-9)
    assert plan.late_s <= late(nearest) + 1e-9
    assert late(nearest) > 0.0


def test_where_the_film_is_monotone_the_plan_is_the_inverse() -> None:
    inverse, memory = Inverse(MONOTONE, 10.0, 95.0), MONOTONE.initial_memory(85.0, "cooled")
    times, targets = random_course(3, -0.6, 0.6)
    plan = branch_plan(inverse, times, targets, memory, RATE_K_PER_S, RATE_K_PER_S)
    np.testing.assert_allclose(plan.temperatures_degC, inverse.trajectory(targets, memory)[0], atol=1e-6)


def test_a_plan_ends_before_what_no_course_reaches() -> None:
    inverse, memory = Inverse(FILM, 10.0, 95.0), FILM.initial_memory(85.0, "cooled")
    plan = branch_plan(inverse, np.arange(3.0), np.array([1200.0, 1000.0, 9000.0]), memory, 1.0, 1.0)
    assert plan.temperatures_degC.size == 2
    assert branch_plan(inverse, np.arange(1.0), np.array([9e3]), memory, 1.0, 1.0).temperatures_degC.size == 0
