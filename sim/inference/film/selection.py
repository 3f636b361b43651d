"""Which film model a record is worth: each candidate is fitted without some rows, and judged by its error on these.

Rows are held out in short interleaved blocks, so that each stretch of a sweep is covered by the fit and by the
judgement. Candidates come in the order of their freedom: forms of D, then Preisach densities from few thresholds to
many. A candidate with more freedom has to lower the error by `WORTH`. A likelihood would not do here: no film is
exactly a sum of so many operators, and what the model lacks is no noise that a likelihood knows.
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
from sim.inference.film.multistart import envelope_bounds
from sim.inference.film.relay_plane import THRESHOLDS, PlaneFit, fit_plane, fit_plane_judged, relays_over
from sim.inference.film.rows import Path, Prepared, build_path, held_out_blocks, thinned
from sim.inference.film.variable_projection import PlainFit, Problem, Structure, denser, merged
from sim.inference.noise import Readings, estimate
from sim.inference.readings.outliers import lone_outliers
from sim.model.record_own import FilmStart

GLOBAL_ROWS: Final = 700  # of a global search: enough for its five to seven numbers
PLANE_ROWS: Final = 8000  # of a Preisach density: some ten readings a relay
WORTH: Final = 0.98  # of the held-out error, below which a candidate with more freedom has to come
LEAST_NOISE: Final = 1e-6  # of the output's span: a film simulated without noise


@dataclass(frozen=True)
class Candidate:
    """One model that was tried: errors in the output's unit, on the rows fitted and on the rows held out."""

    kind: str
    form: str
    operators: int
    rmse: float
    held_out_rmse: float


FilmOfRecords = PlainFit | PlaneFit


@dataclass(frozen=True, eq=False)
class Rows:
    """Records with their rows shared out: `thin` for the global search, `train` to be fitted without those `held` out,
    to judge by."""

    records: list[Prepared]
    thin: list[NDArray[np.bool_]]
    train: list[NDArray[np.bool_]]
    held: list[NDArray[np.bool_]]

    def thinner(self, most: int, of: Sequence[NDArray[np.bool_]] | None = None) -> list[NDArray[np.bool_]]:
        """Return at most about `most` of some rows, default all, shared among the records."""
        share = max(most // len(self.records), 60)
        chosen = of if of is not None else [record.used for record in self.records]
        return [thinned(record, part, share) for record, part in zip(self.records, chosen, strict=True)]


def share_out(records: Sequence[Prepared]) -> Rows:
    """Return the rows of the records, a third of them held out."""
    held = [held_out_blocks(record) for record in records]
    rows = Rows(list(records), held, [record.used & ~out for record, out in zip(records, held, strict=True)], held)
    return replace(rows, thin=rows.thinner(GLOBAL_ROWS))


def make_problem(path: Path, structure: Structure, form: Form) -> Problem:
    """Return the problem with the usual bounds of the envelopes."""
    return Problem(path, structure, form, *envelope_bounds(path, structure.groups))


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return math.sqrt(float(np.mean(values**2)))


def readings_of(path: Path, records: Sequence[Prepared]) -> Readings:
    """Return when the path's readings were taken."""
    time = [record.time_s[path.sample[path.record == k]] for k, record in enumerate(records)]
    return Readings.at(np.concatenate(time), np.diff(path.record, prepend=-1) != 0)


@dataclass(frozen=True, eq=False)
class Choice:
    """A film fitted to all rows, a PI film without the held-out ones, the error of the same kind on these, and all that
    was tried."""

    fit: FilmOfRecords
    trained: PlainFit
    held_out_rmse: float
    candidates: list[Candidate]


def choose_form(
    rows: Rows,
    starts: Sequence[FilmStart],
    structure: Structure,
    forms: Sequence[Form],
    theta: dict[Form, Array],
    kind: str,
) -> Choice:
    """Return the best film with one pair of envelopes. theta: of each form of D, from the global search."""
    train, held = build_path(rows.records, starts, rows.train), build_path(rows.records, starts, rows.held)
    candidates, best, least = [], None, math.inf
    for form in forms:
        plain = refine_plain(train, structure, form, theta[form])
        error = rms(held.output - plain.at(held))
        candidates.append(Candidate(kind, form.name, plain.operators, rms(train.output - plain.at(train)), error))
        if error < WORTH * least:
            best, least = plain, error
    assert best is not None
    whole = refine_plain(build_path(rows.records, starts), structure, best.form, best.solution.theta)
    return Choice(whole, best, least, candidates)


def choose_plane(rows: Rows, starts: Sequence[FilmStart], film: Choice, needed: bool) -> Choice:
    """Return the best Preisach density where it predicts better than a film with one pair of envelopes, or is needed;
    else that film. No film predicts to within less than the white noise."""
    every, held = build_path(rows.records, starts), build_path(rows.records, starts, rows.held)
    residual = every.output - film.fit.at(every)
    noise = estimate(residual, readings_of(every, rows.records), LEAST_NOISE * float(np.ptp(every.output)))
    if noise.white > WORTH * rms(residual) and not needed:
        return film
    thin = build_path(rows.records, starts, rows.thinner(PLANE_ROWS, rows.train))
    candidates, best, least = list(film.candidates), None, math.inf if needed else film.held_out_rmse
    assert isinstance(film.fit, PlainFit)
    form = film.fit.form
    for thresholds in THRESHOLDS:
        plane, error = fit_plane_judged(thin, held, relays_over(every, thresholds), film.trained)
        fitted = rms(thin.output - plane.at(thin))
        candidates.append(Candidate("mixed_envelopes", form.name, plane.operators, fitted, error))
        if error < WORTH * least:
            best, least = plane, error
    if best is None:
        return replace(film, candidates=candidates)
    thin = build_path(rows.records, starts, rows.thinner(PLANE_ROWS))
    return replace(
        film, fit=fit_plane(thin, best.plane, film.fit, best.width), held_out_rmse=least, candidates=candidates
    )


def refine_plain(path: Path, structure: Structure, form: Form, theta: Array) -> PlainFit:
    """Return the final fit: on a radius grid four times as dense, then with no more operators than `structure` has."""
    fine = denser(structure)
    problem = make_problem(path, fine, form)
    solution = problem.refine(problem.solve(theta), steps=8)
    problem = make_problem(path, merged(fine, solution.weights, structure.group.size), form)
    return PlainFit(problem, problem.refine(problem.solve(solution.theta), steps=4))


def without_strays(rows: Rows, starts: Sequence[FilmStart], fit: FilmOfRecords) -> Rows:
    """Return the rows without those readings that stand alone among the residuals of a fit to all of them; the same
    rows if there are none."""
    path = build_path(rows.records, starts)
    residual = path.output - fit.at(path)
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
