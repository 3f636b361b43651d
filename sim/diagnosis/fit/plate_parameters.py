"""What a fit of the first links looks for: the plate, effects on it, rooms, and temperatures at the beginnings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.unknowns import Unknown, free, positive, unknowns_of
from sim.effects.effect import Switched

ROOM = free("ambient_degC", 10.0)
PELTIER = (positive("s", 1e-6, 1.0), positive("r", 1e-6, 10.0), positive("g", 1e-6, 1.0), ROOM)
HEATER = (positive("q", 1e-5, 100.0), positive("g", 1e-6, 1.0), ROOM)
ROOM_K = 5.0  # the spread of one laboratory's, from record to record


@dataclass(frozen=True, eq=False)
class PlateParameters:
    """x: the fit's vector (plate, effects, rooms, temperatures of their own, each at its beginnings); first_degC: of
    each stretch; rooms: how many further records have a room of their own."""

    kind: str
    effects: tuple[Switched, ...]
    x: Array
    first_degC: Array
    rooms: int = 0

    @property
    def rooms_K(self) -> Array:
        """By how much the room of each further record is warmer than the first one's."""
        begin = len(self.base) + len(unknowns_of(self.effects))
        return ROOM_K * self.x[begin : begin + self.rooms]

    @property
    def usual_room_degC(self) -> float:
        """The mean of all records' rooms: what is known of a further one's."""
        return float(self.plate()[-1] + np.sum(self.rooms_K) / (1.0 + self.rooms))

    @property
    def base(self) -> tuple[Unknown, ...]:
        return PELTIER if self.kind == "peltier" else HEATER

    def plate(self) -> Array:
        """(s, r, g, q, T_a)."""
        v = {u.name: u.outside(float(x)) for u, x in zip(self.base, self.x, strict=False)}
        return np.array([v.get(name, 0.0) for name in ("s", "r", "g", "q", ROOM.name)])
