"""Identification of a film from temperature and output: the joint fit of no effect, of records without a current.

    u(t) = D(v(t)) + sum_j p_j F_rj^gamma[v](t),   p_j >= 0            paper eq (9)

The likelihood, the film's starts and its memory are those of every fit (`sim.inference.joint`); what drives the film
is known beforehand (`rows`). What is left is taken for white noise, so that the fit is the one with the least error: a
film is written to predict with. A smooth D(T) is fitted first, then the form of D, and whether a Preisach density is
worth it, are chosen by rows that were held out. A likelihood would not do for that: no film is exactly a sum of so many
operators, and what the model lacks is no noise that a likelihood knows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from compensator.hysteresis.film import Envelope, FilmModel, Initial, Memory
from compensator.hysteresis.functions import Array
from sim.inference.film.memoryless_forms import FORMS, SIMPLEST_FIRST, Form
from sim.inference.film.notes import film_notes
from sim.inference.film.preisach_density import relays_over
from sim.inference.film.result import (
    Candidate,
    FilmFit,
    FittedFilm,
    memory_at_start,
    through_gaps,
)
from sim.inference.film.rows import (
    OUTPUT,
    FilmRecord,
    Prepared,
    as_record,
    held_out_blocks,
    prepare,
)
from sim.inference.gain import rms
from sim.inference.joint.films import NamedCurve, PIFilm, PreisachFilm
from sim.inference.joint.likelihood import Fit, Joint, Point
from sim.inference.joint.starts import film_starts, first_metric, remembering, with_film_of, with_other_envelopes
from sim.inference.nnls import reduced, solve_triangle
from sim.inference.noise import ChannelNoise, Metric, Noise, estimate, rough_noise, variances
from sim.inference.nuisance import WORTH as WORTH_OF_MEMORY
from sim.inference.readings.checked_columns import check_noise
from sim.inference.readings.odd_readings import Column, lone_outliers, of_output, of_records
from sim.inference.readings.output_sense import CLEAR, output_falls, output_sense
from sim.inference.record.quantity import FALLING_OHM, RISING_OHM, SPAN
from sim.inference.record.record import ALONE, REPEATED, Mask, Record
from sim.model.film_columns import film_path
from sim.model.record_own import SATURATED_DEGC, FilmStart

RISES: Final = 0.98  # of the output's changes: where fewer go with the temperature, D may fall; noise is 0.01 at most
FREE: Final = ("linear", "tanh", "polynomial")  # forms of D that may fall
STRAYS: Final = 3  # searches for stray readings: a large one hides a smaller one
GAIN: Final = 0.03  # of the mean square that another memory brings: what the model lacks is no noise
MEMORIES: Final = 3  # searches for the memory: it is seen better with the envelopes that go with it
WORTH: Final = 0.98  # of the held-out error, below which a candidate with more freedom has to come
LEAST_NOISE: Final = 1e-6  # of the output's span: a film simulated without noise
STEPS: Final = 30  # of a descent from the best of the starts
CLOSE: Final = 0.005  # log-likelihood that its last step gains: numbers of a film that is shifted are then the same
THRESHOLDS: Final = (12, 18, 24, 36)  # of either sense: half finer each, up to what half a second can compute
STEEPNESS: Final = 0.8  # of a relay's step, times the distance of thresholds: the sum of neighbours is then smooth
WIDTHS: Final = np.geomspace(1.0, 1000.0, 7)  # of the relays' prior, over the noise: up to a whole film in one relay
STARTS: Final = 5, 48  # of the nonlinear parameters of a form, each of two; of one, which may be a wave's frequency
NEGLIGIBLE: Final = 1e-6  # of all weights: below it an operator counts as absent
__all__ = ["FilmFit", "FilmStart"]
Kind = Literal["extended_generalized_pi", "generalized_pi", "mixed_envelopes"]


def identify_film(
    time_s: ArrayLike,
    temperature_degC: ArrayLike,
    output: ArrayLike,
    *,
    output_time_s: ArrayLike | None = None,
    **how: Any,
) -> FilmFit:
    """Return the film model of one record. Arrays of shape (samples,): s, degC, and the output, nan where there is
    none.

    output_time_s: when each output was read, where that differs from its row's time. how: as `identify_film_records`.
    Raises ValueError with one line for a record that cannot be used, such as one whose output falls.
    """
    return identify_film_records([FilmRecord(time_s, temperature_degC, output, output_time_s=output_time_s)], **how)


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
    output_name: str = FALLING_OHM,
) -> FilmFit:
    """Return one film model for several records, each with its own memory.

    kind: None chooses between "extended_generalized_pi" and "mixed_envelopes" by held-out rows; "generalized_pi" has no
    D. form: of D, None chooses among none, linear, arrhenius, tanh, polynomial. operators: the largest number of radii.
    initial: the memory before the first row. monotone: D increases with v; None: unless the form is sin or cos.
    ordered: every radius keeps the order condition below paper eq (6); without it the output jumps where a record
    reverses inside the transition. temperature_noise_K: None estimates it, 0 takes the temperature as it is.
    Raises ValueError with one line for a record that cannot be used, such as one whose output falls.
    """
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
    names = ("none",) if kind == "generalized_pi" else (form,) if form else SIMPLEST_FIRST
    odd = _odd(records, output_name)
    try:
        share = _share_that_rises(prepared, free=monotone is False or form in ("sin", "cos"))
    except ValueError as error:
        raise ValueError("; ".join((str(error), *odd))) from None
    increasing = monotone if monotone is not None else form not in ("sin", "cos")
    forms = [Form(name, increasing, low, high) for name in names]
    if increasing and monotone is None and share < RISES:
        forms += [Form(name, False, low, high) for name in names if name in FREE]
    search = _Search(prepared, forms, kind, operators, ordered, initial, output_name)
    with threadpool_limits(limits=1):  # see `nnls`
        fit = search.result()
    courses = zip(records, prepared, strict=True)
    return replace(
        fit,
        identifiability=(*odd, *fit.identifiability),
        course_degC=tuple(np.interp(np.asarray(one.time_s), ready.time_s, ready.inputs) for one, ready in courses),
    )


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
    y = np.concatenate([record.output[np.isfinite(record.output)] for record in records])
    if np.ptp(y) <= 1e-9 * (1.0 + float(np.max(np.abs(y)))):
        raise ValueError(f"output: constant at {y[0]:g}, expected one that changes with temperature")
    pairs = [(record.inputs, record.output) for record in records]
    share = output_sense(pairs)
    if share < -CLEAR if free else share < CLEAR and output_falls(pairs):
        raise ValueError("output: falls as temperature rises, expected one that rises, such as -log10(R / 1 ohm)")
    return share


@dataclass(frozen=True, eq=False)
class _Columns:
    """What a likelihood's film leaves of its readings for any prior: its columns in all rows; products: of the fitted
    readings' columns and output; y: of all rows."""

    joint: Joint
    columns: Array
    products: Array
    y: Array
    held: Mask

    @classmethod
    def of(cls, joint: Joint, x: Array, metric: Metric, held: Mask) -> _Columns:
        run, record = joint.simulate(x, metric), joint.record
        assert run.nodes is not None
        assert run.columns is not None
        assert record.output is not None
        columns = run.nodes.of_rows(run.columns)
        both = np.column_stack((columns, record.output))[record.output_used & ~held]
        return cls(joint, columns, both.T @ both, record.output, held & record.output_used)

    def solved(self, precision: Array) -> Array:
        """Return the coefficients. precision: of their priors, over that of the readings."""
        normal = self.products.copy()
        normal[np.diag_indices(precision.size)] += precision
        assert self.joint.film is not None
        return solve_triangle(reduced(normal), self.joint.film.free)[0]

    def errors(self, x: Array) -> tuple[float, float]:
        """Return the RMS error on the rows fitted and on those held out."""
        used, left = self.joint.record.output_used, self.y - self.columns @ x
        return rms(left[used & ~self.held]), rms(left[self.held])


class _Search:
    """One film for prepared records, with one of some forms of D."""

    def __init__(
        self,
        records: Sequence[Prepared],
        forms: Sequence[Form],
        kind: Kind | None,
        operators: int,
        ordered: bool,
        initial: Initial | Literal["fitted"],
        output_name: str,
    ) -> None:
        self.records, self.forms, self.kind, self.operators = records, forms, kind, operators
        self.ordered, self.output_name = ordered, output_name
        self.start = None if initial == "fitted" else FilmStart(initial)
        self.pi_kind = "generalized_pi" if kind == "generalized_pi" else "extended_generalized_pi"
        centre, size, y = 0.0, 1.0, np.concatenate([one.output for one in records])
        if output_name not in (FALLING_OHM, RISING_OHM):  # the fit's priors are of decades
            low, high = np.nanpercentile(y, [1.0, 99.0])
            centre, size = 0.5 * float(low + high), float(high - low or np.ptp(y[np.isfinite(y)])) / SPAN
        self.centre, self.size = centre, size
        self.record = as_record(records, centre, size)
        self.degC = np.concatenate([one.inputs for one in records])
        self.least = LEAST_NOISE * float(np.ptp(self.record.output[self.record.output_used]))  # type: ignore[index]

    def result(self) -> FilmFit:
        """Return the fit of all records."""
        fit = self._smooth()
        for _ in range(STRAYS):
            cleaned = self._without_strays(fit)
            if cleaned is self.record:
                break
            self.record = cleaned
            fit = self._settled(fit.joint.on(cleaned), fit.at.x)
        held = held_out_blocks(self.record)
        fit, candidates, held_out = self._named(fit, held)
        if self.kind in (None, "mixed_envelopes"):
            fit, more, held_out = self._relays(fit, held, held_out)
            candidates += more
        return self._result(fit, candidates, held_out)

    def _remembering(self, fit: Fit) -> tuple[Joint, Point]:
        """The likelihood and point with the memory that suits a film better, the same where none does."""
        worth = max(WORTH_OF_MEMORY, 0.5 * GAIN * fit.joint.rows_dec.size)
        return remembering(fit.joint, fit.at, fit.metric, worth, self.start is not None)

    # ---- fits with white noise ------------------------------------------------------------------------------------

    def _metric(self, joint: Joint, residual: Array | None = None) -> Metric:
        """White noise of a residual, readings far out weighing less; None: as it is from row to row."""
        first = first_metric(joint)
        readings = joint.readings()[1]
        if residual is None:
            return Metric(first.temperature, ChannelNoise(Noise(self._rough(joint)), readings), simulated=False)
        weights = np.ones(residual.size)
        for _ in range(3):
            white = max(rms(residual / np.sqrt(weights)), self.least)
            weights = variances(residual, Noise(white), readings)
        channel = ChannelNoise(Noise(white), replace(readings, variance=weights))
        return Metric(first.temperature, channel, simulated=False)

    def _rough(self, joint: Joint) -> float:
        return max(rough_noise(joint.output), self.least)

    def _settled(self, joint: Joint, x: Array, steps: int = STEPS) -> Fit:
        """The fit with the least error, from a start."""
        at = joint.solve(x, metric := self._metric(joint))
        for _ in range(2):
            at = joint.solve(at.x, metric := self._metric(joint, at.residual_dec), at.known_own)
            at = joint.descend(at, metric, steps, CLOSE)
        return Fit(joint, at, metric, joint.log_likelihood(at, metric))

    def _smooth(self) -> Fit:
        """The PI film with any smooth D, or the one form that was asked for, and its memory."""
        (form, *more), curve = self.forms, None
        if not more and form.parameters == 0:
            curve = NamedCurve(form, np.empty(0))
        bare = Joint(self.record, (), None)
        metric = Metric(first_metric(bare).temperature, None, simulated=False)
        plate = Fit(bare, bare.solve(bare.start(), metric), metric, 0.0)
        starts = film_starts(self.record, self.degC, curve, self.ordered, self.start)
        between = self._between(starts[0].start)
        fit = with_film_of(plate, [film.starting_with(between) for film in starts])
        fit = self._settled(fit.joint, fit.at.x)
        for _ in range(MEMORIES):
            joint, at = self._remembering(fit)
            if joint is fit.joint:
                break
            fit = self._settled(joint, at.x)
        return self._enveloped(fit) if self._leaves_more(fit) else fit

    def _enveloped(self, fit: Fit) -> Fit:
        """The likeliest fit with envelopes of any function."""
        other = max(with_other_envelopes(fit), key=lambda f: f.log_likelihood)
        return max(fit, self._settled(other.joint, other.at.x), key=lambda f: f.log_likelihood)

    def _leaves_more(self, fit: Fit) -> bool:
        """Whether more is left than white noise."""
        residual, readings = fit.at.residual_dec, fit.joint.readings()[1]
        return estimate(residual, readings, self.least).white <= WORTH * rms(residual)

    def _between(self, start: FilmStart) -> FilmStart:
        """The memory with which each further record begins in saturation, at the end that it begins nearer to."""
        middle, time = 0.5 * float(np.min(self.degC) + np.max(self.degC)), self.record.time_s
        for row in self.record.joined:
            likely: Initial = "cooled" if self.degC[row] >= middle else "heated"
            end = likely if self.start is None else self.start.initial
            start = start.turning(float(time[row]), (SATURATED_DEGC[end],))
        return start

    def _without_strays(self, fit: Fit) -> Record:
        """The record without those readings that stand alone among the residuals; the same if there are none."""
        residual = np.full(self.record.rows, np.nan)
        residual[fit.joint.rows_dec] = fit.at.residual_dec
        strays = np.zeros(self.record.rows, dtype=np.bool_)
        for part in self.record.parts:
            strays[part.start + lone_outliers(residual[part], np.isfinite(residual[part]))] = True
        if not np.any(strays):
            return self.record
        return self.record.leaving_out(strays, ALONE)

    # ---- choices by held-out rows ---------------------------------------------------------------------------------

    def _named(self, fit: Fit, held: Mask) -> tuple[Fit, list[Candidate], float]:
        """The PI film with the form of D that predicts held-out rows best, its error on these, and all that were
        tried."""
        film, degC = fit.joint.film, self.degC[self.record.output_used]
        assert isinstance(film, PIFilm)
        curve = film.curve.columns(degC) @ fit.at.coefficients[1 : 1 + film.curve.count]
        candidates, best, least = [], None, math.inf
        for form in self.forms:
            joint = fit.joint.having((), replace(film, curve=nearest_curve(form, degC, curve)))
            x = joint.from_other(fit.joint, fit.at.x)
            at = joint.descend(joint.solve(x, fit.metric), fit.metric, 4, 1.0)
            rmse, error = self._held_out(joint, at, fit.metric, held)
            active = int(np.sum(at.coefficients[1 + joint.film.curve.count :] > 0.0))  # type: ignore[union-attr]
            candidates.append(Candidate(self.pi_kind, form.name, active, self.size * rmse, self.size * error))
            if error < WORTH * least:
                best, least = (joint, at.x), error
        assert best is not None
        found = self._refined(*best)
        return found, candidates, least

    def _held_out(self, joint: Joint, at: Point, metric: Metric, held: Mask) -> tuple[float, float]:
        """The RMS errors on the rows fitted and on those held out of the film with its weights fitted without these."""
        columns = _Columns.of(joint, at.x, metric, held)
        assert joint.film is not None
        assert metric.output is not None
        return columns.errors(columns.solved(joint.film.precision * metric.output.noise.white**2))

    def _refined(self, joint: Joint, x: Array) -> Fit:
        """The final PI film: on radii four times as dense, then with no more of them than were asked for."""
        film = joint.film
        assert isinstance(film, PIFilm)
        fit = self._settled(joint.having((), film.finer()), x, 8)
        for _ in range(2):  # those without weight go in the second round
            film, weights = fit.joint.film, fit.at.coefficients
            assert isinstance(film, PIFilm)
            few = film.at_places(merged(film.places, weights[1 + film.curve.count :], self.operators))
            fit = self._settled(fit.joint.having((), few), fit.at.x, 8)
        return fit

    def _relays(self, film: Fit, held: Mask, held_out: float) -> tuple[Fit, list[Candidate], float]:
        """The Preisach density in place of a PI film, where it predicts better or is needed; else that film. No film
        predicts to within less than the white noise. A film that suits better shows better, too, what it remembers: of
        another memory all densities are tried again."""
        if self.kind is not None:
            held_out = math.inf
        elif not self._leaves_more(film):
            return film, [], held_out
        pi, best = film.joint.film, film
        candidates: list[Candidate] = []
        assert isinstance(pi, PIFilm)
        start = pi.start
        for _ in range(MEMORIES):
            fit, candidates, error = self._density(film, start, held, held_out)
            if fit is None:
                break
            best, held_out = fit, error
            joint, _ = self._remembering(fit)
            if joint is fit.joint:
                break
            assert joint.film is not None
            start = joint.film.start
        return best, candidates, held_out

    def _density(
        self, film: Fit, start: FilmStart, held: Mask, held_out: float
    ) -> tuple[Fit | None, list[Candidate], float]:
        """The Preisach film that predicts held-out rows best, None if none does better than `held_out`; all candidates;
        and its error. film: the PI film, for D; start: the memory."""
        pi, rows, readings = film.joint.film, film.joint.rows_dec, film.joint.readings()[1]
        assert isinstance(pi, PIFilm)
        curve = pi.curve_at(film.at.x[film.joint.is_film])
        assert isinstance(curve, NamedCurve)
        candidates, best, least = [], None, held_out
        for thresholds in THRESHOLDS:
            relays = relays_over(self.degC[rows], film.joint.output, thresholds, STEEPNESS)
            joint = film.joint.having((), PreisachFilm(curve, relays, start))
            columns = _Columns.of(joint, joint.start(), film.metric, held)
            width, (rmse, error), active = self._best_width(columns, film.metric)
            of_form = "mixed_envelopes", curve.form.name, active
            candidates.append(Candidate(*of_form, self.size * rmse, self.size * error))
            if error < WORTH * least:
                best, left, least = PreisachFilm(curve, relays, start, width * rmse), rmse, error
        if best is None:
            return None, candidates, held_out
        # the prior's width goes with the noise of the fit that it was found with
        metric = film.metric.of(film.metric.temperature, ChannelNoise(Noise(max(left, self.least)), readings))
        joint = film.joint.having((), best)
        heavy = self._heavy(joint.solve(joint.start(), metric), best)
        joint = joint.having((), best.only(heavy))
        at = joint.solve(joint.start(), metric)
        return Fit(joint, at, metric, joint.log_likelihood(at, metric)), candidates, least

    @staticmethod
    def _heavy(at: Point, film: PreisachFilm) -> Mask:
        """The columns that carry a film, (columns,)."""
        weights = np.where(np.arange(at.coefficients.size) <= film.curve.count, 0.0, at.coefficients)
        return np.asarray(weights > NEGLIGIBLE * float(np.sum(weights)), dtype=np.bool_)

    def _best_width(self, columns: _Columns, metric: Metric) -> tuple[float, tuple[float, float], int]:
        """The width of the weights' prior, over the noise, that predicts held-out rows best, the errors with it, and
        how many relays then have weight."""
        film = columns.joint.film
        assert isinstance(film, PreisachFilm)
        split = 1 + film.curve.count
        tried: dict[int, tuple[tuple[float, float], int]] = {}

        def error(place: int) -> float:
            if place not in tried:
                precision = film.precision * metric.output.noise.white**2  # type: ignore[union-attr]
                precision[split:] = WIDTHS[place] ** -2.0
                x = columns.solved(precision)
                tried[place] = columns.errors(x), int(np.sum(x[split:] > NEGLIGIBLE * np.sum(x[split:])))
            return tried[place][0][1]

        place = WIDTHS.size // 2
        for step in (-1, 1):  # downhill from the middle
            while 0 <= place + step < WIDTHS.size and error(place + step) < error(place):
                place += step
        return float(WIDTHS[place]), *tried[place]

    # ---- the result -----------------------------------------------------------------------------------------------

    def _result(self, fit: Fit, candidates: list[Candidate], held_out: float) -> FilmFit:
        film, at, nodes = fit.joint.film, fit.at, fit.at.run.nodes
        assert isinstance(film, PIFilm | PreisachFilm)
        assert nodes is not None
        model = self.quantity_of(film_model(fit, self.pi_kind))
        if not np.any(at.coefficients[1:]):
            raise ValueError(
                "output: nothing in it rises with temperature, so that no model explains it better than a constant; "
                "expected one that rises, such as -log10(R / 1 ohm)"
            )
        starts, memories = self._memories(model, film.start)
        residual, rows = self.size * at.residual_dec, fit.joint.rows_dec
        fitted = FittedFilm(fit, self.centre, self.size)
        parts = self.record.parts
        stray, repeat = (
            [[row - part.start for row in self._left_out(rule) if part.start <= row < part.stop] for part in parts]
            for rule in (ALONE, REPEATED)
        )
        fresh = [one.readings - len(repeats) for one, repeats in zip(self.records, repeat, strict=True)]
        inputs, side = film_path(nodes)
        sense = np.sign(side)[nodes.taken[rows] + inputs.size - nodes.time_s.size]
        plays = at.run.columns[nodes.rows[rows], 1 + film.curve.count :]  # type: ignore[index]
        kept = model.weights.size
        plays = plays[:, at.coefficients[1 + film.curve.count :] > 0.0][:, :kept]
        readings = self.degC[rows], self.centre + self.size * fit.joint.output, sense
        return FilmFit(
            model,
            starts,
            memories,
            rms(residual),
            float(np.max(np.abs(residual))),
            self.size * held_out,
            tuple(candidates),
            fitted,
            tuple(one.path.noise_K for one in self.records),
            tuple(one.rows[np.sort(rows).astype(np.int64)] for one, rows in zip(self.records, stray, strict=True)),
            film_notes(
                self.records, starts, fresh, readings, self.size * plays, model, fitted.parameters, rms(residual)
            ),
        )

    def _left_out(self, rule: str) -> list[int]:
        """The rows whose output does not count by a rule."""
        return [one.row for one in self.record.left_out if one.rule == rule and one.column == OUTPUT]

    def quantity_of(self, model: FilmModel) -> FilmModel:
        """The fit's model in the output's own unit."""
        return replace(self.record.quantity.film(model), output=self.output_name)

    def _memories(self, model: FilmModel, start: FilmStart) -> tuple[tuple[FilmStart, ...], tuple[Memory, ...]]:
        """What each record's film remembered at its first row and went through in gaps, in the record's own time."""
        starts: list[FilmStart] = []
        memories: list[Memory] = []
        passed = dict(start.passed_degC)
        for one, part in zip(self.records, self.record.parts, strict=True):
            first_s, first = float(self.record.time_s[part.start]), float(one.inputs[0])
            if not starts:
                known, memory = start, memory_at_start(model, start, first)
            else:
                turned = passed.get(first_s, ())
                for degC in (*turned, first):
                    memory = model.step(degC, memory)[1]
                known = FilmStart("cooled" if turned and turned[0] > first else "heated", turned)
            own = [
                (float(one.time_s[np.searchsorted(self.record.time_s[part], t)]), degC)
                for t, degC in passed.items()
                if first_s < t <= self.record.time_s[part.stop - 1]
            ]
            starts.append(replace(known, passed_degC=tuple(own)))
            memories.append(memory)
            memory = through_gaps(model, starts[-1], one.time_s, one.inputs, memory)[1]
        return tuple(starts), tuple(memories)


def nearest_curve(form: Form, degC: Array, curve: Array) -> NamedCurve:
    """Return the curve of a form that comes nearest to a curve at some temperatures."""
    if form.parameters == 0:
        return NamedCurve(form, np.empty(0))
    low, high = form.bounds()

    def left(shape: Array) -> Array:
        columns = np.column_stack((np.ones(degC.size), form.columns(degC, shape)))
        return np.asarray(curve - columns @ np.linalg.lstsq(columns, curve)[0])

    count = STARTS[0] if low.size > 1 else STARTS[1]
    axes = [np.linspace(a, b, count + 2)[1:-1] for a, b in zip(low, high, strict=True)]
    starts = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, low.size)
    first = min(starts, key=lambda shape: float(np.sum(left(shape) ** 2)))
    return NamedCurve(form, np.asarray(least_squares(left, first, bounds=(low, high)).x))


def film_model(fit: Fit, kind: str | None = None) -> FilmModel:
    """Return the film of a fit whose D has a name, in the fit's decades. kind: of a PI film, None: by its D."""
    film, c = fit.joint.film, fit.at.coefficients
    assert isinstance(film, PIFilm | PreisachFilm)
    values = fit.at.x[fit.joint.is_film]
    curve = film.curve_at(values) if isinstance(film, PIFilm) else film.curve
    assert isinstance(curve, NamedCurve)
    split = 1 + curve.count
    memoryless, weights = curve.form.memoryless(c[1:split], curve.shape, float(c[0])), c[split:]
    kept = weights > NEGLIGIBLE * float(np.sum(weights))
    kept[0] |= not np.any(kept)  # a film without any hysteresis
    if isinstance(film, PIFilm):
        slopes, centres = np.exp(values[[0, 2]]), values[[1, 3]]
        each = zip(slopes.tolist(), centres.tolist(), strict=True)
        rising, falling = (Envelope(film.function, a, -a * c) for a, c in each)
        kind = kind or ("generalized_pi" if memoryless.function == "none" else "extended_generalized_pi")
        radii = film.radii(values)[kept]
        return FilmModel(radii, weights[kept], rising, falling, memoryless, kind, initial=film.start.initial)
    relays = film.density.only(kept)
    radii = np.zeros(relays.centre.size)
    envelopes = relays.envelopes()
    return FilmModel(radii, weights[kept], *envelopes, memoryless, "mixed_envelopes", initial=film.start.initial)


def merged(places: Array, weights: Array, most: int) -> Array:
    """Return only the places with weight, neighbours joined at their common centre down to at most `most`."""
    kept = weights > NEGLIGIBLE * float(np.sum(weights))
    if not np.any(kept):
        return places[:1]
    place, weight = places[kept], weights[kept]
    while place.size > most:
        together = weight[1:] + weight[:-1]
        k = int(np.argmin(weight[1:] * weight[:-1] / together * np.diff(place) ** 2))
        place[k] = (weight[k] * place[k] + weight[k + 1] * place[k + 1]) / together[k]
        weight[k] = together[k]
        place, weight = np.delete(place, k + 1), np.delete(weight, k + 1)
    return place
