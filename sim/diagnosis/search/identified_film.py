"""The film of a diagnosis identified from all records of it, at the temperatures that plate and effects give it.

A run goes where its target leads; the calibration before it went elsewhere, and was read with the same effect in it. A
film that was told from both, each taken back to what the film itself went through, is right in either place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.film_readings import can_be_taken_back, film_went_through, readings_of_the_film
from sim.diagnosis.search.chain import Chain
from sim.inference.film.fit import identify_film_records
from sim.model.chain import NO_PLATE, ChainModel
from sim.model.operator_outputs import Integers
from sim.model.own_output import own_output


@dataclass(frozen=True, eq=False)
class IdentifiedFilm:
    """The film's model, and what it leaves (decades): left, in the held-out rows of the diagnosed record, which it does
    not see, shape (rows,), nan where nothing tells how the film got there; told, in all readings that told it."""

    model: FilmModel
    left: Array
    told: Array


def identified_film(
    chain: Chain, names: frozenset[str], others: Sequence[Record], held: Integers
) -> IdentifiedFilm | None:
    """With the fit of these effects; None where the film's readings do not follow from the ohmmeter's, or no model
    could be identified. others: further records of the film; held: rows of the diagnosed one."""
    channel, (first, last) = chain.film_channel(names), chain.fits(names)
    assert last is not None
    links, nodes = channel.nodes(last.parameters, last.parameters.x)
    if not can_be_taken_back(links):
        return None
    record = channel.record
    assert record.output is not None
    parts = readings_of_the_film(record.without(held[:0], held), nodes, links, "record")
    readings = list(parts)
    plate = chain.plate(names)
    effects = (*(first.effects if first is not None else ()), *last.effects)
    model = ChainModel(plate or NO_PLATE, None, effects)
    try:
        for other in others:
            readings += readings_of_the_film(other, film_went_through(model, other), model.links, "further record")
        fit = identify_film_records(readings, temperature_noise_K=0.0)
    except ValueError:
        return None
    read_s, own = nodes.time_s[nodes.taken[held]], own_output(links, record.output[held])
    left, told = np.full(held.size, np.nan), []
    for number, part in enumerate(readings):
        time, degC = np.asarray(part.time_s), np.asarray(part.temperature_degC)
        shown = fit.along(number, time, degC)
        told.append(np.delete(np.asarray(part.output) - shown, fit.outliers[number]))
        if number < len(parts):
            inside = (read_s >= time[0]) & (read_s <= time[-1])
            left[inside] = own[inside] - np.interp(read_s[inside], time, shown)
    every = np.concatenate(told)
    return IdentifiedFilm(fit.model, left, every[np.isfinite(every)])
