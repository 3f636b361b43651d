"""The plate's losses g (T_a - T) in the two numbers that a record is linear in.

Those are g, and the heat that the room gives at the readings' mean temperature, g (T_a - T_mean). In T_a itself it is
not: where g is next to nothing T_a may be anything, and a descent along it creeps. So a step is looked for in g and in
that heat over g.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array


@dataclass(frozen=True, eq=False)
class Losses:
    """About a fit's vector x. conductance, room: places in it of log g and of T_a; mean: of the readings, in
    the unknown's unit of T_a."""

    conductance: int
    room: int
    x: Array
    mean: float

    @property
    def _away(self) -> float:
        return float(self.x[self.room]) - self.mean

    def along(self, slopes: Array) -> Array:
        """Derivatives with respect to x, (unknowns, ...), as those with respect to what a step is looked for in."""
        out = slopes.copy()
        out[self.conductance] -= self._away * slopes[self.room]
        return out

    def both_sides(self, matrix: Array) -> Array:
        """The same of a matrix that has them on both sides."""
        return self.along(self.along(matrix).T)

    def room_after(self, move: float, to: Array) -> float:
        """Where T_a is after a step: g is where `to` has it, the heat over the former g moved by `move`."""
        return self.mean + (self._away + move) / float(np.exp(to[self.conductance] - self.x[self.conductance]))
