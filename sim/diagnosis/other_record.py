"""A fit on another record of the same rig: only what that record began with is its own, temperatures, memory, and how
far filters were behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.chain import Chain
from sim.diagnosis.film_columns import FilmStart, taken_s
from sim.diagnosis.film_memory import beginnings
from sim.diagnosis.path_estimate import measured_path
from sim.diagnosis.record import Record
from sim.diagnosis.residuals import read_within
from sim.diagnosis.resistance_channel import ResistanceChannel
from sim.diagnosis.resistance_fit import ResistanceFit
from sim.diagnosis.temperature_channel import TemperatureChannel

STEP_DEC, STEP_K = 1e-3, 1e-2  # of a difference quotient
ROUNDS = 3
WIDE = 0.5  # prior of how far a filter is behind, dec and K


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
        own = chain.film_channel(names)
        channel_b = ResistanceChannel(other, path, every, own.sigma_dec, own.basis)
        starts = beginnings(channel_b, FilmStart())
        square = [_square(other, _shown(channel_b, b, start, 1)) for start in starts]
        shown = _shown(channel_b, b, starts[int(np.argmin(square))], ROUNDS)
        known = other.output_used & read_within(other, taken_s(other, b.effects))
        out["resistance_dec"] = np.where(known, other.output - shown, np.nan)
    return out


def _square(other: Record, shown: Array) -> float:
    assert other.output is not None
    return float(np.mean((other.output - shown)[other.output_used] ** 2))


def _shown(channel: ResistanceChannel, fit: ResistanceFit, start: FilmStart, rounds: int) -> Array:
    """What is shown in the record's rows; how far the filters were behind is fitted, by Gauss-Newton."""
    p = replace(fit.parameters, start=start, film_output=None)
    filters = channel.filters_behind(p.effects)
    linear = slice(channel.basis.columns, fit.coefficients.size - channel.relay_count(p))
    behind = np.zeros(linear.stop - linear.start + filters)

    def shown_for(behind: Array) -> tuple[Array, Array]:
        x, c = p.x.copy(), fit.coefficients.copy()
        x[x.size - filters :] = behind[behind.size - filters :]
        c[linear] = behind[: behind.size - filters]
        return channel.predict_from(replace(p, x=x), replace(fit, coefficients=c))

    for _ in range(rounds):  # from the second on the model's own resistance heats the film
        shown, film_output = shown_for(behind)
        p = replace(p, film_output=film_output)
        if behind.size:
            rows = channel.rows
            step = np.concatenate((np.full(behind.size - filters, STEP_DEC), np.full(filters, STEP_K)))
            moved = [shown_for(behind + step * (np.arange(step.size) == k))[0] for k in range(step.size)]
            slopes = np.stack([(m - shown)[rows] for m in moved], axis=1) / channel.sigma_dec
            residual = (channel.output - shown)[rows] / channel.sigma_dec
            prior = np.diag(step / WIDE)
            behind = (
                behind
                + step
                * np.linalg.lstsq(np.vstack((slopes, prior)), np.append(residual, np.zeros(step.size)), rcond=None)[0]
            )
    return shown_for(behind)[0]
