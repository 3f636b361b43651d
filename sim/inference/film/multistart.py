"""Global search for the outer parameters of a film model: many starts, the best refined, the record's memory chosen.

The starts are an even set over the envelopes' slopes and centres and D's shape, scaled to the record: a local search
from a single start often ends far from the best fit. Operator outputs do not depend on D, so that each start serves
every form of D at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference import memory
from sim.inference.evidence import price
from sim.inference.film.memoryless_forms import SMOOTH, Form
from sim.inference.film.rows import Path, Prepared, build_path
from sim.inference.film.variable_projection import Problem, Solution, Structure
from sim.model.operator_outputs import GROUP
from sim.model.record_own import FilmStart

STARTS: Final = 256  # over four to six parameters: about three values of each
REFINED: Final = 8  # of the starts, the best: a descent costs as much as a dozen of them
SHAPES: Final = 48  # of D, tried beside good envelopes
GAIN: Final = 0.03  # of the mean square that another memory brings: what the model lacks is no noise


def envelope_bounds(path: Path, groups: int) -> tuple[Array, Array]:
    """Return least and largest (log a_R, c_R, log a_L, c_L) of every group, from the record's temperatures."""
    low, high = float(np.min(path.inputs)), float(np.max(path.inputs))
    span = high - low
    least = np.array([math.log(0.5 / span), low - 0.5 * span] * 2)
    most = np.array([math.log(150.0 / span), high + 0.5 * span] * 2)
    return np.tile(least, groups), np.tile(most, groups)


def transition(path: Path) -> tuple[float, float]:
    """Return the middle and half-width (degC) of the central 80 % of the output's change per kelvin."""
    v = path.inputs[path.rows]
    edges = np.linspace(np.min(v), np.max(v), 61)
    density = slope_density(path, edges)
    total = np.cumsum(density)
    centres = 0.5 * (edges[1:] + edges[:-1])
    low, high = np.interp([0.1 * total[-1], 0.9 * total[-1]], total, centres)
    return 0.5 * float(low + high), max(0.5 * float(high - low), float(edges[1] - edges[0]))


def _coarse_steps(path: Path, step_K: float) -> tuple[Array, Array, Array]:
    """Return the temperature, its change and the output's between rows at least so much travel apart."""
    v, y = path.inputs[path.rows], path.output
    travel = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(v)))))
    coarse = np.flatnonzero(np.diff(np.floor(travel / step_K), prepend=-1.0) > 0)
    return 0.5 * (v[coarse][1:] + v[coarse][:-1]), np.diff(v[coarse]), np.diff(y[coarse])


def slope_density(path: Path, edges: Array, sense: float | None = None) -> Array:
    """Return the mean d output / dv >= 0 in each temperature bin, from rows at least half a bin's width apart.

    sense: 1 heating alone, -1 cooling alone, None both.
    """
    middle, dv, dy = _coarse_steps(path, 0.5 * float(edges[1] - edges[0]))
    if sense is not None:
        own = np.sign(dv) == sense
        middle, dv, dy = middle[own], dv[own], dy[own]
    size = edges.size - 1
    place = np.clip(np.searchsorted(edges, middle, side="right") - 1, 0, size - 1)
    moved = np.bincount(place, weights=np.abs(dv), minlength=size)
    changed = np.bincount(place, weights=np.maximum(np.sign(dv) * dy, 0.0), minlength=size)
    return np.asarray(changed / np.maximum(moved, 1e-9) + 1e-12, dtype=np.float64)


def even_points(count: int, dimensions: int, seed: int) -> Array:
    """Return points that fill the unit cube evenly, shape (count, dimensions): multiples of the powers of 1/x, x the
    root of x^(d+1) = x + 1, from a random origin (H. Niederreiter, Random Number Generation and Quasi-Monte Carlo
    Methods (SIAM 1992), ch. 3, on such lattices)."""
    root = 2.0
    for _ in range(40):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1.0)
    origin = np.random.default_rng(seed).random(dimensions)
    return np.asarray((origin + np.arange(count)[:, None] * steps) % 1.0, dtype=np.float64)


def starting_points(problem: Problem, count: int, seed: int) -> Array:
    """Return starts over the bounds, shape (count, parameters): slopes on a log scale, centres near the transition."""
    groups = problem.structure.groups
    middle, half = transition(problem.path)
    dimensions = problem.low.size
    unit = even_points(count, dimensions, seed)
    starts = problem.low + unit * (problem.high - problem.low)
    for group in range(groups):
        first = GROUP * group
        centre = middle + 3.0 * half * (unit[:, first + 1] - 0.5)
        apart = 6.0 * half * (unit[:, first + 3] - 0.5)
        steepness = math.log(1.0 / half) + 3.0 * (unit[:, first] - 0.6)
        starts[:, first] = steepness
        starts[:, first + 2] = steepness + 1.2 * (unit[:, first + 2] - 0.5)
        starts[:, first + 1] = centre + 0.5 * apart
        starts[:, first + 3] = centre - 0.5 * apart
    return np.clip(starts, problem.low, problem.high)


def search(
    path: Path,
    structure: Structure,
    forms: Sequence[Form],
    *,
    starts: int = STARTS,
    seed: int = 0,
    extra: Sequence[Array] = (),
) -> dict[Form, Solution]:
    """Return the best fit for each form of D; `extra`: envelope parameters (4 groups,) known to be good."""
    low, high = envelope_bounds(path, structure.groups)
    problems = {form: Problem(path, structure, form, low, high) for form in forms}
    largest = max(problems.values(), key=lambda problem: problem.low.size)
    points = starting_points(largest, starts, seed)
    split = largest.split
    found: dict[Form, list[Solution]] = {form: [] for form in problems}
    shapes = [*extra, *points[:, :split]]
    for number, shape in enumerate(shapes):
        row = points[number % points.shape[0]]
        operators, _ = largest.operators(np.append(shape, row[split:]))
        for form, problem in problems.items():
            theta = np.append(shape, _within(problem, row[split:]))
            found[form].append(problem.solve_columns(theta, operators))
    return {form: _refined(problems[form], solutions) for form, solutions in found.items()}


def _within(problem: Problem, drawn: Array) -> Array:
    """Return D's nonlinear parameters from a draw made for the form with the most of them."""
    count = problem.low.size - problem.split
    return np.clip(drawn[:count], problem.low[problem.split :], problem.high[problem.split :])


def _several(problem: Problem, solutions: list[Solution]) -> list[Solution]:
    """Return the best few local minima near the best of many solutions, best first."""
    best = sorted(solutions, key=lambda solution: solution.square)[:REFINED]
    near = sorted((problem.refine(solution, steps=8) for solution in best), key=lambda solution: solution.square)
    if problem.low.size > problem.split:  # D's own shape has local minima: try others beside good envelopes
        shapes = [solution.theta[: problem.split] for solution in near[:4]]
        near += [problem.refine(other, steps=8) for shape in shapes for other in _other_forms(problem, shape)]
        near.sort(key=lambda solution: solution.square)
    return near[:3]


def _refined(problem: Problem, solutions: list[Solution]) -> Solution:
    candidates = _several(problem, solutions)
    if problem.form.periodic and not problem.form.monotone:
        # a wave's frequency has a narrow minimum that shows only beside good envelopes, and these only beside a good
        # D: find them with any smooth D first
        form = Form(SMOOTH, False, problem.form.low_degC, problem.form.high_degC)
        any_d = Problem(
            problem.path, problem.structure, form, problem.low[: problem.split], problem.high[: problem.split]
        )
        found = _several(any_d, [any_d.solve(solution.theta[: problem.split]) for solution in solutions])
        others = [other for solution in found for other in _other_forms(problem, solution.theta)]
        candidates += [problem.refine(solution, steps=8) for solution in others]
        candidates = sorted(candidates, key=lambda solution: solution.square)[:3]
    return min((problem.refine(solution, steps=30) for solution in candidates), key=lambda solution: solution.square)


def _other_forms(problem: Problem, envelopes: Array) -> list[Solution]:
    """Return the two best of many shapes of D beside given envelopes, shape (4 groups,)."""
    low, high = problem.low[problem.split :], problem.high[problem.split :]
    shapes = low + even_points(SHAPES, low.size, 0) * (high - low)
    operators, _ = problem.operators(np.append(envelopes, shapes[0]))
    tried = [problem.solve_columns(np.append(envelopes, shape), operators) for shape in shapes]
    return sorted(tried, key=lambda other: other.square)[:2]


def remembered(
    records: Sequence[Prepared],
    chosen: Sequence[NDArray[np.bool_]],
    starts: Sequence[FilmStart],
    fit: Problem,
    theta: Array,
    likely: Callable[[FilmStart, Prepared, Callable[[FilmStart], float], float], FilmStart],
) -> list[FilmStart]:
    """Return the memories that are likely at theta, record by record. likely: the memory of a record, from the one that
    is known, its cost, and what another has to bring."""
    best, readings = list(starts), sum(int(np.sum(c & r.used)) for c, r in zip(chosen, records, strict=True))
    worth = max(price(1, readings), 0.5 * GAIN * readings)
    for number, record in enumerate(records):

        def cost(start: FilmStart, number: int = number) -> float:
            square = mean_square(records, chosen, [*best[:number], start, *best[number + 1 :]], fit, theta)
            return 0.5 * readings * math.log(max(square, 1e-300))

        best[number] = likely(best[number], record, cost, worth)
    return best


def begun(known: FilmStart, record: Prepared, cost: Callable[[FilmStart], float], worth: float) -> FilmStart:
    """Return the likeliest memory at the first row."""
    return memory.begun(known, float(record.inputs[0]), record.inputs, cost, worth)


def begun_closer(known: FilmStart, record: Prepared, cost: Callable[[FilmStart], float], worth: float) -> FilmStart:
    """Return the memory with its turning points before the first row at their best."""
    return memory.closer(known, cost)


def through_unseen(known: FilmStart, record: Prepared, cost: Callable[[FilmStart], float], worth: float) -> FilmStart:
    """Return the memory with what the film went through in the record's gaps."""
    gaps = [(float(record.time_s[row]), record.inputs[row - 1 : row + 1]) for row in record.longest_unseen]
    return memory.through_gaps(known, gaps, record.inputs, cost, worth)


def mean_square(
    records: Sequence[Prepared],
    chosen: Sequence[NDArray[np.bool_]],
    starts: Sequence[FilmStart],
    fit: Problem,
    theta: Array,
) -> float:
    """Return what the fit at theta leaves of the chosen rows with other memories: the mean square."""
    path = build_path(records, starts, chosen)
    return Problem(path, fit.structure, fit.form, *envelope_bounds(path, fit.structure.groups)).solve(theta).square
