"""A fit on another record of the same rig: only the temperatures and the memory that it began with are its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.functions import Array
from sim.diagnosis.chain import Chain
from sim.diagnosis.film_columns import FilmStart
from sim.diagnosis.path_estimate import measured_path
from sim.diagnosis.record import Record
from sim.diagnosis.resistance_channel import ResistanceChannel
from sim.diagnosis.temperature_channel import TemperatureChannel


def residuals_on(chain: Chain, names: frozenset[str], other: Record) -> dict[str, Array]:
    """Residuals of the fit with these effects in the other record's rows, in K and decades; nan without a reading."""
    a, b = chain.fits(names)
    out: dict[str, Array] = {}
    path = None
    every = np.ones(other.rows, dtype=np.bool_)
    if a is not None and other.current_A is not None:
        channel = TemperatureChannel(other, every, a.sigma_K, other.step_K)
        parameters = replace(channel.extended(a.parameters, a.effects), first_degC=channel.rough_firsts())
        x, first = channel.begun(parameters)
        path, shown = channel.simulate(parameters, x, first)
        out["temperature_K"] = np.where(other.temperature_used, other.temperature_degC - shown, np.nan)
    if b is not None and other.output is not None:
        path = path if path is not None else measured_path(other)
        own = chain.last(chain.split(names)[0]).channel
        channel_b = ResistanceChannel(other, path, every, own.sigma_dec, own.basis)
        best = np.inf
        for start in (FilmStart("heated"), FilmStart("cooled")):
            p = replace(b.parameters, start=start)
            for _ in range(2):  # the second time the model's own resistance heats the film
                shown = channel_b.predict_from(p, replace(b, parameters=p), channel_b.relays_of(p, p.x))
                channel_b.power_output = shown
            residual = np.where(other.output_used, other.output - shown, np.nan)
            square = float(np.nanmean(residual**2))
            if square < best:
                best, out["resistance_dec"] = square, residual
    return out
