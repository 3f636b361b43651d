"""Whether a record of a film is too short to decide what is left: one loop, and rows too far apart to be smooth.

Where a reading's two neighbours predict it far worse than the noise is, the film changes between two rows by more than
the record tells, and one loop passes each place once in each direction: what a model is off by there may be the film.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record

FAR_APART: Final = 10.0  # times the noise: a model that errs as the chord does is then off in every row of the flank
TURNED: Final = 0.1  # of the temperatures' span, from which a turn is one: two turns are one loop
MOST_TURNS: Final = 2
FLANK: Final = 0.9  # quantile of the readings by how far off the chord they are: a transition is a tenth of a loop


@dataclass(frozen=True)
class SparseLoop:
    """apart, noise: how far a reading on the flank is off its neighbours' mean, and the noise where the film hardly
    changes, in the unit; step_K: between two rows there; wanted_K: the step at which both would be alike."""

    apart: float
    noise: float
    unit: str
    step_K: float
    wanted_K: float

    @property
    def missing(self) -> str:
        """What an experiment would have to have."""
        return (
            f"minor loops, and the flanks with a row each {self.wanted_K:.2g} K: here they are {self.step_K:.2g} K "
            f"apart, and neighbours tell a reading to {self.apart:.2g} {self.unit} only (noise where the film hardly "
            f"changes: {self.noise:.2g} {self.unit})"
        )


def sparse_loop(record: Record, noise_dec: float) -> SparseLoop | None:
    """None where the record has more than one loop, or is dense."""
    if record.output is None or not one_loop(record):
        return None
    rows = np.flatnonzero(record.output_used)
    y, degC = record.output[rows], record.temperature_degC[rows]
    off = np.abs(y[1:-1] - 0.5 * (y[:-2] + y[2:]))
    apart = float(np.quantile(off, FLANK))
    if apart < FAR_APART * noise_dec:
        return None
    step = float(np.nanmedian(np.abs(np.diff(degC))[1:][off >= apart]))
    unit = record.quantity
    return SparseLoop(
        apart * unit.size, noise_dec * unit.size, unit.unit, step, step * float(np.sqrt(noise_dec / apart))
    )


def one_loop(record: Record) -> bool:
    """Whether the film went round its loop once at most: each temperature was passed once in each direction."""
    return _turns(record.temperature_degC[record.temperature_used]) <= MOST_TURNS


def _turns(degC: Array) -> int:
    """How often the temperature turned round by more than a share of its span."""
    least, turns, direction = TURNED * float(np.ptp(degC)), 0, 0
    low = high = float(degC[0])
    for value in degC.tolist():
        low, high = min(low, value), max(high, value)
        if direction <= 0 and value - low > least:
            turns, direction, high = turns + (direction < 0), 1, value
        elif direction >= 0 and high - value > least:
            turns, direction, low = turns + (direction > 0), -1, value
    return turns
