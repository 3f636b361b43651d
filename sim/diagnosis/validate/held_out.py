"""A fit on another record of the same rig: the model held, its own parameters fitted (`sim.inference.nuisance`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Mask, Record, told_of
from sim.diagnosis.fit.fitted_chain import FittedChain
from sim.diagnosis.fit.path_estimate import measured_path
from sim.diagnosis.search.chain import Chain
from sim.diagnosis.validate.residuals import read_within
from sim.inference.nuisance import Told, fit_own
from sim.model.links import links_of
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart, RecordOwn


def residuals_on(
    chain: Chain, names: frozenset[str], other: Record, rows: Mask | None = None, known: bool = False
) -> dict[str, Array]:
    """Residuals of the fit with these effects in the other record's rows, in K and decades; nan without a reading.

    rows: those by which what belongs to the record is fitted, nan in the residuals unless known; None: all of them,
    none left out.
    """
    fitted, own, path, told = on_other(chain, names, other, rows)
    a, b = fitted.a, fitted.b
    unseen = np.ones(other.rows, dtype=np.bool_) if rows is None or known else ~rows
    out: dict[str, Array] = {}
    if a is not None and other.current_A is not None:
        left = told.temperature_degC - fitted.plate(other, own).shown_degC
        out["temperature_K"] = np.where(unseen, left, np.nan)
    if b is not None and told.output is not None:
        read_then = unseen & read_within(other, links_of(b.effects).taken(other.taken_s))
        out["resistance_dec"] = np.where(read_then, told.output - fitted.shown(other, path, own), np.nan)
    return out


def on_other(
    chain: Chain, names: frozenset[str], other: Record, rows: Mask | None = None
) -> tuple[FittedChain, RecordOwn, PlatePath, Told]:
    """The fit on another record, what belongs to that record fitted to these rows of it, the plate's path there, and
    its readings."""
    a, b = chain.fits(names)
    read = b is not None and other.output is not None
    fitted = FittedChain(a, b, chain.film_channel(names).elsewhere(other) if read else None)
    told = told_of(other)
    if chain.first is not None and a is not None:
        error_K, error_time_s = chain.first.channel.model_error(a).of_a_model
        told = replace(told, error_K=error_K, error_time_s=error_time_s)
    if not read:
        told = replace(told, output=None)
    measured = None if a is not None and other.current_A is not None else measured_path(other)
    memory = FilmStart(b.parameters.start.initial) if b is not None else FilmStart()
    own, path = fit_own(fitted, other, told if rows is None else told.only(rows), memory, measured)
    return fitted, own, path, told
