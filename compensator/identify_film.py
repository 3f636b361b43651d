"""Identification of a film: the extended generalized Prandtl-Ishlinskii model from temperature and output.

    u(t) = D(v(t)) + sum_j p_j F_rj^gamma[v](t),   p_j >= 0            paper eq (9)

The way: check the records and find the path behind the noisy temperature (`identify_rows`, `temperature_path`);
search globally on thinned rows for each form of D (`identify_search`); choose the form, and whether operators with
mixed envelopes are worth it (`identify_mixed`), by rows that were held out; refine the winner on all rows; say how
sure it is (`identify_errors`) and what the record cannot fix (`identify_notes`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.film import Envelope, FilmModel, Initial, Memory
from compensator.functions import Array
from compensator.identify_forms import FORMS, Form
from compensator.identify_mixed import RESOLUTIONS, MixedSolution, dictionary, half_loop_width, solve_mixed
from compensator.identify_notes import film_notes
from compensator.identify_projection import Problem, Solution, Structure, equal_structure
from compensator.identify_rows import (
    FilmRecord,
    Path,
    Prepared,
    Start,
    build_path,
    held_out_blocks,
    prepare,
    thinned,
)
from compensator.identify_search import choose_starts, envelope_bounds, search, start_candidates

AUTOMATIC: Final = ("none", "linear", "arrhenius", "tanh", "polynomial")  # simplest first
WORTH: Final = 0.98  # a less simple form has to bring the held-out error below this share
MIXED_WORTH: Final = 0.9
GLOBAL_ROWS: Final = 700
Kind = Literal["extended_generalized_pi", "generalized_pi", "mixed_envelopes"]


@dataclass(frozen=True)
class Candidate:
    """One model that was tried: errors in the output's unit, on the rows fitted and on the rows held out."""

    kind: str
    form: str
    operators: int
    rmse: float
    held_out_rmse: float


@dataclass(frozen=True, eq=False)
class FilmFit:
    """The identified film.

    model; starts and memories: what each record's film remembered at its first row; rmse, max_abs: over all trusted
    readings; held_out_rmse: of the same kind of model fitted without the held-out rows; candidates: what was tried;
    active_operators: those with weight > 0; temperature_noise_K: of each record's thermometer; outliers: indices of
    readings left out, of each record; identifiability: in plain words what these records cannot fix.
    """

    model: FilmModel
    starts: tuple[Start, ...]
    memories: tuple[Memory, ...]
    rmse: float
    max_abs: float
    held_out_rmse: float
    candidates: tuple[Candidate, ...]
    active_operators: int
    temperature_noise_K: tuple[float, ...]
    outliers: tuple[NDArray[np.int64], ...]
    identifiability: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Split:
    """The rows of all records: fitted in the global stage, fitted in full, and held out."""

    records: list[Prepared]
    thin: list[NDArray[np.bool_]]
    train: list[NDArray[np.bool_]]
    held: list[NDArray[np.bool_]]


def identify_film(
    time_s: ArrayLike,
    temperature_degC: ArrayLike,
    output: ArrayLike,
    *,
    kind: Kind | None = None,
    form: str | None = None,
    operators: int = 30,
    initial: Initial | Literal["fitted"] = "fitted",
    monotone: bool = True,
    ordered: bool = True,
    temperature_noise_K: float | None = None,
    output_name: str = "minus_log10_ohm",
    seed: int = 0,
) -> FilmFit:
    """The film model of one record. Arrays of shape (samples,): s, degC, and the output, nan where there is none.

    kind: None chooses between "extended_generalized_pi" and "mixed_envelopes" by held-out rows; "generalized_pi" has
    no D. form: of D, None chooses among none, linear, arrhenius, tanh, polynomial. operators: number of radii.
    initial: the memory before the first row. monotone: D increases with v. ordered: every radius keeps the order
    condition below paper eq (6). temperature_noise_K: None estimates it, 0 takes the temperature as it is.
    Raises ValueError with one line for a record that cannot be used.
    """
    record = FilmRecord(time_s, temperature_degC, output)
    return identify_film_records(
        [record],
        kind=kind,
        form=form,
        operators=operators,
        initial=initial,
        monotone=monotone,
        ordered=ordered,
        temperature_noise_K=temperature_noise_K,
        output_name=output_name,
        seed=seed,
    )


def identify_film_records(
    records: Sequence[FilmRecord],
    *,
    kind: Kind | None = None,
    form: str | None = None,
    operators: int = 30,
    initial: Initial | Literal["fitted"] = "fitted",
    monotone: bool = True,
    ordered: bool = True,
    temperature_noise_K: float | None = None,
    output_name: str = "minus_log10_ohm",
    seed: int = 0,
) -> FilmFit:
    """One film model for several records, each with its own memory; arguments as for `identify_film`."""
    if not records:
        raise ValueError("records: none given, expected at least one")
    if form is not None and form not in FORMS:
        raise ValueError(f"form: {form!r} is none of {', '.join(FORMS)}")
    if operators < 1:
        raise ValueError(f"operators: {operators}: expected at least 1")
    if initial not in ("cooled", "heated", "fitted"):
        raise ValueError(f"initial: {initial!r}: expected 'cooled', 'heated' or 'fitted'")
    prepared = [prepare(record, noise_K=temperature_noise_K) for record in records]
    held = [held_out_blocks(record) for record in prepared]
    train = [record.used & ~out for record, out in zip(prepared, held, strict=True)]
    share = max(GLOBAL_ROWS // len(prepared), 60)
    thin = [thinned(record, rows, share) for record, rows in zip(prepared, train, strict=True)]
    split = _Split(prepared, thin, train, held)
    names = ("none",) if kind == "generalized_pi" else (form,) if form else AUTOMATIC
    low = min(float(np.min(record.inputs)) for record in prepared)
    high = max(float(np.max(record.inputs)) for record in prepared)
    forms = [Form(name, monotone and not (name in ("sin", "cos") and form is not None), low, high) for name in names]
    structure = equal_structure(operators, 1, ordered)
    starts = [Start("heated" if initial == "heated" else "cooled") for _ in prepared]

    found = search(build_path(prepared, starts, thin), structure, forms, seed=seed)
    if initial == "fitted":
        best = min(found, key=lambda name: found[name].square)
        problem = _problem(build_path(prepared, starts, thin), structure, forms[names.index(best)])
        options = [start_candidates(record) for record in prepared]
        chosen = choose_starts(prepared, thin, starts, options, problem, found[best].theta)
        if chosen != starts:
            starts = chosen
            extra = [solution.theta[: problem.split] for solution in found.values()]
            found = search(build_path(prepared, starts, thin), structure, forms, seed=seed, extra=extra)

    thin_path = build_path(prepared, starts, thin)
    held_path = build_path(prepared, starts, held)
    candidates: list[Candidate] = []
    plain = _choose_form(forms, found, structure, thin_path, held_path, candidates, kind)
    mixed: MixedSolution | None = None
    if kind in (None, "mixed_envelopes"):
        mixed = _choose_mixed(split, starts, plain, held_path, candidates, kind is None)
    if mixed is not None:
        return _finish_mixed(split, starts, mixed, plain, held_path, candidates, output_name)
    return _finish_plain(split, starts, structure, plain, held_path, candidates, kind, output_name, initial)


def _problem(path: Path, structure: Structure, form: Form) -> Problem:
    return Problem(path, structure, form, *envelope_bounds(path, structure.groups))


def _predict(problem: Problem, solution: Solution, path: Path) -> Array:
    """The fit at another path's readings, shape (readings,)."""
    other = _problem(path, problem.structure, problem.form)
    operators, _ = other.operators(solution.theta)
    memoryless = problem.form.columns(other.v, solution.theta[problem.split :]) @ solution.coefficients
    return np.asarray(solution.offset + memoryless + operators @ solution.weights, dtype=np.float64)


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _choose_form(
    forms: Sequence[Form],
    found: dict[str, Solution],
    structure: Structure,
    path: Path,
    held: Path,
    candidates: list[Candidate],
    kind: Kind | None,
) -> tuple[Form, Solution, float]:
    """The simplest form of D whose held-out error is within `WORTH` of the best."""
    chosen: tuple[Form, Solution, float] | None = None
    for form in forms:
        solution = found[form.name]
        error = _rms(held.output - _predict(_problem(path, structure, form), solution, held))
        name = "generalized_pi" if kind == "generalized_pi" else "extended_generalized_pi"
        candidates.append(Candidate(name, form.name, structure.group.size, math.sqrt(solution.square), error))
        if chosen is None or error < WORTH * chosen[2]:
            chosen = form, solution, error
    assert chosen is not None
    return chosen


def _choose_mixed(
    split: _Split,
    starts: Sequence[Start],
    plain: tuple[Form, Solution, float],
    held: Path,
    candidates: list[Candidate],
    compare: bool,
) -> MixedSolution | None:
    """The best dictionary by held-out rows; None if it is not worth its operators."""
    share = max(2 * GLOBAL_ROWS // len(split.records), 60)
    rows = [thinned(record, train, share) for record, train in zip(split.records, split.train, strict=True)]
    path = build_path(split.records, starts, rows)
    half_width = half_loop_width(path)
    form, solution, plain_error = plain
    shape = solution.theta[4:]
    best: MixedSolution | None = None
    least = MIXED_WORTH * plain_error if compare else math.inf
    for centres, steepness, by_output in RESOLUTIONS:
        trial = solve_mixed(path, dictionary(path, centres, steepness, by_output, half_width), form, shape)
        error = _rms(held.output - trial.at(held))
        candidates.append(Candidate("mixed_envelopes", form.name, trial.weights.size, math.sqrt(trial.square), error))
        if error < (WORTH if best is not None else 1.0) * least:
            best, least = trial, error
    return best


def _finish_mixed(
    split: _Split,
    starts: Sequence[Start],
    mixed: MixedSolution,
    plain: tuple[Form, Solution, float],
    held: Path,
    candidates: list[Candidate],
    output_name: str,
) -> FilmFit:
    train = solve_mixed(build_path(split.records, starts, split.train), mixed.operators, mixed.form, mixed.shape)
    error = _rms(held.output - train.at(held))
    path = build_path(split.records, starts)
    final = solve_mixed(path, mixed.operators, mixed.form, mixed.shape, accurate=True)
    model = final.model(output_name, starts[0].initial)
    return _fit(split, starts, model, final.residual, error, candidates, final.columns(path), path)


def _finish_plain(
    split: _Split,
    starts: Sequence[Start],
    structure: Structure,
    plain: tuple[Form, Solution, float],
    held: Path,
    candidates: list[Candidate],
    kind: Kind | None,
    output_name: str,
    initial: str,
) -> FilmFit:
    form, solution, _ = plain
    train = _problem(build_path(split.records, starts, split.train), structure, form)
    fitted = train.refine(train.solve(solution.theta, accurate=True), steps=10, accurate=True)
    error = _rms(held.output - _predict(train, fitted, held))
    path = build_path(split.records, starts)
    problem = _problem(path, structure, form)
    final = problem.refine(problem.solve(fitted.theta, accurate=True), steps=10, accurate=True)
    shape = final.theta[:4]
    radii, _ = structure.radii(problem.shapes(final.theta))
    a_r, a_l = math.exp(shape[0]), math.exp(shape[2])
    model = FilmModel(
        radii,
        final.weights,
        Envelope("tanh", a_r, -a_r * float(shape[1])),
        Envelope("tanh", a_l, -a_l * float(shape[3])),
        form.memoryless(final.coefficients, final.theta[4:], final.offset),
        "generalized_pi" if kind == "generalized_pi" else "extended_generalized_pi",
        output_name,
        starts[0].initial,
    )
    operators, _ = problem.operators(final.theta)
    columns = problem.active_columns(final, operators)
    return _fit(split, starts, model, final.residual, error, candidates, columns, path)


def memory_at_start(model: FilmModel, start: Start, first_degC: float) -> Memory:
    """The film's memory at a record's first row (degC)."""
    if start.previous_degC is None:
        return model.initial_memory(first_degC, start.initial)
    memory = model.initial_memory(start.previous_degC, start.initial)
    return model.step(first_degC, memory)[1]


def _fit(
    split: _Split,
    starts: Sequence[Start],
    model: FilmModel,
    residual: Array,
    held_out_rmse: float,
    candidates: list[Candidate],
    columns: Array,
    path: Path,
) -> FilmFit:
    firsts = [float(record.inputs[0]) for record in split.records]
    return FilmFit(
        model,
        tuple(starts),
        tuple(memory_at_start(model, start, first) for start, first in zip(starts, firsts, strict=True)),
        _rms(residual),
        float(np.max(np.abs(residual))),
        held_out_rmse,
        tuple(candidates),
        int(np.sum(model.weights > 0.0)),
        tuple(record.path.noise_K for record in split.records),
        tuple(record.outliers for record in split.records),
        film_notes(split.records, model, columns, residual),
    )
