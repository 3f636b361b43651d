"""The film of a diagnosis identified from all records of it, at the temperatures that plate and effects give it.

A run goes where its target leads; the calibration before it went elsewhere, and was read with the same effect in it. A
film that was told from both, each taken back to what the film itself went through, is right in either place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.identification.film import identify_film_records
from compensator.identification.model_selection import rms
from compensator.identification.operator_outputs import Integers
from compensator.thermal.plate import PlateModel
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.film_readings import (
    can_be_taken_back,
    film_went_through,
    readings_of_the_film,
)
from sim.diagnosis.search.chain import Chain
from sim.effects.effect import switched
from sim.model.chain import NO_PLATE, ChainModel
from sim.model.own_output import own_output


def identified_film(
    chain: Chain,
    names: frozenset[str],
    found: Mapping[str, Mapping[str, float]],
    plate: PlateModel | None,
    others: Sequence[Record],
    held: Integers,
) -> tuple[FilmModel, float] | None:
    """(the film's model, its error in decades in the held-out rows of the diagnosed record, which it does not see);
    None where the film's readings do not follow from the ohmmeter's, or no model could be identified.

    found: parameters of the effects; others: further records of the film; held: rows of the diagnosed one."""
    effects = tuple(switched(chain.effects[name], dict(own)) for name, own in found.items())
    channel, last = chain.film_channel(names), chain.fits(names)[1]
    assert last is not None
    links, nodes = channel.nodes(last.parameters, last.parameters.x)
    if not can_be_taken_back(links):
        return None
    record = channel.record
    assert record.output is not None
    fewer = record.without(held[:0], held)
    parts = readings_of_the_film(fewer, nodes, links, "record")
    readings = list(parts)
    model = ChainModel(plate or NO_PLATE, None, effects)
    try:
        for other in others:
            readings += readings_of_the_film(other, film_went_through(model, other), model.links, "further record")
        fit = identify_film_records(readings, temperature_noise_K=0.0)
    except ValueError:
        return None
    left = []
    read_s, own = nodes.time_s[nodes.taken[held]], own_output(links, record.output[held])
    for number, part in enumerate(parts):
        time, degC = np.asarray(part.time_s), np.asarray(part.temperature_degC)
        inside = (read_s >= time[0]) & (read_s <= time[-1])
        left.append(own[inside] - np.interp(read_s[inside], time, fit.along(number, time, degC)))
    return fit.model, rms(np.concatenate(left))
