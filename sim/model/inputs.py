"""What else heats the plate, as far as a record has it: a second drive, and what is logged of a sink or of the room.

    dT_p/dt = ... + sum_k c_k u_k(t)

u of `input_2` is its value, from each row until the next; u of a temperature is by how much it is above its first
reading, straight from row to row. c > 0 is in K/s per unit of u: the plate's conductance over its heat capacity where
all of its heat flows to what was logged, less where the sensor sits elsewhere. The first reading needs no place of its
own: it is in the room's temperature, T_a.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

DRIVE: Final = "input_2"
SURROUNDINGS: Final = ("sink_degC", "ambient_degC")
NAMES: Final = (DRIVE, *SURROUNDINGS)


@dataclass(frozen=True, eq=False)
class Inputs:
    """names; values: u of each, (rows, names)."""

    names: tuple[str, ...]
    values: Array

    def between(self, row_s: Array, time_s: Array) -> Array:
        """Return the mean of each u from each of some times to the next, (times, names)."""
        out = np.empty((time_s.size, len(self.names)))
        row = np.clip(np.searchsorted(row_s, time_s, side="right") - 1, 0, row_s.size - 1)
        middle = 0.5 * (time_s + np.append(time_s[1:], time_s[-1]))
        for k, name in enumerate(self.names):
            u = self.values[:, k]
            out[:, k] = u[row] if name == DRIVE else np.interp(middle, row_s, u)
        return out

    def coefficients(self, known: Mapping[str, float]) -> Array:
        """Return c of each, of a plate whose coefficients are known by name; 0 for one that it does not have."""
        return np.array([known.get(name, 0.0) for name in self.names])


NOTHING: Final = Inputs((), np.empty((0, 0)))


def constant_inputs(
    columns: Mapping[str, Array], begins: Sequence[int] | NDArray[np.int64]
) -> dict[str, tuple[float, float]]:
    """Return the inputs that do not change, and so are none: the least and the largest reading of each, which are two
    where records that begin in these rows differ."""
    changing = logged_inputs(columns, begins).names
    told = {name: columns[name][np.isfinite(columns[name])] for name in NAMES if name in columns}
    return {
        name: (float(np.min(own)), float(np.max(own)))
        for name, own in told.items()
        if own.size and name not in changing
    }


def logged_inputs(columns: Mapping[str, Array], begins: Sequence[int] | NDArray[np.int64]) -> Inputs:
    """Return the inputs among the columns (rows,) that change. begins: where records begin, each with its own
    first temperatures, the first one with row 0."""
    names, found = [], []
    for name in NAMES:
        values = columns.get(name)
        if values is None or not np.any(np.isfinite(values)):
            continue
        u = _whole(values, name, [*begins, values.size])
        if np.ptp(u) > 0.0:
            names.append(name)
            found.append(u)
    return Inputs(tuple(names), np.column_stack(found)) if names else NOTHING


def _whole(values: Array, name: str, edges: Sequence[int]) -> Array:
    """Return u in each row: where none was read, of a drive the one before, of a temperature between its neighbours; 0
    in a record without any."""
    u, rows = np.zeros(values.size), np.arange(values.size)
    for first, last in itertools.pairwise(edges):
        own = values[first:last]
        told = np.flatnonzero(np.isfinite(own))
        if told.size == 0:
            continue
        here = rows[first:last] - first
        if name == DRIVE:
            place = np.searchsorted(told, here, side="right") - 1
            u[first:last] = np.where(place >= 0, own[told[np.maximum(place, 0)]], 0.0)
        else:
            u[first:last] = np.interp(here, told, own[told]) - own[told[0]]
    return u
