"""model(inverse(u)) = u wherever it is declared reachable, and nothing reachable is declared unreachable; the plan that
keeps a course within reach; what `check_model` finds.

Each random model is asked for outputs it has reached, outputs between and beyond the extremes of both branches, and
outputs a hair inside and outside an extreme (double roots); a dense scan of both branches is the second opinion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compensator.hysteresis.film import Envelope, FilmModel, Memory, Memoryless
from compensator.inverse.check import check_model
from compensator.inverse.inverse import Inverse, branch_plan
from tests.compensator.film_models import Rng, any_model, damped_path, monotone_model, table_1, table_2

TENS = 60  # evaluations: what a search near an extremum, over many pieces, may take


@pytest.mark.parametrize("block", range(4))
def test_monotone_models_come_back_in_few_evaluations(block: int) -> None:
    rng = np.random.default_rng(block)
    most = 0
    for _ in range(250):
        model = monotone_model(rng)
        inverse = Inverse(model)
        inputs = damped_path(rng, 12)
        outputs, _ = model.simulate(inputs, model.initial_memory(float(inputs[0])))
        memory = inverse.first(float(outputs[0])).memory
        for target in outputs[1:]:
            solution = inverse.solve(float(target), memory)
            assert solution.reachable
            achieved, memory = model.step(solution.temperature_degC, memory)
            assert abs(achieved - target) <= 1e-9
            assert abs(solution.memory.plays - memory.plays).max() == 0.0
            most = max(most, solution.evaluations)
    assert most <= 20


@pytest.mark.parametrize("block", [*range(4), *(pytest.param(k, marks=pytest.mark.long) for k in range(4, 8))])
def test_any_model_comes_back_and_nothing_reachable_is_missed(block: int) -> None:
    rng = np.random.default_rng(1000 + block)
    for _ in range(150):
        model = any_model(rng)
        inverse = Inverse(model)
        memory = somewhere(model, rng)
        rising, falling, up, down = branches(model, memory)
        for target in targets_of(up, down, rng):
            check(inverse, memory, float(target), rising, falling, up, down)


def somewhere(model: FilmModel, rng: Rng) -> Memory:
    path = damped_path(rng, int(rng.integers(2, 20)))
    return model.simulate(path, model.initial_memory(float(path[0])))[1]


def branches(model: FilmModel, memory: Memory) -> tuple[np.ndarray, ...]:
    """Temperatures above and below the present one, out to the limits, and the outputs there."""
    rising = np.linspace(memory.input_degC, 200.0, 2000)[1:]
    falling = np.linspace(memory.input_degC, -50.0, 2000)[1:]
    return rising, falling, model.simulate(rising, memory)[0], model.simulate(falling, memory)[0]


def targets_of(up: np.ndarray, down: np.ndarray, rng: Rng) -> np.ndarray:
    extremes = np.array([up.max(), up.min(), down.max(), down.min()])
    span = extremes.max() - extremes.min() + 1e-9
    anywhere = rng.uniform(extremes.min() - 0.1 * span, extremes.max() + 0.1 * span, 3)
    hair = span * 10.0 ** rng.uniform(-10.0, -3.0)
    return np.concatenate(
        [anywhere, rng.choice(up, 1), rng.choice(extremes, 1) + hair * rng.choice([-1.0, 0.0, 1.0], 1)]
    )


def check(
    inverse: Inverse,
    memory: Memory,
    target: float,
    rising: np.ndarray,
    falling: np.ndarray,
    up: np.ndarray,
    down: np.ndarray,
) -> None:
    model, now = inverse.model, memory.input_degC
    solution = inverse.solve(target, memory)
    farthest = np.inf  # a change of temperature that is known to pass the target
    for temperatures, outputs in ((rising, up), (falling, down)):
        gap = outputs - target
        crossings = np.flatnonzero(gap[1:] * gap[:-1] <= 0.0)
        if crossings.size:  # and beyond, where the output is so flat that it is within the bound of the target
            passed = np.flatnonzero(np.abs(gap[crossings[0] + 1 :]) > inverse.bound)
            last = crossings[0] + 1 + passed[0] if passed.size else -1
            farthest = min(farthest, abs(float(temperatures[last]) - now))
    assert solution.evaluations <= TENS
    if solution.reachable:
        achieved, after = model.step(solution.temperature_degC, memory)
        assert abs(achieved - target) <= inverse.bound
        assert np.array_equal(after.plays, solution.memory.plays)
        assert abs(solution.temperature_degC - now) <= farthest + 1e-6
    else:
        assert farthest == np.inf
        ends = [end for interval in solution.intervals for end in interval]
        assert solution.nearest in ends
        assert not any(low < target < high for low, high in solution.intervals)
        slack = 1e-9 * (1.0 + abs(up).max() + abs(down).max())
        assert solution.intervals[0][0] <= min(up.min(), down.min()) + slack
        assert solution.intervals[-1][1] >= max(up.max(), down.max()) - slack


def test_the_bound_is_a_billionth_for_outputs_up_to_a_thousand() -> None:
    assert Inverse(table_2(generalized=False)).bound == 5e-10
    assert Inverse(table_1(generalized=False)).bound <= 1e-9


def test_all_solutions_and_the_choices_of_the_paper_s_non_monotone_model() -> None:
    model = table_1(generalized=False, weights=np.full(15, 3.0))
    memory = model.initial_memory(45.0, "heated")
    target = model.step(60.0, memory)[0]
    inverse = Inverse(model, 20.0, 80.0)
    found, _ = inverse.solutions(target, memory)
    assert found.size >= 3
    for v in found:
        assert abs(model.step(float(v), memory)[0] - target) <= inverse.bound
    above, below = found[found > 45.0].min(), found[found < 45.0].max()
    nearest = above if above - 45.0 < 45.0 - below else below
    assert inverse.solve(target, memory).temperature_degC == pytest.approx(nearest, abs=1e-6)
    assert inverse.solve(target, memory, heading=1).temperature_degC == pytest.approx(above, abs=1e-6)
    assert inverse.solve(target, memory, heading=-1).temperature_degC == pytest.approx(below, abs=1e-6)


def test_a_model_that_violates_the_order_condition_has_a_gap_and_says_so() -> None:
    model = FilmModel(np.array([0.05]), np.ones(1), Envelope("tanh", 0.2, -11.6), Envelope("tanh", 0.16, -10.3))
    memory = model.simulate(np.array([80.0, 62.0]), model.initial_memory(70.0))[1]
    inverse, here = Inverse(model), model.output_at(memory)
    jump = model.step(62.0 + 1e-9, memory)[0]
    assert jump > here + 0.1
    solution = inverse.solve(0.25 * jump + 0.75 * here, memory)
    assert not solution.reachable
    assert len(solution.intervals) == 2
    assert solution.nearest == pytest.approx(here, abs=1e-9)
    assert solution.intervals[1][0] == pytest.approx(jump, abs=1e-6)
    at_the_jump = inverse.solve(model.step(float(np.nextafter(62.0, 99.0)), memory)[0], memory)
    assert at_the_jump.reachable


@pytest.mark.parametrize("initial", ["cooled", "heated"])
def test_the_first_temperature_is_the_lowest_one(initial: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(60):
        model = any_model(rng)
        inverse = Inverse(model)
        grid = np.linspace(-50.0, 200.0, 300)
        outputs = np.array([model.output_at(model.initial_memory(float(v), initial)) for v in grid])  # type: ignore[arg-type]
        target = float(rng.choice(outputs))
        solution = inverse.first(target, initial)  # type: ignore[arg-type]
        assert solution.reachable
        assert abs(model.output_at(solution.memory) - target) <= inverse.bound
        gap = outputs - target
        passes = int(np.flatnonzero(gap[1:] * gap[:-1] <= 0.0)[0]) + 1
        clear = np.flatnonzero(np.abs(gap[passes:]) > inverse.bound)  # not so flat that it stays within the bound
        assert not clear.size or solution.temperature_degC <= grid[passes + clear[0]] + 1e-6


def test_a_trajectory_is_the_same_as_single_steps() -> None:
    rng = np.random.default_rng(9)
    for model in (table_2(generalized=False), any_model(rng), any_model(rng)):
        path = damped_path(rng, 60)
        memory = model.initial_memory(float(path[0]))
        targets, _ = model.simulate(path, memory)
        inverse = Inverse(model)
        together, end = inverse.trajectory(targets, memory)
        for target, v in zip(targets, together, strict=True):
            solution = inverse.solve(float(target), memory)
            expected = solution.temperature_degC if solution.reachable else np.nan
            assert v == pytest.approx(expected, abs=1e-7, nan_ok=True)
            memory = model.step(float(v), memory)[1]
        assert np.array_equal(end.plays, memory.plays)


def test_limits_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="low < high"):
        Inverse(table_2(generalized=True), 50.0, 50.0)


def test_flat_models_are_at_rest_or_unreachable() -> None:
    model = FilmModel(np.ones(2), np.zeros(2), Envelope("tanh", 0.2, -12.0), Envelope("tanh", 0.2, -12.0), Memoryless())
    inverse, memory = Inverse(model), model.initial_memory(30.0)
    assert inverse.solve(0.0, memory).temperature_degC == 30.0
    assert not inverse.solve(0.1, memory).reachable


FALLING_D = Memoryless("tanh", -1e-13, 0.5, -30.0, -4.0)  # so little that it shows in nothing
SATURATED = FilmModel(
    np.arange(0, 10) / 10.0,
    np.full(10, 0.1),
    Envelope("tanh", 0.6, -0.6 * 66.0),
    Envelope("tanh", 0.6, -0.6 * 60.0),
    Memoryless("none", offset=-4.0),
)


@pytest.mark.parametrize("model", [SATURATED, replace(SATURATED, memoryless=FALLING_D)])
@pytest.mark.parametrize("limits", [(-50.0, 200.0), (10.0, 95.0)])
def test_of_a_plateau_the_nearest_and_the_lowest_temperature(model: FilmModel, limits: tuple[float, float]) -> None:
    """Within the bound the output stands still from 84.4 degC on; of a film that was cooled down to 76.6 degC."""
    inverse = Inverse(model, *limits)
    memory = model.initial_memory(70.0, "heated")
    target = float(model.simulate([limits[1]], memory)[0][0])
    nearest, lowest = inverse.solve(target, memory), inverse.first(target, "cooled")
    assert 84.3 < nearest.temperature_degC < 85.1
    assert 76.4 < lowest.temperature_degC < 77.2
    assert max(abs(nearest.residual), abs(lowest.residual)) <= inverse.bound
    assert nearest.evaluations <= 20


@pytest.mark.parametrize("initial", ["cooled", "heated"])
def test_a_target_that_is_no_number_is_not_reachable(initial: str) -> None:
    inverse = Inverse(SATURATED)
    memory = SATURATED.initial_memory(60.0, "cooled")
    for solve in (lambda target: inverse.solve(target, memory), lambda target: inverse.first(target, initial)):  # type: ignore[arg-type]
        low, high = solve(-np.inf), solve(np.inf)
        assert not any(solution.reachable for solution in (solve(np.nan), low, high))
        assert low.interval is not None
        assert (low.nearest, high.nearest) == low.interval


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


@pytest.mark.parametrize(
    ("model", "radius", "violating"),
    [
        (table_2(generalized=False), 0.517, 15),
        (table_1(generalized=False), 0.179, 3),
        (table_2(generalized=True), 0.109, 3),
    ],
)
def test_the_smallest_allowed_radii_of_the_paper_s_tables(model: FilmModel, radius: float, violating: int) -> None:
    order = next(f for f in check_model(model, 20.0, 100.0) if f.kind == "order")
    assert len(order.operators) == violating
    assert order.advice.startswith(f"use radii from {radius:.3f} on")


@pytest.mark.parametrize(("off", "fine"), [(1e-4, True), (-1e-4, False)])
def test_the_smallest_allowed_radius_keeps_the_order_and_no_smaller_one_does(off: float, fine: bool) -> None:
    model = table_2(generalized=False)
    least = float((model.radii - 0.5 * model.order_margin(20.0, 100.0))[0])
    single = FilmModel(np.array([least + off]), np.ones(1), model.rising, model.falling)
    assert all(f.kind != "order" for f in check_model(single, 20.0, 100.0)) == fine
    memory = single.simulate(np.array([99.0, 61.428]), single.initial_memory(20.0, "heated"))[1]
    jump = single.step(61.428 + 1e-9, memory)[0] - single.output_at(memory)
    assert (jump < 1e-6) == fine


def test_table_1_is_not_monotone() -> None:
    assert "not_monotone" in [f.kind for f in check_model(table_1(generalized=False), 20.0, 80.0)]


def test_a_flat_interval_is_where_nothing_moves() -> None:
    envelope = Envelope("tanh", 0.2, -12.0), Envelope("tanh", 0.2, -11.6)
    model = FilmModel(np.array([0.1, 0.2]), np.ones(2), *envelope, Memoryless("none"))
    still = next(f for f in check_model(model, 40.0, 80.0) if f.kind == "stands_still")
    assert still.where_degC is not None
    assert "D(T)" not in still.what  # this film has none, and whoever reads of it looks for it in vain
    low, high = still.where_degC
    memory = model.simulate(np.array([high]), model.initial_memory(40.0, "heated"))[1]
    inside = model.simulate(np.linspace(high, low + 1e-6, 20), memory)[0]
    assert np.ptp(inside) <= 1e-12


def test_a_sound_model_has_no_findings() -> None:
    envelope = Envelope("tanh", 0.2, -12.0)
    model = FilmModel(np.array([0.0, 0.1]), np.ones(2), envelope, envelope, Memoryless("none"))
    assert check_model(model, 50.0, 70.0) == ()
