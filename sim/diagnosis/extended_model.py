"""The model of a fit as every other verb runs it: film, plate and effects.

The fit's film has any smooth D(T) (`SmoothCurve`); a model file names a form of it. Each form is fitted in its place,
the film's weights with it, in the same likelihood; the one with the largest evidence is written. Where earlier records
of the film are known, a film identified from all of them is taken if it predicts this record as well: a run goes where
its target leads, and the calibration before it went elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.inference.film.fit import film_model, identify_film_records, nearest_curve
from sim.inference.film.memoryless_forms import SIMPLEST_FIRST, Form
from sim.inference.film.rows import FilmRecord
from sim.inference.joint.films import PIFilm, PreisachFilm
from sim.inference.joint.held_out import simulated
from sim.inference.joint.likelihood import Fit
from sim.inference.noise import Readings, discrepancy
from sim.inference.nuisance import fit_own
from sim.inference.readings.temperature_path import temperature_path
from sim.inference.record.record import Record, told_of
from sim.model.chain import NO_PLATE, ChainModel
from sim.model.links import Links
from sim.model.observer import own_output
from sim.model.record_own import FilmStart
from sim.model.record_run import RecordRun, straight_path
from sim.model.recorded import COARSE, Rows

BY_CHANCE: Final = 3.0  # deviations by which the error over so many readings may be larger though the film is as good


@dataclass(frozen=True, eq=False)
class ExtendedModel:
    """film, plate: None where the record has none. effects: tables as in a model file. further: how many earlier
    records of the film it was fitted to."""

    film: FilmModel | None
    plate: PlateModel | None
    effects: tuple[dict[str, float | str], ...]
    further: int = 0

    def film_form(self) -> dict[str, Any] | None:
        """Return the film's form as the JSON has it; None without a film."""
        if self.film is None:
            return None
        form: dict[str, Any] = {
            "memoryless": self.film.memoryless.function,
            "operators": self.film.operators,
            "kind": self.film.kind,
        }
        return form | ({"further_records": self.further} if self.further else {})


def extended_model(fit: Fit, record: Record, earlier: Sequence[Record] = ()) -> ExtendedModel:
    """Return the model of a fit to a record. earlier: other records of the film."""
    with threadpool_limits(limits=1):
        fit = fit.for_simulation
        effects: list[dict[str, float | str]] = [{"name": name, **own} for name, own in fit.values().items()]
        plate = plate_model(fit) if fit.joint.driven else None
        if fit.joint.film is None:
            return ExtendedModel(None, plate, tuple(effects))
        named = with_named_curve(fit)
        film, further = film_model(named), 0
        chain = RecordRun(ChainModel(plate or NO_PLATE, film, tuple(named.joint.switched(named.at.x))), COARSE)
        if earlier and (from_all := _film_of_all(named, chain, record, earlier)) is not None:
            film, further = from_all, len(earlier)
        return ExtendedModel(record.quantity.film(film), plate, tuple(effects), further)


def plate_model(fit: Fit) -> PlateModel:
    """Return the plate of a fit, with what its model is off by beyond the instrument's noise."""
    joint, x = fit.joint, fit.at.x
    s, r, g, q, ambient, s_slope, r_slope = (float(v) for v in joint.plate_numbers(x))
    channel = fit.metric.temperature
    error = (0.0, 0.0) if channel.of_instrument else channel.noise.of_a_model
    inputs = tuple((name, float(x[joint.place[f"input.{name}"]])) for name in joint.record.inputs.names)
    return PlateModel(s, r, g, ambient, q, joint.kind, *error, inputs, s_slope, r_slope)


def with_named_curve(fit: Fit) -> Fit:
    """Return the fit with the form of D(T) whose evidence is the largest, its weights fitted anew."""
    joint, film = fit.joint, fit.joint.film
    assert isinstance(film, PIFilm | PreisachFilm)
    nodes = fit.at.run.nodes
    assert nodes is not None
    degC = nodes.film_degC[nodes.taken][joint.rows_dec]
    curve = film.curve.columns(degC) @ fit.at.coefficients[1 : film.free]
    low, high = float(np.min(nodes.film_degC)), float(np.max(nodes.film_degC))
    best: tuple[float, Fit] | None = None
    for name in SIMPLEST_FIRST[: 1 if film.curve.count == 0 else None]:
        named = nearest_curve(Form(name, False, low, high), degC, curve)
        other = joint.having(fit.effects, replace(film, curve=named))
        at = other.solve(other.from_other(joint, fit.at.x), fit.metric, fit.at.known_own)
        evidence = -at.cost - 0.5 * (other.film.free + named.shape.size) * math.log(degC.size)  # type: ignore[union-attr]
        if best is None or evidence > best[0]:
            best = evidence, Fit(other, at, fit.metric, other.log_likelihood(at, fit.metric), fit.most)
    assert best is not None
    return best[1]


def _film_of_all(fit: Fit, chain: RecordRun, record: Record, earlier: Sequence[Record]) -> FilmModel | None:
    """Return the film identified from all records, each taken back to what the film itself went through; None where
    that cannot be done, or predicts the record's held-out rows worse than the fit does. chain: of the fit's model."""
    nodes, links = fit.at.run.nodes, fit.at.run.links
    assert nodes is not None
    assert record.output is not None
    if links.hysteretic_part or links.meter_lags:  # their filters cannot be undone without making noise of them
        return None
    judged = np.flatnonzero(record.held_out & record.output_used)
    seen = replace(record, output_used=record.output_used & ~record.held_out)
    try:
        course = nodes.time_s, nodes.film_degC, nodes.taken
        readings = _film_readings(seen, course, links, "record")
        own = len(readings)
        for other in earlier:
            readings += _film_readings(other, _course(fit, chain, other), links, "earlier record")
        found = identify_film_records(readings, temperature_noise_K=0.0)
    except ValueError:
        return None
    time = np.concatenate([np.asarray(one.time_s) for one in readings[:own]])
    along = [found.along(k, np.asarray(one.time_s), np.asarray(one.temperature_degC)) for k, one in enumerate(readings)]
    output = np.concatenate([np.asarray(one.output) for one in _film_readings(record, course, links, "record")])
    here = np.searchsorted(time, nodes.time_s[nodes.taken[judged]])
    left = output[here] - np.concatenate(along[:own])[here]
    before = record.output[judged] - simulated(fit).shown_dec[judged]
    chance = BY_CHANCE / math.sqrt(2.0 * max(judged.size, 1))
    better = float(np.sqrt(np.nanmean(left**2))) <= (1.0 + chance) * float(np.sqrt(np.mean(before**2)))
    return found.model if better else None


def _course(fit: Fit, chain: RecordRun, record: Record) -> tuple[Array, Array, Rows]:
    """Return the film's course over another record, what belongs to that fitted: times and temperatures of nodes, the
    node at which each row's resistance was read. What the plate's model lacks is added as the thermometer shows it."""
    assert fit.joint.film is not None
    told, plate, channel = told_of(record), chain.model.plate, fit.metric.temperature
    told = replace(told, error_K=plate.error_K, error_time_s=plate.error_time_s)
    path, used = None, np.flatnonzero(record.temperature_used)
    if not fit.joint.driven:
        path = straight_path(record.time_s, temperature_path(record.time_s, told.temperature_degC).temperature_degC)
    own, path = fit_own(chain, record, told, FilmStart(fit.joint.film.start.initial), path)
    if fit.joint.driven and plate.error_K > 0.0:
        left = (told.temperature_degC - chain.plate(record, own).shown_degC)[used]
        path = path.raised(record.time_s[used], discrepancy(left, channel.noise, Readings.at(record.time_s[used]))[0])
    run = chain.film(record, path, own)
    return run.time_s, run.film_degC, run.taken


def _film_readings(record: Record, course: tuple[Array, Array, Rows], links: Links, name: str) -> list[FilmRecord]:
    """Return each of the joined records as an identification takes it: the film's temperature in every row and at each
    turn between rows, and the film's own output where that was read. course: as of `_course`."""
    assert record.output is not None
    node_s, film_degC, taken = course
    read = np.flatnonzero(record.output_used)
    slope = np.sign(np.diff(film_degC))
    turns = np.flatnonzero(slope[1:] * slope[:-1] < 0.0) + 1
    after = np.searchsorted(record.time_s, node_s[turns])
    turns = turns[~np.isin(after, record.after_gaps)]  # what a simulation does in a gap is made up
    kept = np.union1d(taken, turns)
    output = np.full(kept.size, np.nan)
    output[np.searchsorted(kept, taken[read])] = own_output(links, record.output[read])
    time = node_s[kept]
    begins = np.searchsorted(time, record.time_s[record.joined])
    parts = np.split(np.arange(kept.size), begins)
    return [FilmRecord(time[part], film_degC[kept[part]], output[part], name) for part in parts]
