"""What a record with one current throughout cannot tell of its plate."""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.identification.heat_balance import Kind

SAME: Final = 0.02  # of the largest: currents that differ by less are one level


def constant_drive(current: Array, kind: Kind) -> str:
    """current: A, or a share of full drive, in the rows of which it acts until the next one, (rows,), finite. Empty
    where it has several levels."""
    largest = float(np.max(np.abs(current), initial=0.0))
    if largest > 0.0 and np.unique(np.round(current / (SAME * largest))).size > 1:
        return ""
    if kind == "peltier":
        return (
            "The current is constant: Seebeck term, Joule heat and loss cannot be separated. "
            "Record a profile with at least three levels of current, of both signs."
        )
    return (
        "The drive is constant: heating rate and loss to the ambient cannot be separated. "
        "Record steps of the drive, zero among them."
    )
