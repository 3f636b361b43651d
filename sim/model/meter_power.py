"""What the ohmmeter heats the film with, between the rows too: I_m^2 R.

A row's test current is on since the row before, or since the record says so: there the film jumps, and may turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

RIGHT_AFTER = 1e-5  # of the step to the next row


@dataclass(frozen=True, eq=False)
class MeterCurrent:
    """The ohmmeter's test current. time_s: of the rows; current_A: with which each was read; on_s: since when it had
    been on, from the row before to the row; shape (rows,)."""

    time_s: Array
    current_A: Array
    on_s: Array

    def row_at(self, time_s: Array) -> NDArray[np.int64]:
        """Return the row whose current is on at any times of the record."""
        after = np.clip(np.searchsorted(self.time_s, time_s, side="left"), 0, self.time_s.size - 1)
        return np.asarray(np.where(time_s <= self.on_s[after], np.maximum(after - 1, 0), after), dtype=np.int64)

    def jumps_s(self) -> Array:
        """Return when the current changes, and right after: between the two the film's temperature jumps."""
        k = np.flatnonzero(np.diff(self.current_A) != 0.0) + 1
        at = self.on_s[k]
        after = at + RIGHT_AFTER * (self.time_s[k] - self.time_s[k - 1])
        return np.asarray(np.concatenate((at[at > self.time_s[k - 1]], after)), dtype=np.float64)


def since_the_row_before(time_s: Array) -> Array:
    """Return `MeterCurrent.on_s` where a record does not tell."""
    return np.append(time_s[:1], time_s[:-1])


@dataclass(frozen=True, eq=False)
class MeterPower:
    """meter: its current; output: -log10 of the film's own resistance in ohm, of each row, shape (rows,)."""

    meter: MeterCurrent
    output: Array

    def at(self, time_s: Array) -> Array:
        """Return watts at any times of the record. Beside a change of the current the output is that of the two nearest
        rows on the same side, straight on."""
        rows, current = self.meter.time_s, self.meter.current_A
        last = rows.size - 1
        after = np.clip(np.searchsorted(rows, time_s, side="left"), 0, last)
        before = np.maximum(after - 1, 0)
        own = self.meter.row_at(time_s)
        other = np.where(own == after, before, after)
        further = np.where(own == after, np.minimum(after + 1, last), np.maximum(before - 1, 0))
        further = np.where(current[further] == current[own], further, own)
        other = np.where(current[other] == current[own], other, further)
        apart = rows[other] - rows[own]
        slope = (self.output[other] - self.output[own]) / np.where(apart == 0.0, 1.0, apart)
        output = self.output[own] + slope * np.where(apart == 0.0, 0.0, time_s - rows[own])
        return np.asarray(current[own] ** 2 * 10.0**-output, dtype=np.float64)
