"""Whether a record of a film is too short to decide what is left: one loop, and rows too far apart to be smooth.

Where a reading's two neighbours predict it far worse than the noise is, the film changes between two rows by more than
the record shows, and one loop passes each place once in each direction: the film between two rows may then do what any
effect of film or ohmmeter does.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.inference.noise import rough_noise
from sim.inference.record.record import Record

FAR_APART: Final = 10.0  # times the noise: a model that errs as the chord does is then off in every row of the flank
TURNED: Final = 0.1  # of the temperatures' span, from which a turn is one: two turns are one loop
MOST_TURNS: Final = 2
FLANK: Final = 0.9  # quantile of the readings by how far off the chord they are: a transition is a tenth of a loop


def sparse_loop(record: Record) -> str | None:
    """Return what an experiment would need that decides; None if the record has more than one loop, or is dense."""
    if record.output is None or _turns(record.temperature_degC[record.temperature_used]) > MOST_TURNS:
        return None
    rows = np.flatnonzero(record.output_used)
    y, degC, quantity = record.output[rows], record.temperature_degC[rows], record.quantity
    off, noise = np.abs(y[1:-1] - 0.5 * (y[:-2] + y[2:])), rough_noise(y)
    apart = float(np.quantile(off, FLANK))
    if apart < FAR_APART * noise:
        return None
    step_K = float(np.nanmedian(np.abs(np.diff(degC))[1:][off >= apart]))
    wanted_K = step_K * math.sqrt(noise / apart)  # a chord's error goes with the square of the step
    return (
        f"minor loops, and the flanks with a row every {wanted_K:.2g} K: here rows are {step_K:.2g} K apart, and a "
        f"reading's neighbours predict it to {quantity.size * apart:.2g} {quantity.unit} only (noise where the film "
        f"hardly changes: {quantity.size * noise:.2g} {quantity.unit})"
    )


def _turns(degC: Array) -> int:
    """Return how often the temperature turned round by more than a share of its span."""
    least, turns, direction = TURNED * float(np.ptp(degC)), 0, 0
    low = high = float(degC[0])
    for value in degC.tolist():
        low, high = min(low, value), max(high, value)
        if direction <= 0 and value - low > least:
            turns, direction, high = turns + (direction < 0), 1, value
        elif direction >= 0 and high - value > least:
            turns, direction, low = turns + (direction > 0), -1, value
    return turns
