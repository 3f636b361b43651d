"""The residual, one definition for every figure, column, JSON and sentence: measured - model.

It is counted in what was measured: kelvin of a temperature, decades of log10 R (whatever sign the model's output has),
the column's own unit of another quantity. Above 0 the reading is larger than the model's value.
"""

from __future__ import annotations

import numpy as np

from compensator.hysteresis.functions import Array
from rig.records.film_output import sign_of

RESIDUAL = "measured - model"


def residual(measured: Array, model: Array, output: str = "") -> Array:
    """Return measured - model, shape (rows,), nan where either is none. output: the film output that both are of, as
    minus_log10_ohm; "" for readings as they are (a temperature)."""
    return np.asarray(sign_of(output) * (measured - model), dtype=np.float64)


def residual_dec(measured_ohm: Array, other_ohm: Array) -> Array:
    """Return log10 of measured over modelled (or wanted) resistance, shape (rows,); nan where either is none."""
    good = np.isfinite(measured_ohm) & (measured_ohm > 0.0) & np.isfinite(other_ohm) & (other_ohm > 0.0)
    found = np.full(measured_ohm.shape, np.nan)
    found[good] = np.log10(measured_ohm[good]) - np.log10(other_ohm[good])
    return found


def residual_label(unit: str) -> str:
    """Return the label of an axis that shows it: "measured - model / K"."""
    return f"{RESIDUAL} / {unit}"
