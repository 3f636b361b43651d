"""Whether a fit's plate is one of the two kinds that there are.

A drive that never cools does not say which: both are tried. What heats with the square of its drive, and pumps no heat,
is neither a Peltier plate nor a heater whose drive is its power (a lamp, a heater of which the voltage was recorded).
What is seen beside such a plate may stand in for what its heat really does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from compensator.hysteresis.functions import KELVIN
from sim.diagnosis.search.chain import Chain

NO_KIND: Final = "the plate is neither a Peltier plate nor a heater whose drive is its power: that may be the cause"
PUMPS: Final = 0.02  # of the heat at the largest drive; a module driven at its best pumps as much as it makes


def of_no_kind(chain: Chain, names: frozenset[str]) -> bool:
    """Of the fit with these effects, for a record whose drive never cools."""
    fit, current = chain.fits(names)[0], chain.record.current_A
    if fit is None or current is None or fit.parameters.kind != "peltier" or bool(np.any(current < 0.0)):
        return False
    s, r, _, _, room = (float(v) for v in fit.parameters.plate())
    pumped, made = s * (room + KELVIN), 0.5 * r * float(np.max(current))
    return pumped < PUMPS * (pumped + made)
