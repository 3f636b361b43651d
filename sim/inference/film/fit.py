"""Identification of a film: the extended generalized Prandtl-Ishlinskii model from temperature and output.

    u(t) = D(v(t)) + sum_j p_j F_rj^gamma[v](t),   p_j >= 0            paper eq (9)

The fit checks the records and finds the path behind the noisy temperature (`rows`, `temperature_path`); searches
globally on thinned rows for each form of D and for each record's memory at its first row and after gaps (`multistart`,
`memory`); chooses the form, and whether a Preisach density is worth it, by rows that were held out (`selection`);
refines the winner on all rows; says how sure it is (`result`) and what the records cannot fix (`notes`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from compensator.hysteresis.film import Envelope, FilmModel, Initial
from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import FORMS, Form
from sim.inference.film.multistart import begun, begun_closer, remembered, search, through_unseen
from sim.inference.film.notes import film_notes
from sim.inference.film.relay_plane import PlaneFit
from sim.inference.film.result import FilmFit, Prediction, memory_at_start, uncertainty
from sim.inference.film.rows import FilmRecord, Path, Prepared, build_path, prepare
from sim.inference.film.selection import (
    Choice,
    Rows,
    choose_form,
    choose_plane,
    make_problem,
    rms,
    share_out,
    without_strays,
)
from sim.inference.film.variable_projection import PlainFit, Problem, Solution, Structure, equal_structure
from sim.inference.readings.checked_columns import check_noise
from sim.inference.readings.odd_readings import Column, of_output, of_records
from sim.inference.readings.output_sense import CLEAR, output_falls, output_sense
from sim.model.record_own import FilmStart

RISES: Final = 0.98  # of the output's changes: where fewer go with the temperature, D may fall; noise is 0.01 at most
FREE: Final = ("linear", "tanh", "polynomial")  # forms of D that may fall
AUTOMATIC: Final = ("none", "linear", "arrhenius", "tanh", "polynomial")  # simplest first
STRAYS: Final = 3  # searches for stray readings: a large one hides a smaller one, and the form of D
GAP_SEARCHES: Final = 3  # what a film went through in a gap is seen better with the envelopes that go with it
Kind = Literal["extended_generalized_pi", "generalized_pi", "mixed_envelopes"]
__all__ = ["FilmFit", "FilmRecord", "FilmStart", "Prediction", "identify_film", "identify_film_records"]


def identify_film(
    time_s: ArrayLike,
    temperature_degC: ArrayLike,
    output: ArrayLike,
    *,
    output_time_s: ArrayLike | None = None,
    kind: Kind | None = None,
    form: str | None = None,
    operators: int = 30,
    initial: Initial | Literal["fitted"] = "fitted",
    monotone: bool | None = None,
    ordered: bool = True,
    temperature_noise_K: float | None = None,
    output_name: str = "minus_log10_ohm",
    seed: int = 0,
) -> FilmFit:
    """Return the film model of one record. Arrays of shape (samples,): s, degC, and the output, nan where there is
    none.

    output_time_s: when each output was read, where that differs from its row's time. kind: None chooses between
    "extended_generalized_pi" and "mixed_envelopes" by held-out rows; "generalized_pi" has no D. form: of D, None
    chooses among none, linear, arrhenius, tanh, polynomial. operators: the largest number of radii. initial: the
    memory before the first row. monotone: D increases with v; None: unless the form is sin or cos. ordered: every
    radius keeps the order condition below paper eq (6); without it the output jumps where a record reverses inside
    the transition. temperature_noise_K: None estimates it, 0 takes the temperature as it is.
    Raises ValueError with one line for a record that cannot be used, such as one whose output falls.
    """
    return identify_film_records(
        [FilmRecord(time_s, temperature_degC, output, output_time_s=output_time_s)],
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
    monotone: bool | None = None,
    ordered: bool = True,
    temperature_noise_K: float | None = None,
    output_name: str = "minus_log10_ohm",
    seed: int = 0,
) -> FilmFit:
    """Return one film model for several records, each with its own memory; arguments as for `identify_film`."""
    if not records:
        raise ValueError("records: none given, expected at least one")
    if kind not in (None, "extended_generalized_pi", "generalized_pi", "mixed_envelopes"):
        raise ValueError(f"kind: {kind!r}: expected extended_generalized_pi, generalized_pi or mixed_envelopes")
    if form is not None and form not in FORMS:
        raise ValueError(f"form: {form!r} is none of {', '.join(FORMS)}")
    if operators < 1:
        raise ValueError(f"operators: {operators}: expected at least 1")
    if initial not in ("cooled", "heated", "fitted"):
        raise ValueError(f"initial: {initial!r}: expected 'cooled', 'heated' or 'fitted'")
    check_noise(temperature_noise_K)
    prepared = [prepare(record, noise_K=temperature_noise_K) for record in records]
    low = min(float(np.min(record.inputs)) for record in prepared)
    high = max(float(np.max(record.inputs)) for record in prepared)
    names = ("none",) if kind == "generalized_pi" else (form,) if form else AUTOMATIC
    odd = _odd(records, output_name)
    try:
        share = _share_that_rises(prepared, free=monotone is False or form in ("sin", "cos"))
    except ValueError as error:
        raise ValueError("; ".join((str(error), *odd))) from None
    increasing = monotone if monotone is not None else form not in ("sin", "cos")
    forms = [Form(name, increasing, low, high) for name in names]
    if increasing and monotone is None and share < RISES:
        forms += [Form(name, False, low, high) for name in names if name in FREE]
    structure = equal_structure(operators, 1, ordered)
    with threadpool_limits(limits=1):  # see `nnls`
        fit = _identified(share_out(prepared), structure, forms, kind, initial, output_name, seed)
    courses = zip(records, prepared, strict=True)
    return replace(
        fit,
        identifiability=(*odd, *fit.identifiability),
        course_degC=tuple(np.interp(np.asarray(one.time_s), ready.time_s, ready.inputs) for one, ready in courses),
    )


def _identified(
    rows: Rows,
    structure: Structure,
    forms: Sequence[Form],
    kind: Kind | None,
    initial: Initial | Literal["fitted"],
    output_name: str,
    seed: int,
) -> FilmFit:
    """Return the fit of rows that are checked, with one of some forms of D."""
    starts = [FilmStart(_likely_end(record) if initial == "fitted" else initial) for record in rows.records]
    found = search(build_path(rows.records, starts, rows.thin), structure, forms, seed=seed)
    if initial == "fitted":
        starts, found = _fit_memories(rows, starts, structure, forms, found, seed)
    if any(record.unseen.size for record in rows.records):
        starts, found = _fit_gaps(rows, starts, structure, forms, found, seed)
    theta = {form: found[form].theta for form in forms}
    plain_kind = "generalized_pi" if kind == "generalized_pi" else "extended_generalized_pi"
    choice = choose_form(rows, starts, structure, forms, theta, plain_kind)
    for _ in range(STRAYS):
        cleaned = without_strays(rows, starts, choice.fit)
        if cleaned is rows:
            break
        rows = cleaned
        choice = choose_form(rows, starts, structure, forms, theta, plain_kind)
    if kind in (None, "mixed_envelopes"):
        choice = choose_plane(rows, starts, choice, needed=kind is not None)
    fit, path, first = choice.fit, build_path(rows.records, starts), starts[0].initial
    if isinstance(fit, PlaneFit):
        model = fit.model(output_name, first)
    else:
        if not np.any(fit.solution.weights > 0.0) and not np.any(fit.solution.coefficients):
            raise ValueError(
                "output: nothing in it rises with temperature, so that no model explains it better than a constant; "
                "expected one that rises, such as -log10(R / 1 ohm)"
            )
        model = plain_model(fit, plain_kind, output_name, first)
    return _fit(rows, starts, path, model, choice)


def _odd(records: Sequence[FilmRecord], output_name: str) -> tuple[str, ...]:
    """Return lines on readings that cannot be what was measured."""
    told = []
    for record in records:
        given = (record.time_s, record.temperature_degC, record.output)
        time, degC, output = (np.asarray(values, dtype=np.float64) for values in given)
        columns = Column("temperature_degC", time, degC, "degC"), of_output(time, output, output_name)
        told.append((record.name, columns))
    return of_records(told)


def _share_that_rises(records: Sequence[Prepared], free: bool) -> float:
    """Return the share of the output's changes that go with the temperature. free: whether D was asked to go any way.

    Raises ValueError for an output that is constant, or falls.
    """
    y = np.concatenate([record.output[record.used] for record in records])
    if np.ptp(y) <= 1e-9 * (1.0 + float(np.max(np.abs(y)))):
        raise ValueError(f"output: constant at {y[0]:g}, expected one that changes with temperature")
    pairs = [(record.inputs[record.used], record.output[record.used]) for record in records]
    share = output_sense(pairs)
    if share < -CLEAR if free else share < CLEAR and output_falls(pairs):
        raise ValueError("output: falls as temperature rises, expected one that rises, such as -log10(R / 1 ohm)")
    return share


def _likely_end(record: Prepared) -> Initial:
    """Return the end of the sweep that the record begins nearer to."""
    middle = 0.5 * (float(np.min(record.inputs)) + float(np.max(record.inputs)))
    return "cooled" if record.inputs[0] >= middle else "heated"


def _at_best(
    rows: Rows, starts: Sequence[FilmStart], structure: Structure, forms: Sequence[Form], found: dict[Form, Solution]
) -> tuple[Problem, Array]:
    """Return the problem with the form of D that fits best, and what the search found for it."""
    best = min(forms, key=lambda form: found[form].square)
    return make_problem(build_path(rows.records, starts, rows.thin), structure, best), found[best].theta


def _fit_memories(
    rows: Rows,
    starts: list[FilmStart],
    structure: Structure,
    forms: Sequence[Form],
    found: dict[Form, Solution],
    seed: int,
) -> tuple[list[FilmStart], dict[Form, Solution]]:
    """Return the memories with which the records began, and the search repeated with them where they are others."""
    problem, theta = _at_best(rows, starts, structure, forms, found)
    chosen = remembered(rows.records, rows.thin, starts, problem, theta, begun)
    if chosen == starts:
        return starts, found
    for _ in range(2):
        extra = [found[form].theta[: problem.split] for form in forms]
        found = search(build_path(rows.records, chosen, rows.thin), structure, forms, seed=seed, extra=extra)
        problem, theta = _at_best(rows, chosen, structure, forms, found)
        refined = remembered(rows.records, rows.train, chosen, problem, theta, begun_closer)
        if refined == chosen:
            break
        chosen = refined
    path = build_path(rows.records, chosen, rows.thin)
    for form in forms:
        problem = make_problem(path, structure, form)
        found[form] = problem.refine(problem.solve(found[form].theta))
    return chosen, found


def _fit_gaps(
    rows: Rows,
    starts: list[FilmStart],
    structure: Structure,
    forms: Sequence[Form],
    found: dict[Form, Solution],
    seed: int,
) -> tuple[list[FilmStart], dict[Form, Solution]]:
    """Return what the film went through where rows are missing, and the search repeated with it where that is
    something."""
    for _ in range(GAP_SEARCHES):
        problem, theta = _at_best(rows, starts, structure, forms, found)
        other = remembered(rows.records, rows.thin, starts, problem, theta, through_unseen)
        if other == starts:
            break
        starts = other
        extra = [found[form].theta[: problem.split] for form in forms]
        found = search(build_path(rows.records, starts, rows.thin), structure, forms, seed=seed, extra=extra)
    return starts, found


def plain_model(fit: PlainFit, kind: str, output_name: str, initial: Initial) -> FilmModel:
    """Return the fit as a model with one pair of envelopes; operators without weight are left out."""
    problem, solution, theta = fit.problem, fit.solution, fit.solution.theta
    radii, _ = problem.structure.radii(problem.shapes(theta))
    a_r, a_l = math.exp(theta[0]), math.exp(theta[2])
    active = solution.weights > 0.0
    if not np.any(active):
        active[0] = True
    return FilmModel(
        radii[active],
        solution.weights[active],
        Envelope("tanh", a_r, -a_r * float(theta[1])),
        Envelope("tanh", a_l, -a_l * float(theta[3])),
        problem.form.memoryless(solution.coefficients, theta[4:], solution.offset),
        kind,
        output_name,
        initial,
    )


def _fit(rows: Rows, starts: Sequence[FilmStart], path: Path, model: FilmModel, choice: Choice) -> FilmFit:
    fit = choice.fit
    residual = path.output - fit.at(path)
    firsts = [float(record.inputs[0]) for record in rows.records]
    return FilmFit(
        model,
        tuple(starts),
        tuple(memory_at_start(model, start, first) for start, first in zip(starts, firsts, strict=True)),
        rms(residual),
        float(np.max(np.abs(residual))),
        choice.held_out_rmse,
        tuple(choice.candidates),
        int(np.sum(model.weights > 0.0)),
        uncertainty(fit, path, residual),
        tuple(record.path.noise_K for record in rows.records),
        tuple(record.outliers for record in rows.records),
        film_notes(rows.records, starts, path, fit.play_outputs(path), model, fit.parameters, rms(residual)),
    )
