"""The equations of the first links: current -> driver -> plate -> thermometer, for given parameters over one record.

Unknowns are the plate's s, r, g, T_a (a heater's q, g, T_a), the effects' parameters, the temperatures of what has a
temperature of its own at the first row and after each long gap, and the plate's temperature at the beginning of each
stretch. Nothing here knows of noise, or of how well a reading is met.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import KELVIN, Array
from sim.diagnosis.data.record import Record, Rows
from sim.diagnosis.fit.own_temperature import has_own, own_temperatures, with_own_temperature
from sim.diagnosis.fit.plate_parameters import PELTIER, ROOM_K, PlateParameters, base_unknowns
from sim.diagnosis.fit.unknowns import unknowns_of, values_inside, with_values
from sim.effects.effect import Switched
from sim.inference.nuisance import APART_K, first_readings
from sim.model.links import Links, links_of
from sim.model.plate_path import Nodes, PlatePath, behind_thermometer, plate_nodes, simulate_plate
from sim.model.record_own import anew_rows
from sim.model.recorded import Spacing

INPUT_K_PER_S = 0.01  # by which a search begins for an input at its largest: what moves a plate by a kelvin or so
ASLEEP = 0.1  # of what the Seebeck term moves at the largest current: less Joule heat is none


class PlateEquations:
    """On one record. anew: the rows at which bodies and filters begin anew."""

    def __init__(self, record: Record, spacing: Spacing) -> None:
        self.record, self.spacing = record, spacing
        self.anew: Rows = np.union1d(anew_rows(record), record.joined)
        self._record_of = np.searchsorted(record.joined, self.anew, side="right")
        self._known_nodes: dict[bytes, Nodes] = {}

    def start(self, kind: str, base: Array, effects: Sequence[Switched] = ()) -> PlateParameters:
        """Parameters to begin with: base in the unknowns' own values, inputs that do little yet."""
        inputs = self.record.inputs.names
        least = INPUT_K_PER_S / np.max(np.abs(self.record.inputs.values), axis=0) if inputs else ()
        values = [*base[:-1], *least, base[-1]]
        x = np.array([u.inside(float(v)) for u, v in zip(base_unknowns(kind, inputs), values, strict=True)])
        return self.extended(PlateParameters(kind, (), x, self.rough_firsts(), inputs=inputs), effects)

    def extended(self, parameters: PlateParameters, effects: Sequence[Switched]) -> PlateParameters:
        """The same plate with these effects; what has a temperature of its own begins as it was, or at rest."""
        base = parameters.x[: len(parameters.base)]
        before = self._own(parameters)
        own = [before.get(effect.name, np.zeros(self.anew.size)) for effect in with_own_temperature(effects)]
        count = self.record.joined.size
        rooms = parameters.rooms_K / ROOM_K if parameters.rooms == count else np.zeros(count)
        x = np.concatenate((base, values_inside(effects), rooms, *own))
        return replace(parameters, effects=tuple(effects), x=x, first_degC=parameters.first_degC.copy(), rooms=count)

    def awakened(self, p: PlateParameters) -> PlateParameters:
        """The same, with a Joule heat where the plate alone has driven it to nothing: from there it would take long
        to come back."""
        if p.kind != "peltier" or self.record.current_A is None:
            return p
        s, r, _, _, ambient = p.plate()
        least = ASLEEP * 2.0 * s * (ambient + KELVIN) / float(np.max(np.abs(self.record.current_A)))
        if r >= least:
            return p
        x = p.x.copy()
        x[1] = PELTIER[1].inside(least)
        return replace(p, x=x)

    def _own(self, p: PlateParameters) -> dict[str, Array]:
        """Of each effect, at each of its beginnings here; parameters of another record begin as they did there."""
        names = [e.name for e in with_own_temperature(p.effects)]
        own = p.x[len(p.base) + len(unknowns_of(p.effects)) + p.rooms :]
        each = own.reshape(len(names), own.size // max(len(names), 1))
        if each.shape[1] != self.anew.size:
            each = np.repeat(each[:, :1], self.anew.size, axis=1)
        return dict(zip(names, each, strict=True))

    def _owns(self, effects: Sequence[Switched]) -> int:
        """How many temperatures of their own, at all beginnings."""
        return own_temperatures(effects) * int(self.anew.size)

    def rough_firsts(self) -> Array:
        """The first reading of each stretch, degC."""
        record = self.record
        return first_readings(record, np.where(record.temperature_used, record.temperature_degC, np.nan))

    def split(self, p: PlateParameters, x: Array) -> tuple[list[Switched], Links, Array, Array, Array]:
        """Effects with values, their links, the temperatures of those on the plate's balance (beginnings, effects), how
        far the filters are behind (beginnings, filters), both in the chain's order, and by how much the room is warmer
        than the first record's (beginnings,)."""
        end = x.size - self._owns(p.effects)
        effects = with_values(p.effects, x[len(p.base) : end])
        p = replace(p, x=x)
        ambient, rooms = p.plate()[-1], np.append(0.0, p.rooms_K)[self._record_of]
        apart = APART_K * x[end:].reshape(-1, self.anew.size)
        links = links_of(effects)
        flows = links.plate
        place = [k for k, e in enumerate(flows) if has_own(e)]
        own = np.repeat((ambient + rooms)[:, None], len(flows), axis=1)
        own[:, place] += apart[: len(place)].T
        return effects, links, own, apart[len(place) :].T, rooms

    def simulate(
        self, p: PlateParameters, x: Array, first: Array, path: PlatePath | None = None
    ) -> tuple[PlatePath, Array]:
        """The plate's path and what is shown in all rows. path: the plate's, where only the thermometer is another."""
        _, links, own, late, rooms = self.split(p, x)
        p, nodes = replace(p, x=x), self._nodes(links)
        if path is not None:
            return path, behind_thermometer(self.record, nodes, links, self.anew, late, path, self.spacing)
        heats = self.record.inputs.coefficients(p.inputs_K_per_s)
        begun = first, self.anew, own, late
        out = simulate_plate(self.record, nodes, p.numbers(), links, *begun, self.spacing, rooms, heats)
        return out.path, out.shown_degC

    def _nodes(self, links: Links) -> Nodes:
        """The times of a simulation; computed once where no effect moves the commands, or as long as they are moved
        alike: a dead band that is held is simulated a hundred times."""
        moved = b"".join(e.name.encode() + e.par.tobytes() for e in links.commands)
        if moved not in self._known_nodes:
            for other in self._known_nodes.keys() - {b""}:
                del self._known_nodes[other]
            self._known_nodes[moved] = plate_nodes(self.record, links, self.spacing)
        return self._known_nodes[moved]
