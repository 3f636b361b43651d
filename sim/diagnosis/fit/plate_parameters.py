"""What a fit of the first links looks for: the plate, effects on it, rooms, and temperatures at the beginnings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from sim.diagnosis.fit.unknowns import Unknown, free, positive, unknowns_of
from sim.effects.effect import Switched
from sim.inference.noise import Noise

ROOM = free("ambient_degC", 10.0)
CONDUCTANCE = "g"
PELTIER = (positive("s", 1e-6, 1.0), positive("r", 1e-6, 10.0), positive(CONDUCTANCE, 1e-6, 1.0), ROOM)
HEATER = (positive("q", 1e-5, 100.0), positive(CONDUCTANCE, 1e-6, 1.0), ROOM)
INPUT = positive("input", 1e-9, 1e3)  # K/s per unit, of whatever unit: a second drive heats, and heat flows downhill
AN_INPUT = "inputs."  # how its unknown's name begins, as in a model file
ROOM_K = 5.0  # the spread of one laboratory's, from record to record


@dataclass(frozen=True, eq=False)
class PlateParameters:
    """x: the fit's vector (plate, effects, rooms, temperatures of their own, each at its beginnings); first_degC: of
    each stretch; rooms: how many further records have a room of their own; inputs: names of what else heats the plate
    (`sim.model.inputs`), between the plate's own unknowns and the room."""

    kind: str
    effects: tuple[Switched, ...]
    x: Array
    first_degC: Array
    rooms: int = 0
    inputs: tuple[str, ...] = ()

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
        return base_unknowns(self.kind, self.inputs)

    def plate(self) -> Array:
        """(s, r, g, q, T_a)."""
        v = self._values()
        return np.array([v.get(name, 0.0) for name in ("s", "r", CONDUCTANCE, "q", ROOM.name)])

    def numbers(self) -> Array:
        """The plate as the simulation takes it: without slopes of s and r."""
        return np.append(self.plate(), (0.0, 0.0))

    def model(self, error: Noise) -> PlateModel:
        """The plate as its equation has it; error: of its temperature, of which it keeps the slow part."""
        s, r, g, q, _ = (float(v) for v in self.plate())
        kind: Literal["peltier", "heater"] = "heater" if self.kind == "heater" else "peltier"
        return PlateModel(s, r, g, self.usual_room_degC, q, kind, *error.of_a_model, tuple(self.inputs_K_per_s.items()))

    @property
    def inputs_K_per_s(self) -> dict[str, float]:
        """How fast one unit of each input heats."""
        v = self._values()
        return {name: v[AN_INPUT + name] for name in self.inputs}

    def _values(self) -> dict[str, float]:
        return {u.name: u.outside(float(x)) for u, x in zip(self.base, self.x, strict=False)}


@lru_cache(maxsize=64)  # asked for several times in each simulation
def base_unknowns(kind: str, inputs: tuple[str, ...] = ()) -> tuple[Unknown, ...]:
    """Of a plate of that kind with these inputs, without effects; the room last."""
    *own, room = PELTIER if kind == "peltier" else HEATER
    return *own, *(replace(INPUT, name=AN_INPUT + name) for name in inputs), room
