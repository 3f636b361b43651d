"""What the ohmmeter heats the film with, between the rows too: I_m^2 R.

A row's test current is on since the row before: where it changes, the film jumps right after that, and may turn there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array

RIGHT_AFTER = 1e-5  # of the step to the next row


@dataclass(frozen=True, eq=False)
class MeterPower:
    """time_s, current_A, output (-log10 of the film's own resistance in ohm): of each row, shape (rows,)."""

    time_s: Array
    current_A: Array
    output: Array

    def jumps_s(self) -> Array:
        """Right after the rows that are followed by another current."""
        return jumps_s(self.time_s, self.current_A)

    def at(self, time_s: Array) -> Array:
        """Watts at any times of the record. Between two rows with different currents the output is that of the two
        rows after, straight on."""
        last = self.time_s.size - 1
        after = np.clip(np.searchsorted(self.time_s, time_s, side="left"), 0, last)
        before, beyond = np.maximum(after - 1, 0), np.minimum(after + 1, last)
        alike = self.current_A[before] == self.current_A[after]
        steady = ~alike & (self.current_A[beyond] == self.current_A[after])
        other = np.where(alike, before, np.where(steady, beyond, after))
        apart = self.time_s[other] - self.time_s[after]
        slope = (self.output[other] - self.output[after]) / np.where(apart == 0.0, 1.0, apart)
        output = self.output[after] + slope * np.where(apart == 0.0, 0.0, time_s - self.time_s[after])
        return np.asarray(self.current_A[after] ** 2 * 10.0**-output, dtype=np.float64)


def jumps_s(time_s: Array, current_A: Array) -> Array:
    """Right after the rows that are followed by another test current, (jumps,)."""
    k = np.flatnonzero(np.diff(current_A) != 0.0)
    return np.asarray(time_s[k] + RIGHT_AFTER * (time_s[k + 1] - time_s[k]), dtype=np.float64)
