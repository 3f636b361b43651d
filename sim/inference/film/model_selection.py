"""Which model to take: candidates fitted on some rows and judged on rows that were held out.

Rows are held out in short interleaved blocks, so that each stretch of a sweep is covered by the fit and by the
judgement. The simplest form of D within `WORTH` of the best held-out error is taken; operators with mixed envelopes
have to gain more, since they are many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.mixed_envelopes import (
    RESOLUTIONS,
    MixedSolution,
    dictionary,
    half_loop_width,
    solve_mixed,
)
from sim.inference.film.multistart import envelope_bounds
from sim.inference.film.rows import Path, Prepared, Start, build_path, held_out_blocks, thinned
from sim.inference.film.variable_projection import Problem, Solution, Structure, denser, merged
from sim.inference.readings.outliers import lone_outliers

WORTH: Final = 0.98  # a less simple form has to bring the held-out error below this share
NEAR: Final = 1.3  # times the best held-out error of the coarse fits: forms that are compared again
MIXED_WORTH: Final = 0.9
FEWER_WORTH: Final = 0.93  # among dictionaries: of more operators
GLOBAL_ROWS: Final = 700


@dataclass(frozen=True)
class Candidate:
    """One model that was tried: errors in the output's unit, on the rows fitted and on the rows held out."""

    kind: str
    form: str
    operators: int
    rmse: float
    held_out_rmse: float


@dataclass(frozen=True, eq=False)
class Rows:
    """Records with their rows shared out: `thin` for the global search, `train` for fits, `held` to judge by."""

    records: list[Prepared]
    thin: list[NDArray[np.bool_]]
    train: list[NDArray[np.bool_]]
    held: list[NDArray[np.bool_]]

    def thinner(self, most: int) -> list[NDArray[np.bool_]]:
        """At most about `most` of the rows to be fitted, shared among the records."""
        share = max(most // len(self.records), 60)
        return [thinned(record, rows, share) for record, rows in zip(self.records, self.train, strict=True)]


def share_out(records: Sequence[Prepared]) -> Rows:
    """The rows of the records, a third of them held out."""
    held = [held_out_blocks(record) for record in records]
    train = [record.used & ~out for record, out in zip(records, held, strict=True)]
    rows = Rows(list(records), train, train, held)
    return replace(rows, thin=rows.thinner(GLOBAL_ROWS))


def make_problem(path: Path, structure: Structure, form: Form) -> Problem:
    """With the usual bounds of the envelopes."""
    return Problem(path, structure, form, *envelope_bounds(path, structure.groups))


def predict(problem: Problem, solution: Solution, path: Path) -> Array:
    """The fit at another path's readings, shape (readings,)."""
    other = make_problem(path, problem.structure, problem.form)
    operators, _ = other.operators(solution.theta)
    memoryless = problem.form.columns(other.v, solution.theta[problem.split :]) @ solution.coefficients
    return np.asarray(solution.offset + memoryless + operators @ solution.weights, dtype=np.float64)


def rms(values: Array) -> float:
    """Root of the mean square."""
    return math.sqrt(float(np.mean(values**2)))


def choose_form(
    rows: Rows,
    starts: Sequence[Start],
    forms: Sequence[Form],
    found: dict[str, Solution],
    structure: Structure,
    kind: str,
) -> tuple[Form, Solution, list[Candidate]]:
    """The simplest form of D (in the given order) whose held-out error is near the best, and all candidates.

    Forms whose fit on few rows and a coarse radius grid comes near the best are compared again by final fits.
    """
    thin, train = build_path(rows.records, starts, rows.thin), build_path(rows.records, starts, rows.train)
    held = build_path(rows.records, starts, rows.held)
    errors, rmse, sizes, final = {}, {}, {}, dict(found)
    for form in forms:
        solution = found[form.name]
        errors[form.name] = rms(held.output - predict(make_problem(thin, structure, form), solution, held))
        rmse[form.name], sizes[form.name] = math.sqrt(solution.square), structure.group.size
    best = min(errors.values())
    near = [form for form in forms if errors[form.name] < NEAR * best]
    if len(near) > 1:
        for form in near:
            problem, solution = refine_plain(train, structure, form, found[form.name].theta)
            errors[form.name] = rms(held.output - predict(problem, solution, held))
            rmse[form.name], sizes[form.name] = math.sqrt(solution.square), int(np.sum(solution.weights > 0.0))
            final[form.name] = make_problem(thin, structure, form).solve(solution.theta)
    chosen, least = near[0], math.inf
    for form in near:
        if errors[form.name] < WORTH * least:
            chosen, least = form, errors[form.name]
    candidates = [Candidate(kind, form.name, sizes[form.name], rmse[form.name], errors[form.name]) for form in forms]
    return chosen, final[chosen.name], candidates


def without_strays(rows: Rows, starts: Sequence[Start], problem: Problem, solution: Solution) -> Rows:
    """The rows without those readings that stand alone among their residuals; the same rows if there are none.

    The residuals are those of a fit to all rows, held-out ones too: of a sparse loop a row that no fit has seen may be
    the only one in its flank.
    """
    path = build_path(rows.records, starts)
    _, whole = refine_plain(path, problem.structure, problem.form, solution.theta)
    residual = whole.residual
    cleaned, changed = [], False
    for number, record in enumerate(rows.records):
        mine = path.record == number
        strays = path.sample[mine][lone_outliers(residual[mine], np.ones(int(np.sum(mine)), dtype=np.bool_))]
        if strays.size:
            changed = True
            used = record.used.copy()
            used[strays] = False
            there = strays if record.origin is None else record.origin[strays]
            record = replace(record, used=used, outliers=np.sort(np.append(record.outliers, there)))
        cleaned.append(record)
    return share_out(cleaned) if changed else rows


def choose_mixed(
    rows: Rows, starts: Sequence[Start], form: Form, shape: Array, to_beat: float, most: int | None
) -> tuple[MixedSolution | None, list[Candidate]]:
    """The best dictionary by held-out rows, few operators preferred; None if none of up to `most` beats `to_beat`."""
    path = build_path(rows.records, starts, rows.thinner(2 * GLOBAL_ROWS))
    held = build_path(rows.records, starts, rows.held)
    half_width = half_loop_width(path)
    best: MixedSolution | None = None
    least = to_beat
    candidates = []
    for resolution in RESOLUTIONS:
        trial = solve_mixed(path, dictionary(path, *resolution, half_width), form, shape)
        error = rms(held.output - trial.at(held))
        candidates.append(Candidate("mixed_envelopes", form.name, trial.weights.size, math.sqrt(trial.square), error))
        if most is not None and trial.weights.size > most:
            continue
        more = best is not None and trial.weights.size > best.weights.size
        if error < (FEWER_WORTH if more else 1.0) * least:
            best, least = trial, error
    return best, candidates


def refine_plain(path: Path, structure: Structure, form: Form, theta: Array) -> tuple[Problem, Solution]:
    """The final fit: on a radius grid four times as dense, then with no more operators than `structure` has."""
    fine = denser(structure)
    problem = make_problem(path, fine, form)
    solution = problem.refine(problem.solve(theta), steps=8)
    problem = make_problem(path, merged(fine, solution.weights, structure.group.size), form)
    return problem, problem.refine(problem.solve(solution.theta), steps=4)
