"""What the chain asks of a record: when things were commanded and read, never what was read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.model.inputs import Inputs

Rows = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Recorded(Protocol):
    """time_s: of the rows, from the first one on, (rows,). first_rows: those at which the plate's temperature begins
    anew, the first row among them. commands: when a current was commanded and which, s and A, (commands,). taken_s:
    what the resistances are stamped with, (rows,). test_current_A: of the ohmmeter, with which each row was read, None
    where none is known; test_on_s: since when it had been on. inputs: what else heats the plate.
    """

    @property
    def time_s(self) -> Array: ...

    @property
    def first_rows(self) -> Rows: ...

    @property
    def commands(self) -> tuple[Array, Array]: ...

    @property
    def taken_s(self) -> Array: ...

    @property
    def test_current_A(self) -> Array | None: ...

    @property
    def test_on_s(self) -> Array: ...

    @property
    def inputs(self) -> Inputs: ...


@dataclass(frozen=True)
class Spacing:
    """How close the nodes of a record lie. longest_s: between two nodes of the plate; lag_parts: into how many parts
    this distance is cut for a thermometer or film that lags; creep: whether creep follows the film at all nodes of the
    plate, as a lagging ohmmeter does, or in the rows, as a lag of minutes may."""

    longest_s: float
    lag_parts: int
    creep: bool = False

    def parts(self, time_s: Array) -> int:
        """Into how many parts the distance of nodes at these times is cut for a lag: nodes that lie close need none."""
        share = float(np.max(np.diff(time_s), initial=0.0)) / self.longest_s
        return max(min(math.ceil(share * self.lag_parts - 1e-9), self.lag_parts), 1)


COARSE = Spacing(0.5, 8)  # of fits: within a tenth of a usual noise, 1 mK and 2e-4 dec, of FINE
FINE = Spacing(0.02, 1, creep=True)  # of simulations: what a lag makes of a plate's curved course is right to 1e-6 K
EVENTS = Spacing(np.inf, 1)  # rows and commands alone: exact where nothing lags


def driven_rows(record: Recorded, joined: Sequence[int] | Rows = ()) -> Mask:
    """Return the rows since a current first drove the plate, (rows,): until then nothing is amiss with its heat.
    joined: where further records of the same rig begin, each with a plate at rest."""
    time, current = record.commands
    on_s = np.append(time[current != 0.0], np.inf)
    begin_s = np.append(-np.inf, record.time_s[np.array(joined, dtype=np.int64)])
    first_s = on_s[np.searchsorted(on_s, begin_s)]
    of_record = np.searchsorted(begin_s, record.time_s, side="right") - 1
    return np.asarray(record.time_s > first_s[of_record])
