"""What a fit leaves in each row, of the record that it was fitted to."""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.likelihood import expected_reading, origin_of
from sim.diagnosis.data.record import Mask, Record
from sim.diagnosis.search.chain import Chain
from sim.model.links import links_of


def residuals(chain: Chain, names: frozenset[str]) -> dict[str, Array]:
    """Residuals in every row, in K and decades, nan where there is no reading."""
    record, out = chain.record, {}
    a, b = chain.fits(names)
    if a is not None:
        out["temperature_K"] = np.where(record.temperature_used, record.temperature_degC - a.shown_degC, np.nan)
    if b is not None and record.output is not None:
        known = record.output_used & read_within(record, links_of(b.effects).taken(record.taken_s))
        out["resistance_dec"] = np.where(known, record.output - b.shown, np.nan)
    return out


def read_within(record: Record, taken: Array) -> Mask:
    """Rows whose resistance was read while the record ran: before and after it nothing is known of the temperature."""
    return np.asarray((taken >= -record.interval_s) & (taken <= record.time_s[-1] + record.interval_s))


def rounded(readings_degC: Array, residual_K: Array, sigma_K: float, step_K: float) -> tuple[Array, Array]:
    """Residuals of a thermometer on a lattice against the mean that such readings have, and their variance there."""
    finite = np.isfinite(residual_K)
    after, variance = np.full(residual_K.size, np.nan), np.full(residual_K.size, np.nan)
    origin = origin_of(readings_degC[finite], step_K)
    mean, variance[finite] = expected_reading((readings_degC - residual_K)[finite], sigma_K, step_K, origin)
    after[finite] = readings_degC[finite] - mean
    return after, variance
