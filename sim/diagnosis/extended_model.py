"""The extended model of a diagnosis: film, plate and effects as every other verb runs them.

The form of D(T) is the simplest whose error on held-out rows comes within 2 % of the best; a film that is not of the
model's class gets operators with envelopes of their own each, where that helps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.diagnosis.data.record import Record, held_out_rows
from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.fit.film_refit import FilmRefit, Refit
from sim.diagnosis.fit.film_start import thinned_path
from sim.diagnosis.fit.mixed_envelopes import RESOLUTIONS, dictionary, half_loop_width
from sim.diagnosis.report.candidates import Candidate
from sim.diagnosis.result import Diagnosis
from sim.diagnosis.search.identified_film import identified_film
from sim.effects.memoryless_term import NAME as MEMORYLESS_TERM
from sim.inference.film.memoryless_forms import Form
from sim.inference.film.selection import rms
from sim.model.film_mixing import PhaseMixing
from sim.model.operator_outputs import Integers

FORMS = ("none", "linear", "arrhenius", "tanh", "polynomial", "sin", "cos")  # simplest first
NEAR = 1.5  # times the best error: forms whose envelopes are fitted anew
NOT_OF_THE_CLASS = 1.15  # times the diagnosis' own error from which mixed envelopes are tried
MIXED_WORTH = 0.95
FEWER_WORTH = 0.93  # of the error of fewer operators, that more have to come below
WORTH = 0.98  # of the error of a simpler form of D
SEARCH_ROWS, MOST_ROWS = 1500, 6000  # to search with, and to fit with: thinned evenly from longer records
SCALES = (0.1, 1.0, 0.1, 1.0)  # log a and K: what an envelope moves by in a step
CURVE_SCALES = (0.3, 3.0)  # the same of D's first parameter, which is a logarithm, and of the others, which are K
DESCENT = 10  # evaluations: the search begins at the diagnosis' own film
BY_CHANCE = 3.0  # deviations by which an error over so many rows may be larger though the model is as good
FEWEST_JUDGED = 10  # rows, of which an error is known to a fifth
TURNS = 2  # of a problem that is linear only about a solution


@dataclass(frozen=True, eq=False)
class ExtendedModel:
    """film, plate: None where the record has none; effects: tables as in a model file; rmse: of the film's model on
    held-out rows, driven as in the diagnosis, in decades or in the unit of the film's output; mixing: of the film's
    phases, None: in their logarithms; others: how many further records of the film told it, too."""

    film: FilmModel | None
    plate: PlateModel | None
    effects: list[dict[str, float | str]]
    rmse: float | None
    mixing: PhaseMixing | None = None
    others: int = 0


def extended_model(
    diagnosis: Diagnosis, candidate: Candidate | None = None, others: Sequence[Record] = ()
) -> ExtendedModel:
    """Base model, assumed and named effects of a diagnosis; or the effects of a candidate in their place. others:
    further records of the film, which tell it too where the held-out rows of the diagnosed one are no worse for it."""
    with threadpool_limits(limits=1):
        chain, names, found = diagnosis.chain, diagnosis.judged.fitted, _sizes(diagnosis)
        if candidate is not None:
            names, found = frozenset(candidate.names), candidate.parameters
        last, plate = chain.fits(names)[1], chain.plate(names)
        effects: list[dict[str, float | str]] = [{"name": effect, **own} for effect, own in found.items()]
        if last is None:
            return ExtendedModel(None, plate, effects, None)
        refit = FilmRefit(chain.film_channel(names), last)
        solution, error = film_of(refit, chain.curve)
        quantity, told_by = chain.record.quantity, 0
        film, mixing = solution.model(last.parameters.start.initial), refit.mixing
        if chain.curve and (others or last.parameters.has_relays):
            _, held = _shared_out(refit)
            anew = identified_film(chain, names, others, held)
            chance = BY_CHANCE / math.sqrt(2.0 * held.size) if others else 0.0
            if anew is not None and (left := rms(anew.left[np.isfinite(anew.left)])) <= (1.0 + chance) * error:
                film, error, mixing, told_by = anew.model, left, None, len(others)
        return ExtendedModel(quantity.film(film), plate, effects, quantity.size * error, mixing, told_by)


def _sizes(diagnosis: Diagnosis) -> dict[str, dict[str, float]]:
    """Of the effects assumed and named, by effect and name of the parameter."""
    found = diagnosis.assumed | {f.name: f.parameters for f in diagnosis.findings if f.name != MEMORYLESS_TERM}
    return {effect: {name: value for name, (value, _) in own.items()} for effect, own in found.items()}


def with_film(diagnosis: Diagnosis, model: ExtendedModel) -> Diagnosis:
    """The diagnosis with the film's form as the model has it."""
    if model.film is None:
        return diagnosis
    film: dict[str, Any] = dict(diagnosis.film or {})
    film |= {"memoryless": model.film.memoryless.function, "operators": model.film.operators, "kind": model.film.kind}
    film |= {"further_records": model.others} if model.others else {}
    return replace(diagnosis, film=film)


def film_of(refit: FilmRefit, curve: bool) -> tuple[Refit, float]:
    """The film's model and its error on held-out rows (decades); curve: whether it may have a D(T)."""
    fitted, held = _shared_out(refit)
    v = refit.nodes.film_degC
    forms = [Form(name, False, float(np.min(v)), float(np.max(v))) for name in (FORMS if curve else FORMS[:1])]
    solution, error = _plain(refit, forms, fitted, held)
    shown = refit.channel.output[held] - refit.fit.shown[held]
    if refit.fit.parameters.has_relays or error > NOT_OF_THE_CLASS * rms(shown):
        solution, error = _mixed(refit, solution, error, fitted, held)
    for _ in range(TURNS if refit.links.bends else 0):
        refit = refit.about(refit.signal(solution))
        solution, error = _again(refit, solution, fitted, held)
    return solution, error


def _again(refit: FilmRefit, solution: Refit, fitted: Integers, held: Integers) -> tuple[Refit, float]:
    """The same structure solved about its own output: through a shunt or a series resistance the rest is not linear."""
    o = solution.operators
    operators = refit.plays(solution.theta[:ENVELOPES]) if o is None else refit.relays(o)
    fit = refit.solve(fitted, solution.form, solution.theta, operators, o)
    return fit, rms(refit.residual(held, fit, operators))


def _shared_out(refit: FilmRefit) -> tuple[Integers, Integers]:
    """Rows to fit and rows to judge by."""
    record, fitted = refit.channel.record, refit.channel.fitted
    held = record.output_used & ~fitted
    if np.sum(held) < FEWEST_JUDGED:  # others are held out here
        held = record.output_used & held_out_rows(record.rows, record.first_rows)
    if np.sum(held) < FEWEST_JUDGED:  # the film was read in few places
        read = np.flatnonzero(record.output_used)
        held[read[held_out_rows(read.size)]] = True
    fitted = fitted & ~held
    return _thinned(np.flatnonzero(fitted), MOST_ROWS), np.flatnonzero(held)


def _thinned(rows: Integers, most: int) -> Integers:
    return rows[np.unique(np.linspace(0, rows.size - 1, min(most, rows.size)).round().astype(np.int64))]


def _plain(refit: FilmRefit, forms: list[Form], fitted: Integers, held: Integers) -> tuple[Refit, float]:
    """One pair of envelopes, with each form of D; the simplest that is as good as any."""
    few, shape = _thinned(fitted, SEARCH_ROWS), refit.fit.parameters.x[:ENVELOPES]
    operators = refit.plays(shape)
    rough = {}
    for form in forms:
        starts = [np.concatenate((shape, par)) for par in _shapes(form)]
        rough[form.name] = min((refit.solve(few, form, theta, operators) for theta in starts), key=_square)
    least = min(math.sqrt(_square(r)) for r in rough.values())
    chosen: Refit | None = None
    error = math.inf
    for form in forms:
        if math.sqrt(_square(rough[form.name])) > NEAR * least:
            continue
        theta = _descended(refit, few, form, rough[form.name].theta)
        fit, value = _fitted(refit, form, theta, fitted, held)
        if chosen is None or value < WORTH * error:
            chosen, error = fit, value
    assert chosen is not None
    return chosen, error


def _fitted(refit: FilmRefit, form: Form, theta: Array, fitted: Integers, held: Integers) -> tuple[Refit, float]:
    """The solution at theta over all rows to be fitted, and its error in the held-out rows."""
    operators = refit.plays(theta[:ENVELOPES])
    fit = refit.solve(fitted, form, theta, operators)
    return fit, rms(refit.residual(held, fit, operators))


def _square(fit: Refit) -> float:
    return float(np.mean(fit.residual**2))


def _shapes(form: Form) -> list[Array]:
    """Nonlinear parameters of D to begin from."""
    low, high = form.bounds()
    if low.size == 0:
        return [np.empty(0)]
    # seven places inside the bounds, between which a search descends
    axes = [np.linspace(a, b, 9)[1:-1] for a, b in zip(low, high, strict=True)]
    return list(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, low.size))


def _descended(refit: FilmRefit, rows: Integers, form: Form, theta: Array) -> Array:
    """Envelopes and D's shape moved together, weights and coefficients always at their best."""
    low, high, _ = refit.channel.bounds(refit.fit.parameters)
    d_low, d_high = form.bounds()
    least, most = np.append(low[:ENVELOPES], d_low), np.append(high[:ENVELOPES], d_high)
    inside = np.clip(theta, least + 1e-9, most - 1e-9)  # a start on a bound does not move

    def residual(x: Array) -> Array:
        return refit.solve(rows, form, x, refit.plays(x[:ENVELOPES])).residual

    scale = np.concatenate((SCALES, np.where(np.arange(d_low.size) == 0, *CURVE_SCALES)))
    # longer steps of the difference quotients would cross the kinks of weights that become 0
    found = least_squares(residual, inside, bounds=(least, most), x_scale=scale, diff_step=[1e-5], max_nfev=DESCENT)
    return np.asarray(found.x, dtype=np.float64)


def _mixed(refit: FilmRefit, plain: Refit, error: float, fitted: Integers, held: Integers) -> tuple[Refit, float]:
    """The best dictionary of operators by held-out rows, few preferred; the plain fit if none is better."""
    used = np.zeros(refit.channel.record.rows, dtype=np.bool_)
    used[fitted] = True
    path = thinned_path(refit.nodes, refit.own, used, refit.fit.parameters.start)
    half_width = half_loop_width(path)
    best, least, few = plain, error, _thinned(fitted, 2 * SEARCH_ROWS)
    for resolution in RESOLUTIONS:
        trial = dictionary(path, *resolution, half_width)
        operators = refit.relays(trial)
        fit = refit.solve(few, plain.form, plain.theta[ENVELOPES:], operators, trial)
        value = rms(refit.residual(held, fit, operators))
        more = best.operators is not None and fit.active.size > best.active.size
        worth = MIXED_WORTH if best.operators is None else FEWER_WORTH if more else 1.0
        if value < worth * least:
            best, least = fit, value
    return best, least
